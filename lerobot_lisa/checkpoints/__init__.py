"""Reading checkpoints that others made: nothing in them is run, nothing outside them is read, nothing is missing."""
