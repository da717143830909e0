"""Readers of untrusted input, atomic writing, and the disk cache. Not in `base`, whose code
kernels are compiled from."""
