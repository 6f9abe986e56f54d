"""Everything about time: whole episodes in training, what has been seen so far in rollouts."""
