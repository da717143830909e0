"""Task: azimuth and distance of a talker in sight, from two seconds of first-order Ambisonics in noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soundspaces_sim import open_dataset
from soundspaces_tasks.baselines import Example, gathered, trained_rows
from soundspaces_tasks.fits import ridge
from soundspaces_tasks.results import Finish, Row, Score, TaskResult, interval, root
from soundspaces_tasks.setting import RATE, HomeJob, Setting
from soundspaces_tasks.speech import dry_speech, heard, log_energies, mel_bands, spectra

SECONDS, MELS = 2.0, 24
_STREAM = 2
_NEAR_M, _NEAR_DEG = 0.3, 15.0
_SCORES = (
    Score("Azimuth, degrees", digits=1),
    Score("Within 15°, %", higher=True, digits=0),
    Score("Distance, %", digits=1),
)
_ABOUT = f"""Given {SECONDS:g} s of speech at a first-order Ambisonic microphone (W, Y, Z, X) whose heading is
drawn, with noise 20 to 40 dB below it in each channel: in which direction is the talker, and how far? Talkers
are in sight, at least {_NEAR_M:g} m away. Levels are normalised. Directions and distances are those of the
points, without error.

Scores: mean magnitude of the error of azimuth; share of errors below {_NEAR_DEG:g}°; root mean square of the
natural logarithm of the ratio of distances, times 100.

- *fixed direction*: azimuth 0, and the geometric mean of the distances in the training homes. Azimuths are
  drawn evenly, so that an error of 90° is expected.
- *intensity*: azimuth of the active intensity, summed over time and frequency (Merimaa and Pulkki, JAES 2005);
  distance by ridge regression of its logarithm on the diffuseness in mel bands, fitted in the training homes.
- *network*: log-mel energies and intensities relative to energy, two convolutions over time, a GRU. Training
  turns examples about the vertical."""


class Examples(NamedTuple):
    """Of all homes: log-mel energies (n, frames, mels), intensities relative to energies (n, frames, mels, 3),
    the whole intensity (n, 3), diffuseness (n, mels), azimuths in degrees and distances in m (n, 2), rows of
    homes (n,)."""

    mel: np.ndarray
    intensity: np.ndarray
    whole: np.ndarray
    diffuseness: np.ndarray
    labels: np.ndarray
    home: np.ndarray


def intensity_of(short: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of spectra (4, frames, bins) in ACN order, SN3D: active intensity (frames, bins, 3) towards the source, and
    energy (frames, bins). Of a plane wave the former's length is the latter."""
    pressure, velocity = short[0], short[[3, 1, 2]]  # X, Y, Z
    towards = np.moveaxis((pressure.conj() * velocity).real, 0, -1)
    energy = 0.5 * (np.abs(pressure) ** 2 + (np.abs(velocity) ** 2).sum(axis=0))
    return towards, energy


def diffuseness_of(towards: np.ndarray, energy: np.ndarray) -> np.ndarray:
    """(bands,) 1 - |mean intensity| / mean energy, of (frames, bands, 3) and (frames, bands)."""
    length = np.linalg.norm(towards.sum(axis=0), axis=-1)
    return np.asarray(1.0 - length / np.maximum(energy.sum(axis=0), 1e-30))


def turned(response: np.ndarray, heading_deg: float) -> np.ndarray:
    """(4, n) W, Y, Z, X of (4, n) in world axes, for a microphone that faces `heading_deg`."""
    w, y, z, x = response
    cos, sin = np.cos(np.deg2rad(heading_deg)), np.sin(np.deg2rad(heading_deg))
    return np.stack([w, cos * y - sin * x, z, cos * x + sin * y])


def angle_between(one_deg: np.ndarray, other_deg: np.ndarray) -> np.ndarray:
    """Magnitudes of differences of azimuths, 0 to 180 degrees."""
    return np.asarray(np.abs((one_deg - other_deg + 180.0) % 360.0 - 180.0))


def azimuth_of(vectors: np.ndarray) -> np.ndarray:
    """(…) degrees of (…, 2 or 3), left of X positive."""
    return np.asarray(np.rad2deg(np.arctan2(vectors[..., 1], vectors[..., 0])))


def make_home(job: HomeJob) -> list[Example]:
    """What `Examples` holds, of each of a home's pairs."""
    rng = job.rng(_STREAM)
    bands, single = mel_bands(MELS), np.float32
    found: list[Example] = []
    with open_dataset(job.folder, rate=RATE) as ds:
        table = ds.table()
        table = table[(table["visible"] == 1) & (table["distance"] >= _NEAR_M)]
        for row in table[rng.permutation(len(table))[: job.pairs]]:
            s, l = int(row["source"]), int(row["listener"])
            heading = float(rng.uniform(0.0, 360.0))
            response = turned(ds.ambisonic(s, l)[:4], heading)
            towards, energy = intensity_of(spectra(heard(dry_speech(SECONDS, rng), response, rng)))
            in_bands = np.einsum("mb,tbx->tmx", bands, towards)
            power = energy @ bands.T
            relative = in_bands / np.maximum(power, 1e-12 * power.max())[..., None]
            azimuth = float(azimuth_of(ds.points[s] - ds.points[l])) - heading
            found.append(
                (
                    log_energies(energy, bands).astype(single),
                    relative.astype(single),
                    towards.sum(axis=(0, 1)),
                    diffuseness_of(in_bands, power),
                    np.array([azimuth, row["distance"]], float),
                )
            )
    return found


def run(setting: Setting) -> TaskResult:
    """Scores of all baselines."""
    data = Examples._make(gathered(setting, make_home))
    test = setting.within("test", data.home)
    methods = {"fixed direction": _fixed, "intensity": _intensity}
    rows, left_out = trained_rows(
        setting,
        "location",
        methods,
        [data],
        lambda name, count, found: _row(
            name, count, np.stack(found), data.labels[test], data.home[test]
        ),
        "degrees",
    )
    distances = data.labels[test, 1]
    facts = (
        f"{len(data.home)} examples of {len(setting.names)} homes, {int(test.sum())} of test homes, at "
        f"{distances.min():.1f} to {distances.max():.1f} m, median {np.median(distances):.1f} m.",
    )
    return TaskResult(
        "Direction and distance of a talker", _ABOUT, _SCORES, tuple(rows), (*facts, *left_out)
    )


def _row(name: str, count: int, found: np.ndarray, labels: np.ndarray, home: np.ndarray) -> Row:
    """Of (S, n, 2) azimuths and distances."""
    off = angle_between(found[..., 0], labels[:, 0])
    ratio = np.log(found[..., 1] / labels[:, 1])
    in_percent: Finish = lambda square: 100.0 * root(square)  # noqa: E731
    return Row(
        name,
        count,
        (
            interval(off, home),
            interval(100.0 * (off < _NEAR_DEG), home),
            interval(ratio**2, home, finish=in_percent),
        ),
    )


def _fixed(data: Examples, setting: Setting, count: int, seed: int) -> np.ndarray:
    use = setting.trained_on(count, seed, data.home)
    test = setting.within("test", data.home)
    mean = float(np.exp(np.log(data.labels[use, 1]).mean()))
    return np.tile((0.0, mean), (int(test.sum()), 1))


def _intensity(data: Examples, setting: Setting, count: int, seed: int) -> np.ndarray:
    use = setting.trained_on(count, seed, data.home)
    test = setting.within("test", data.home)
    fit = ridge(data.diffuseness[use], np.log(data.labels[use, 1:]), np.ones((int(use.sum()), 1)))
    distance = np.exp(fit(data.diffuseness[test])[:, 0])
    return np.stack([azimuth_of(data.whole[test]), distance], axis=1)
