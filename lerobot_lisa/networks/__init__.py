"""Plain torch modules; nothing here knows LeRobot."""
