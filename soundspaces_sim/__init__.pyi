"""The public names and where they live: read by type checkers, and by `__init__.py` when a name is first used."""

from .base.config import GraphConfig, GridConfig, JobConfig, SimulationConfig
from .base.errors import (
    ConfigError,
    DatasetError,
    MaterialError,
    PairIndexError,
    PointError,
    SceneError,
    SimulationError,
    SoundSpacesSimError,
)
from .echo.directed import directed
from .echo.echogram import Arrival, Arrivals, Echogram, Echograms
from .echo.ends import Directivity, Listener, Source
from .files.config import load_config
from .jobs.build import build_dataset, build_datasets
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
from .sound.directivity.cardioid import Cardioid, Omni
from .sound.directivity.frequency import FrequencyDependent
from .sound.directivity.harmonics import SphericalHarmonics
from .sound.directivity.sofa import MeasuredDirectivity
from .sound.directivity.talker import Talker
from .sound.ears import Ears
from .sound.microphones import MicrophoneArray, array_rir
from .storage.verify import verify_dataset
from .version import __version__

__all__ = [
    "Arrival",
    "Arrivals",
    "Cardioid",
    "ConfigError",
    "DatasetError",
    "Directivity",
    "Ears",
    "Echogram",
    "Echograms",
    "FrequencyDependent",
    "GraphConfig",
    "Grid",
    "GridConfig",
    "JobConfig",
    "Listener",
    "MaterialError",
    "MaterialTable",
    "MeasuredDirectivity",
    "MicrophoneArray",
    "Omni",
    "PairIndexError",
    "PointError",
    "RirCollection",
    "RirDataset",
    "Scene",
    "SceneError",
    "SceneReport",
    "SimulationConfig",
    "SimulationError",
    "SoundSpacesSimError",
    "Source",
    "SphericalHarmonics",
    "Talker",
    "WalkGraph",
    "__version__",
    "ambisonic_rir",
    "ambisonic_rirs",
    "array_rir",
    "binaural_moving",
    "binaural_rir",
    "binaural_rirs",
    "build_dataset",
    "build_datasets",
    "directed",
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
