"""LIGGGHTS: its deck, the process that reads it, and the library in a child process."""
