"""The reported standard errors are right, and fall as one over the root of the number of walks."""

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.transport.model import EARLY_S
from tests.rooms import plain, two_rooms
from tests.stats import repeat
from tests.transport.test_agreement import MIXED

SOURCES, LISTENERS = [[1.2, 1.0, 1.2], [6.5, 2.8, 1.4]], [[3.0, 3.0, 1.3], [5.0, 1.5, 1.5]]


def _energies(walks: int, seed: int, merging: bool = True) -> np.ndarray:
    """(2, pairs, windows, bands): energies and their reported relative errors."""
    echoes = ss.simulate(
        two_rooms(MIXED, 1),
        SOURCES,
        LISTENERS,
        plain(walks=walks, specular_ratio=4, duration=0.4, merging=merging),
        seed,
    )
    out = []
    for s in range(2):
        for l in range(2):
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


@pytest.mark.parametrize("merging", [False, True])
def test_variance_falls_as_one_over_walks(merging: bool) -> None:
    """Merges add a part that falls as one over walks squared."""
    few = repeat(lambda seed: _energies(160, seed, merging)[0], 40).var(axis=0, ddof=1)
    many = repeat(lambda seed: _energies(1280, seed, merging)[0], 40).var(axis=0, ddof=1)
    ratio = np.exp(np.log(few / many).mean(axis=(0, 2)))
    # joins rise with the walks only through `walks`; the late window has none
    if merging:
        assert 8.0 * 0.65 < ratio[1] < 64.0
    else:
        assert ratio[1] == pytest.approx(8.0, rel=0.35)


def test_target_error_is_reached_where_it_was_not() -> None:
    """Every pair ends below the target; one alone gets what it gets among others; easy ones keep theirs."""
    scene = two_rooms(MIXED, 1)
    config = plain(walks=160, duration=0.3, target_error=0.08)
    one_round = ss.simulate(scene, SOURCES, LISTENERS, plain(walks=160, duration=0.3))
    echoes = ss.simulate(scene, SOURCES, LISTENERS, config)
    assert one_round.relative_error.max() > 0.08
    assert echoes.relative_error.max() <= 0.08
    alone = ss.simulate(scene, SOURCES[1], LISTENERS[0], config)
    np.testing.assert_array_equal(alone[0, 0].energy, echoes[1, 0].energy)
    np.testing.assert_array_equal(alone[0, 0].relative_error, echoes[1, 0].relative_error)
    loose = ss.simulate(scene, SOURCES, LISTENERS, plain(walks=160, duration=0.3, target_error=10.0))
    np.testing.assert_array_equal(loose.energy, one_round.energy)


def test_target_error_gives_up_at_max_walks() -> None:
    config = plain(walks=160, duration=0.3, target_error=1e-6, max_walks=480)
    echoes = ss.simulate(two_rooms(MIXED, 1), SOURCES[0], LISTENERS[0], config)
    single = ss.simulate(two_rooms(MIXED, 1), SOURCES[0], LISTENERS[0], plain(walks=160, duration=0.3))
    ratio = echoes.relative_error / single.relative_error
    assert np.all(ratio > 0.3) and np.median(ratio) == pytest.approx(3**-0.5, rel=0.5)
