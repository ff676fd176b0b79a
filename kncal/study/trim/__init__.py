"""Which parts of a scene's physics it can do without: each is run without (or with), and its cost and effect told."""
