"""Export in the layout that clients of SoundSpaces 1 read (data/metadata, binaural_rirs, ambisonic_rirs).

Its responses carry no propagation delay, and some clients drop the first 128 samples: the direct sound's
time is moved to sample `ONSET`. Azimuth 0 faces +Y, 90 faces +X: heading = 90° - azimuth.

Clients find a point's node by taking `HABITAT_HEIGHT` from its height. So that nodes lie on the floor, points of a
grid at another height are written at that one, a few centimetres off; given points are written as they are.
"""

from __future__ import annotations

import logging
import pickle
from pathlib import Path

import numpy as np

from soundspaces_sim import ConfigError, RirDataset
from soundspaces_sim.parts import (
    HABITAT_HEIGHT,
    SECOND_ORDER_CHANNELS as CHANNELS,
    WAV_HEADER as HEADER,
    Convention,
    ExportPlan,
    ExportProgress as Progress,
    check_headings,
    choose_pairs,
    convert_ambisonics as convert,
    habitat_graph,
    make_folder,
    points_text,
    publish_file as publish,
    response_samples_of as samples_of,
    wav_bytes,
)

_log = logging.getLogger(__name__)
ONSET = 256
RATES = {"replica": 44100, "mp3d": 16000}  # Hz, at which clients read the files
AZIMUTHS = (0.0, 90.0, 180.0, 270.0)


def plan_soundspaces1(
    ds: RirDataset,
    out: str | Path,
    name: str = "replica",
    ambisonics: bool = True,
    headings: tuple[float, ...] = AZIMUTHS,
    pairs: str | Path = "nodes",
    convention: Convention = "soundspaces1",
) -> ExportPlan:
    """One dataset under `out`. Responses are those of the dataset's rate.

    `name`: ``replica`` or ``mp3d``, the dataset's folder, which also decides the agent's height in graph.pkl.
    `headings`: azimuths of SoundSpaces, which name the folders. `pairs`: see `plan.choose_pairs`; by default
    all pairs of points where an agent can stand, one with itself included: to a client, a missing file is an
    error. points.txt has every point.
    """
    if name not in HABITAT_HEIGHT:
        raise ConfigError(f"name: expected {' or '.join(HABITAT_HEIGHT)}, got {name!r}")
    _check_rate(ds, name)
    azimuths = check_headings(headings)
    rows = choose_pairs(ds, pairs)
    out = Path(out)
    files = len(rows) * (len(azimuths) + ambisonics)
    channels = 2 * len(azimuths) + CHANNELS * ambisonics
    distance = np.linalg.norm(ds.points[rows[:, 0]] - ds.points[rows[:, 1]], axis=1)
    delay = np.rint(distance / ds.manifest.config.simulation.c * ds.rate).astype(int)
    size = HEADER * files + channels * 4 * int((samples_of(ds) + ONSET - delay).sum())

    kinds = ("metadata", "binaural_rirs", "ambisonic_rirs")
    metadata, binaural, ambisonic = (out / kind / name / ds.scene for kind in kinds)

    def write(progress: Progress) -> None:
        _write_metadata(ds, make_folder(metadata), HABITAT_HEIGHT[name])
        ears = {a: make_folder(binaural / f"{a:g}") for a in azimuths}
        fields = make_folder(ambisonic / "irs") if ambisonics else None
        turns = [((90.0 - a) % 360.0, 0.0, 0.0) for a in azimuths]
        for done, (s, l) in enumerate(rows.tolist()):
            shift = ONSET - int(delay[done])
            heard = ds.binaurals(s, l, turns) if turns else ()
            for azimuth, response in zip(azimuths, heard, strict=True):
                publish(
                    ears[azimuth] / f"{l}_{s}.wav",
                    wav_bytes(_shifted(response, shift), ds.rate),
                    durable=False,
                )
            if fields is not None:
                field = convert(ds.ambisonic(s, l), convention)
                publish(
                    fields / f"{l}_{s}.wav", wav_bytes(_shifted(field, shift), ds.rate), durable=False
                )
            progress(done + 1, len(rows))

    return ExportPlan(
        out, files, size, write, [metadata, binaural, *([ambisonic] if ambisonics else [])]
    )


def _check_rate(ds: RirDataset, name: str) -> None:
    """Clients play the samples at the rate of their own settings, whatever the files say."""
    if ds.rate == RATES[name]:
        return
    if name == "mp3d" and ds.rate == ds.manifest.config.dataset.rate:
        raise ConfigError(
            f"rate: clients read {name} at {RATES[name]} Hz, this dataset is made for {ds.rate} Hz; say --rate "
            f"{RATES[name]} (or another one, to clients that are set to it)"
        )
    _log.warning("clients read %s at %d Hz; this export has %d Hz", name, RATES[name], ds.rate)


def _write_metadata(ds: RirDataset, folder: Path, height: float) -> None:
    above = ds.manifest.height
    lift = 0.0 if above is None else height - above
    if abs(lift) > 1e-6:
        _log.warning(
            "%s: points are written %+.4f m higher than they were simulated, so that the nodes of graph.pkl lie on "
            "the floor; a grid of height %g m needs no such change",
            ds.scene,
            lift,
            height,
        )
    publish(
        folder / "points.txt",
        points_text(ds.points + np.array([0.0, 0.0, lift])).encode(),
        durable=False,
    )
    publish(
        folder / "graph.pkl",
        pickle.dumps(habitat_graph(ds.graph(), height - lift), protocol=4),
        durable=False,
    )


def _shifted(response: np.ndarray, shift: int) -> np.ndarray:
    """Later by `shift` samples, or earlier if it is negative; the length goes along."""
    if shift >= 0:
        return np.pad(response, ((0, 0), (shift, 0)))
    return response[:, -shift:]
