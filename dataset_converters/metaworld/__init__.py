"""Meta-World: demonstrations of the package's scripted experts, in LeRobot's own environment, as LeRobot datasets."""
