"""`python -m soundspaces_parameters DATASET`."""

from soundspaces_parameters.commands import app
from soundspaces_sim.parts import run_app

if __name__ == "__main__":
    run_app(app)
