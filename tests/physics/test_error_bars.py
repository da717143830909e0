"""The reported standard errors are right, and fall as one over the root of the number of walks."""

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.simulate import EARLY_S
from tests.physics.test_agreement import MIXED
from tests.rooms import plain, two_rooms
from tests.stats import repeat

SOURCES, LISTENERS = [[1.2, 1.0, 1.2], [6.5, 2.8, 1.4]], [[3.0, 3.0, 1.3], [5.0, 1.5, 1.5]]


def _energies(walks: int, seed: int) -> np.ndarray:
    """(2, pairs, windows, bands): energies and their reported relative errors."""
    echoes = ss.simulate(two_rooms(MIXED, 1), SOURCES, LISTENERS, plain(walks=walks, duration=0.4), seed)
    out = []
    for s in range(2):
        for l in range(2):  # noqa: E741
            e = echoes[s, l]
            k = int(np.searchsorted(e.time_edges, echoes.direct_length[s, l] / 343.0 + EARLY_S))
            energy = e.energy[:, 0].astype(float)
            early = energy[:k].sum(axis=0) + sum(a.energy for a in e.arrivals)
            out.append([np.stack([early, energy[k:].sum(axis=0)]), e.relative_error])
    return np.array(out).transpose(1, 0, 2, 3)


@pytest.mark.slow
@pytest.mark.parametrize("walks", [400, 2000])
def test_error_bars_are_calibrated(walks: int) -> None:
    """Over many seeds the z-scores have standard deviation 1 +- 0.15."""
    samples = repeat(lambda seed: _energies(walks, seed), 120)
    energy, error = samples[:, 0], samples[:, 1]
    mean = energy.mean(axis=0)
    z = (energy - mean) / (error * mean)
    assert np.all(np.abs(z.std(axis=(0, 1, 3)) - 1.0) < 0.15), z.std(axis=(0, 1, 3))


def test_variance_falls_as_one_over_walks() -> None:
    few = repeat(lambda seed: _energies(400, seed)[0], 40).var(axis=0, ddof=1)
    many = repeat(lambda seed: _energies(6400, seed)[0], 40).var(axis=0, ddof=1)
    ratio = np.exp(np.log(few / many).mean(axis=(0, 2)))
    # joins rise with the walks only through `walks`; the late window has none
    assert ratio[1] == pytest.approx(16.0, rel=0.35)
