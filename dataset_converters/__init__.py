"""Original data sets and simulators to LeRobotDataset v3.0."""
