"""Benchmarks: `make bench`. Each module's `main` prints a table; RESULTS.md keeps them with commands."""
