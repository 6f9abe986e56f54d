"""Everything that is drawn: readable in black and white, and the same each time."""
