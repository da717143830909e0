"""`python -m soundspaces_sim.cli`."""

from soundspaces_sim.cli import main

if __name__ == "__main__":
    main()
