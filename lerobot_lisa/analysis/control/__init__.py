"""Steering a LISA policy by its skill codes: fixed codes, plans, and what each code does to each task."""
