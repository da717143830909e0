"""The doors: how files that others made are opened; and what is kept between processes. Not in `base`, whose code
kernels are compiled from."""
