"""The run folder: render, run, go on, load, compare."""
