"""BabyAI's own recurrent baseline, in the form of BabyAI 1.1."""
