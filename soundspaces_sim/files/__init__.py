"""The doors: how files that others made are opened. Not in `base`, whose code kernels are compiled from."""
