"""The run folder: render, run, resume, load, compare."""
