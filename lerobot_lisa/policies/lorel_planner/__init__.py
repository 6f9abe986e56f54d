"""LOReL's planner: a learned reward, a learned model of the world, and the cross-entropy method."""
