"""Datasets made by many processes or machines: shards through datatrove, then merged by LeRobot."""
