"""What `lerobot-train` has logged, read back from wherever it went."""
