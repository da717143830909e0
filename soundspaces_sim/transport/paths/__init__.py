"""Subpaths: emission, scattering, receiver volumes, connections, and their weights."""
