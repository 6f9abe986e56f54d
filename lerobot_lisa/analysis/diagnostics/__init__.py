"""Whether a policy does what it is told: swapped instructions, affordances, other wordings."""
