"""Traces: what a policy does in every step while LeRobot's own evaluation code runs it."""
