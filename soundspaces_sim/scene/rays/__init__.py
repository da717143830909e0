"""Rays against triangles: Embree, directions, and the diffuse walk that geometry alone decides."""
