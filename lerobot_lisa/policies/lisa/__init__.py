"""LISA: language and observations to a skill code every horizon, skill code and observations to actions."""
