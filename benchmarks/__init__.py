"""Speed against named alternatives: `python -m benchmarks` prints the whole table."""
