"""The command line: `soundspaces-sim rirs SCENE` is what `make rirs` calls; more in `--help`.

One file per group of commands. Help loads nothing that computes: what does is imported where it runs.
"""

from soundspaces_sim.cli.app import main

__all__ = ["main"]
