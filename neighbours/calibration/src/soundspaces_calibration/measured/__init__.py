"""Measured rooms: room measures per octave and pair of points, from tables and from responses."""
