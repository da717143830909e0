"""Networks of the tasks (extra ``torch``): inputs, targets and losses for `networks.train`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from soundspaces_tasks import decays
from soundspaces_tasks.fits import weighted_mean
from soundspaces_tasks.networks import Attention, Data, Mask, Regressor, train
from soundspaces_tasks.setting import Setting
from soundspaces_tasks.speech import spectra

if TYPE_CHECKING:
    from soundspaces_tasks.dereverberation import Examples as Heard
    from soundspaces_tasks.location import Examples as Located
    from soundspaces_tasks.reverberation import Examples

_COMPRESSION = 0.3  # exponent of magnitudes
_SCALE_DB = 10.0  # that is 1 in a network


def reverberation(
    data: Examples, weights: np.ndarray, setting: Setting, count: int, seed: int
) -> np.ndarray:
    """(n, k) estimates of the k labels for the test homes."""
    use = setting.trained_on(count, seed, data.home)
    val, test = (setting.within(split, data.home) for split in ("val", "test"))
    centre = weighted_mean(data.labels[use], weights[use])
    scale = np.sqrt(weighted_mean((data.labels[use] - centre) ** 2, weights[use])) + 1e-9
    share = weights / weights[use].max(axis=0)
    targets = np.concatenate([np.nan_to_num((data.labels - centre) / scale), share], axis=1)
    low, spread = data.mel[use].mean(axis=(0, 1)), data.mel[use].std(axis=(0, 1)) + 1e-6
    inputs = (data.mel - low) / spread

    def loss(found: Tensor, wanted: Tensor) -> Tensor:
        aim, weight = wanted.chunk(2, 1)
        return torch.mean(weight * (found - aim) ** 2)

    fitted = train(
        lambda: Regressor(data.mel.shape[2], targets.shape[1] // 2),
        Data(inputs[use], targets[use]),
        Data(inputs[val], targets[val]),
        loss,
        seed,
        setting.updates,
    )
    return np.asarray(centre + scale * fitted(inputs[test]))


def prediction(data: decays.Examples, setting: Setting, count: int, seed: int) -> np.ndarray:
    """(n, LENGTH) decay curves for the test homes, in dB."""
    use = setting.trained_on(count, seed, data.home)
    val, test = (setting.within(split, data.home) for split in ("val", "test"))
    known = decays.REFERENCES
    own, apart = data.distances[:, 1 : 1 + known], data.distances[:, 1 + known :]
    target = np.broadcast_to(data.distances[:, :1], own.shape)
    features = np.log(np.stack([target, own, apart], axis=2) + 0.1)  # distances of 0.1 m and more
    curves = decays.at_knots(data.references)
    level = curves[use].mean()
    inputs = np.concatenate([(curves - level) / _SCALE_DB, features], axis=2)
    targets = (decays.at_knots(data.curve) - level) / _SCALE_DB
    fitted = train(
        lambda: Attention(features.shape[2], curves.shape[2]),
        Data(inputs[use], targets[use]),
        Data(inputs[val], targets[val]),
        lambda found, wanted: torch.mean(torch.abs(found - wanted)),
        seed,
        3 * setting.updates,  # each takes a millisecond
    )
    return decays.from_knots(level + _SCALE_DB * fitted(inputs[test]))


def location(data: Located, setting: Setting, count: int, seed: int) -> np.ndarray:
    """(n, 2) azimuths in degrees and distances in m for the test homes."""
    use = setting.trained_on(count, seed, data.home)
    val, test = (setting.within(split, data.home) for split in ("val", "test"))
    low, spread = data.mel[use].mean(axis=(0, 1)), data.mel[use].std(axis=(0, 1)) + 1e-6
    vectors = np.moveaxis(data.intensity, 3, 2).reshape(
        *data.intensity.shape[:2], -1
    )  # x, then y, then z
    inputs = np.concatenate([(data.mel - low) / spread, vectors], axis=2)
    angle, log = np.deg2rad(data.labels[:, 0]), np.log(data.labels[:, 1])
    centre, scale = log[use].mean(), log[use].std() + 1e-9
    targets = np.stack([np.cos(angle), np.sin(angle), (log - centre) / scale], axis=1)
    bands = data.mel.shape[2]

    def loss(found: Tensor, wanted: Tensor) -> Tensor:
        return torch.mean((found - wanted) ** 2)

    def turn(x: Tensor, y: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        by = 2.0 * torch.pi * torch.rand(len(x), 1, generator=generator)
        cos, sin = torch.cos(by), torch.sin(by)
        parts = x.split(bands, 2)  # energies, x, y, z
        c, s = cos[:, :, None], sin[:, :, None]
        inside = torch.cat(
            [parts[0], c * parts[1] - s * parts[2], s * parts[1] + c * parts[2], parts[3]], 2
        )
        aim = torch.cat(
            [cos * y[:, :1] - sin * y[:, 1:2], sin * y[:, :1] + cos * y[:, 1:2], y[:, 2:]], 1
        )
        return inside, aim

    fitted = train(
        lambda: Regressor(inputs.shape[2], 3),
        Data(inputs[use], targets[use]),
        Data(inputs[val], targets[val]),
        loss,
        seed,
        setting.updates,
        turn,
    )
    found = fitted(inputs[test])
    azimuth = np.rad2deg(np.arctan2(found[:, 1], found[:, 0]))
    return np.stack([azimuth, np.exp(centre + scale * found[:, 2])], axis=1)


def dereverberation(data: Heard, setting: Setting, count: int, seed: int) -> list[np.ndarray]:
    """Gains (frames, bins) for each pair of the test homes."""
    use = setting.trained_on(count, seed, data.home)
    val, test = (setting.within(split, data.home) for split in ("val", "test"))

    def loudness(signals: np.ndarray) -> np.ndarray:
        return np.asarray(np.abs(spectra(signals)).astype(np.float32) ** _COMPRESSION)

    def both(rows: np.ndarray) -> Data:
        inside = loudness(data.heard[rows])
        return Data(inside, np.stack([inside, loudness(data.wanted[rows])], axis=3))

    def loss(found: Tensor, wanted: Tensor) -> Tensor:
        return torch.mean((found**_COMPRESSION * wanted[..., 0] - wanted[..., 1]) ** 2)

    trained = both(use)
    bins = trained.x.shape[2]
    fitted = train(lambda: Mask(bins), trained, both(val), loss, seed, setting.updates)
    return list(fitted(loudness(data.heard[test])))
