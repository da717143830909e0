"""Export in the layout that clients of SoundSpaces 1 read (data/metadata, binaural_rirs, ambisonic_rirs).

Its responses carry no propagation delay, and some clients drop the first 128 samples: the direct sound's
time is moved to sample `ONSET`. Azimuth 0 faces +Y, 90 faces +X: heading = 90° - azimuth.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np

from soundspaces_sim.base.errors import ConfigError
from soundspaces_sim.base.files import publish
from soundspaces_sim.exchange.points import HABITAT_HEIGHT, habitat_graph, points_text
from soundspaces_sim.exchange.wav import make_folder, wav_bytes
from soundspaces_sim.reading.dataset import RirDataset
from soundspaces_sim.sound.soundfield import Convention, convert

ONSET = 256
AZIMUTHS = (0, 90, 180, 270)
Progress = Callable[[int, int], None]


def export_soundspaces1(
    ds: RirDataset,
    out: str | Path,
    name: str = "replica",
    ambisonics: bool = True,
    convention: Convention = "soundspaces1",
    progress: Progress | None = None,
) -> int:
    """Write one dataset under `out`; the number of WAV files.

    `name`: the dataset's folder, ``replica`` or ``mp3d``, which also decides the agent's height in
    graph.pkl. Every pair is written, a point with itself included: to a client, a missing file is an
    error. Responses are those of the dataset's rate.
    """
    out = Path(out)
    if not name or Path(name).name != name:
        raise ConfigError(f"name: expected a plain folder name such as 'replica', got {name!r}")
    metadata = make_folder(out / "metadata" / name / ds.scene)
    publish(metadata / "points.txt", points_text(ds.points).encode())
    height = HABITAT_HEIGHT.get(name, HABITAT_HEIGHT["mp3d"])
    publish(metadata / "graph.pkl", pickle.dumps(habitat_graph(ds.graph(), height), protocol=4))
    ears = {a: make_folder(out / "binaural_rirs" / name / ds.scene / str(a)) for a in AZIMUTHS}
    fields = make_folder(out / "ambisonic_rirs" / name / ds.scene / "irs") if ambisonics else None
    c = ds.manifest.config.simulation.c
    turns = [((90.0 - a) % 360.0, 0.0, 0.0) for a in AZIMUTHS]
    for done, (s, l) in enumerate(ds):
        delay = float(np.linalg.norm(ds.points[s] - ds.points[l])) / c
        shift = ONSET - round(delay * ds.rate)
        for azimuth, response in zip(AZIMUTHS, ds.binaurals(s, l, turns), strict=True):
            publish(ears[azimuth] / f"{l}_{s}.wav", wav_bytes(_shifted(response, shift), ds.rate))
        if fields is not None:
            field = convert(ds.ambisonic(s, l), convention)
            publish(fields / f"{l}_{s}.wav", wav_bytes(_shifted(field, shift), ds.rate))
        if progress is not None:
            progress(done + 1, len(ds))
    return len(ds) * (len(AZIMUTHS) + bool(ambisonics))


def _shifted(response: np.ndarray, shift: int) -> np.ndarray:
    """Later by `shift` samples, or earlier if it is negative; the length goes along."""
    if shift >= 0:
        return np.pad(response, ((0, 0), (shift, 0)))
    return response[:, -shift:]
