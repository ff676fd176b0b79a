"""What the user wants: the scene, its case file, what it needs, its limits, and the plan with every number."""
