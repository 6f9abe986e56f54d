"""Can it be steered? Fixed skill codes, plans of them, and what each code does to each task."""
