"""Simulated worlds as LeRobot environments."""
