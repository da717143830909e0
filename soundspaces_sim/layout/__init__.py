"""Where points stand, where one can walk, and what a scene is like."""
