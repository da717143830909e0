"""The public names and where they live: read by type checkers, and by `__init__.py` when a name is first used."""

from .build.build import build_dataset, build_datasets
from .build.inspect import SceneReport, inspect_scene
from .core.config import GraphConfig, GridConfig, JobConfig, load_config
from .core.errors import (
    ConfigError,
    DatasetError,
    MaterialError,
    PairIndexError,
    PointError,
    SceneError,
    SimulationError,
    SoundSpacesSimError,
)
from .core.profile import Stage, profiled
from .core.simulation_config import (
    ConnectionsConfig,
    DiffractionConfig,
    LowConfig,
    MaterialsConfig,
    RadianceTransferConfig,
    SimulationConfig,
    SpecularConfig,
)
from .core.version import __version__
from .dataset.collection import RirCollection, open_datasets
from .dataset.format.verify import verify_dataset
from .dataset.reader import RirDataset, open_dataset, read_room
from .echogram.directed import directed
from .echogram.echogram import Arrival, Arrivals, Echogram, Echograms
from .echogram.endpoints import Directivity, Listener, Source
from .echogram.refurnish import refurnished
from .layout.grid import make_grid
from .layout.navigation_graph import make_graph
from .layout.records import Grid, WalkGraph
from .rendering.ambisonics import ambisonic_rir, ambisonic_rirs
from .rendering.auralise import spectrogram
from .rendering.binaural import binaural_moving, binaural_rir, binaural_rirs
from .rendering.directivity import (
    Cardioid,
    FrequencyDependent,
    MeasuredDirectivity,
    Omni,
    SphericalHarmonics,
    Talker,
)
from .rendering.ears import Ears
from .rendering.microphones import MicrophoneArray, array_rir
from .scene.build import shoebox
from .scene.load import load_scene
from .scene.materials import MaterialTable
from .scene.scene import Scene
from .transport.simulate import simulate

__all__ = [
    "Arrival",
    "Arrivals",
    "Cardioid",
    "ConfigError",
    "ConnectionsConfig",
    "DatasetError",
    "DiffractionConfig",
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
    "LowConfig",
    "MaterialError",
    "MaterialTable",
    "MaterialsConfig",
    "MeasuredDirectivity",
    "MicrophoneArray",
    "Omni",
    "PairIndexError",
    "PointError",
    "RadianceTransferConfig",
    "RirCollection",
    "RirDataset",
    "Scene",
    "SceneError",
    "SceneReport",
    "SimulationConfig",
    "SimulationError",
    "SoundSpacesSimError",
    "Source",
    "SpecularConfig",
    "SphericalHarmonics",
    "Stage",
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
    "profiled",
    "read_room",
    "refurnished",
    "shoebox",
    "simulate",
    "spectrogram",
    "verify_dataset",
]
