"""`make rirs` without an installed console script: python pipelines/rirs.py SCENE [options]."""

import sys

from soundspaces_sim.cli import main

if __name__ == "__main__":
    sys.argv.insert(1, "rirs")
    main()
