"""Triangles and what they are made of."""
