"""Every number of the paper from one command: rows, what has to run for them, what is there already, tables of it."""
