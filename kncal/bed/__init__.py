"""Fluidised beds: what is simulated, its numbers, what is observed in it."""
