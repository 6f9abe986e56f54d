"""How did training go? The curves of one or several runs, from the log of `lerobot-train`."""
