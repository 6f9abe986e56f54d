"""What a trained policy does: success rates, what skills mean, how training went."""
