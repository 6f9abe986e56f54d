"""Do skills match what people, or a demonstrator, call the parts of a task? Codes beside annotated subtasks."""
