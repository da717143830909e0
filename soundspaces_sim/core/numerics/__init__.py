"""Numerics that kernels are compiled from: random streams, directions, bands, air; and the compiler itself."""
