"""The public names and where they live: read by type checkers, and by `__init__.py` when a name is first used."""

from .base.config import (
    GraphConfig,
    GridConfig,
    JobConfig,
    SimulationConfig,
    load_config,
)
from .base.errors import (
    ConfigError,
    DatasetError,
    MaterialError,
    PairIndexError,
    PointError,
    SceneError,
    SoundSpacesSimError,
)
from .echo.echogram import Arrival, Arrivals, Echogram, Echograms
from .jobs.build import build_dataset
from .loaders.load import load_scene
from .loaders.simulate import simulate
from .places.graph import make_graph
from .places.grid import make_grid
from .places.records import Grid, WalkGraph
from .places.survey import SceneReport, inspect_scene
from .reading.collection import RirCollection, open_datasets
from .reading.dataset import RirDataset, open_dataset
from .scene.build import shoebox
from .scene.materials import MaterialTable
from .scene.scene import Scene
from .sound.ambisonics import ambisonic_rir, ambisonic_rirs
from .sound.auralise import spectrogram
from .sound.binaural import binaural_moving, binaural_rir, binaural_rirs
from .storage.verify import verify_dataset
from .version import __version__

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
    "shoebox",
    "simulate",
    "spectrogram",
    "verify_dataset",
]
