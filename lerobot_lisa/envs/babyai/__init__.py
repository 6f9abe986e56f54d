"""BabyAI: levels, partial view and gymnasium environment; minigrid is imported only where it is used."""
