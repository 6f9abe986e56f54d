"""Discovery shim: LeRobot imports a module named like the distribution; everything lives in `lerobot_lisa`."""

import lerobot_lisa  # noqa: F401
