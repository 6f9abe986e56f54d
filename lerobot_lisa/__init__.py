"""LISA and Lang-DT as LeRobot policies, BabyAI as a LeRobot environment: importing this registers them."""

from lerobot_lisa.errors import show_user_errors_in_one_line

show_user_errors_in_one_line()
