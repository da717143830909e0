"""Room-impulse-response datasets by bidirectional path tracing, from a mesh to a reader."""

from soundspaces_sim.config import GridConfig, JobConfig, SimulationConfig, load_config
from soundspaces_sim.echogram import Arrival, Arrivals, Echogram
from soundspaces_sim.errors import (
    ConfigError,
    DatasetError,
    MaterialError,
    PairIndexError,
    PointError,
    SceneError,
    SoundSpacesSimError,
)
from soundspaces_sim.grid import Grid, make_grid
from soundspaces_sim.loaders import load_scene
from soundspaces_sim.materials import MaterialTable
from soundspaces_sim.scene import Scene
from soundspaces_sim.simulate import Echograms, simulate
