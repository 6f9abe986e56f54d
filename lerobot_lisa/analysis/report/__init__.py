"""One page that says what a checkpoint does and what its skills mean: `lisa-report`."""
