"""Room-impulse-response datasets by bidirectional path tracing, from a mesh to a reader.

    import soundspaces_sim as ss
    scene = ss.load_scene("demo")
    echoes = ss.simulate(scene, sources, listeners)
    rir = ss.ambisonic_rir(echoes[0, 0], rate=44100)
    ears = ss.binaural_rir(rir, rate=44100, heading_deg=90.0)
    ds = ss.open_dataset("out/demo")

Conventions: SI units, right-handed axes, Z up; see each module's docstring.
"""

from soundspaces_sim.ambisonics import ambisonic_rir, ambisonic_rirs
from soundspaces_sim.binaural import binaural_moving, binaural_rir, binaural_rirs
from soundspaces_sim.build import build_dataset
from soundspaces_sim.collection import RirCollection, open_datasets
from soundspaces_sim.config import GraphConfig, GridConfig, JobConfig, SimulationConfig, load_config
from soundspaces_sim.dataset import RirDataset, open_dataset
from soundspaces_sim.echogram import Arrival, Arrivals, Echogram, Echograms
from soundspaces_sim.errors import (
    ConfigError,
    DatasetError,
    MaterialError,
    PairIndexError,
    PointError,
    SceneError,
    SoundSpacesSimError,
)
from soundspaces_sim.graph import WalkGraph, make_graph
from soundspaces_sim.grid import Grid, make_grid
from soundspaces_sim.inspect import SceneReport, inspect_scene
from soundspaces_sim.listening import spectrogram
from soundspaces_sim.loaders import load_scene
from soundspaces_sim.materials import MaterialTable
from soundspaces_sim.scene import Scene
from soundspaces_sim.simulate import simulate
from soundspaces_sim.verify import verify_dataset
from soundspaces_sim.version import __version__

__all__ = [
    "Arrival",
    "Arrivals",
    "ConfigError",
    "DatasetError",
    "Echogram",
    "Echograms",
    "GraphConfig",
    "Grid",
    "GridConfig",
    "JobConfig",
    "MaterialError",
    "MaterialTable",
    "PairIndexError",
    "PointError",
    "RirCollection",
    "RirDataset",
    "Scene",
    "SceneError",
    "SceneReport",
    "SimulationConfig",
    "SoundSpacesSimError",
    "WalkGraph",
    "__version__",
    "ambisonic_rir",
    "ambisonic_rirs",
    "binaural_moving",
    "binaural_rir",
    "binaural_rirs",
    "build_dataset",
    "inspect_scene",
    "load_config",
    "load_scene",
    "make_graph",
    "make_grid",
    "open_dataset",
    "open_datasets",
    "simulate",
    "spectrogram",
    "verify_dataset",
]
