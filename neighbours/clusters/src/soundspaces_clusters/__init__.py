"""Engines that run the tiles of a job on clusters: Dask, SLURM, Ray. `--engine` finds them here."""
