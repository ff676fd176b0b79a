"""Errors, checks, units, files, processes, templates: no physics, no names of solvers."""
