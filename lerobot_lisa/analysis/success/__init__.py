"""Does it succeed? How often, with its uncertainty, in which parts of an evaluation, beside random actions."""
