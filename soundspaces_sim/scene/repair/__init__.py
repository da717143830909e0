"""What is done to a mesh before it becomes a scene."""
