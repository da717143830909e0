"""Image sources of one and two reflections at grouped planes."""
