"""Engines: each renders a model, runs it and reads it back."""
