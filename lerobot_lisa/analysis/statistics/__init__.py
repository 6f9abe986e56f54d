"""Numbers about traces, without any drawing."""
