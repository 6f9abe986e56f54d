"""BabyAI: demonstrations from a bot or from the original files, as LeRobot datasets."""
