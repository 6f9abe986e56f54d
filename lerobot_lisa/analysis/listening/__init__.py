"""Does it listen: success when told otherwise, steps against the demonstrator's, affordances, other wordings."""
