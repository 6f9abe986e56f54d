"""LeRobot policies: configuration, modeling and processor of each, over shared parts."""
