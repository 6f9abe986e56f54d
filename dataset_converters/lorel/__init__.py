"""LOReL: random play on the simulated Sawyer tabletop, from the original files or from our own simulator."""
