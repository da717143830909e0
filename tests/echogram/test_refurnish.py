"""Echograms with other absorption: closures against exact generating functions, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.errors import MaterialError
from soundspaces_sim.echogram.echogram import Arrivals, Echogram
from soundspaces_sim.echogram.reflection_counts import (
    MaterialGroups,
    ReflectionCounts,
    change,
    row_count,
)
from soundspaces_sim.echogram.refurnish import absorption_of, log_ratios, refurnished

BANDS = (50.0, 500.0, 5000.0)
GROUPS = MaterialGroups(
    ("carpet", "plaster"),
    np.array([0.3, 0.7]),
    np.array([[0.2, 0.5], [0.05, 0.1]]),
    np.array([[0.0, 0.0], [0.0, 0.05]]),
)


def _counts(mean: np.ndarray, spread: float | np.ndarray, time: np.ndarray) -> ReflectionCounts:
    """Of independent groups whose variance is `spread` times their mean (W, M, b)."""
    lines = np.zeros((row_count(2), 2))
    lines[[0, 2]] = spread
    return ReflectionCounts(GROUPS, lines, np.broadcast_to(time[:, None], (len(time), 2)), mean)


def _echogram(counts: ReflectionCounts | None, bins: int = 40) -> Echogram:
    edges = np.linspace(0.0, 0.4, bins + 1)
    energy = np.zeros((bins, 9, 2), np.float32)
    energy[:, 0] = np.exp(-20.0 * edges[:-1])[:, None]
    early = Arrivals(
        np.array([0.02, 0.03]), np.ones((2, 2)), np.eye(3)[:2], np.array([[0, -1], [1, 2]]),
        groups=np.array([[0, -1], [1, 0]]),
    )  # fmt: skip
    return Echogram(BANDS, edges, energy, None, early, np.full((2, 2), 0.01), False, counts=counts)


def test_counts_of_poisson_and_gamma() -> None:
    """Losses that are gamma-distributed have an exact closure; Poisson-distributed counts, ln⟨e^{n x}⟩ = n̄ (e^x - 1),
    one that is off by less than the third-order term."""
    time = np.linspace(0.05, 0.35, 7)
    mean = (40.0 * time)[:, None, None] * np.array([[0.4, 0.2], [0.6, 0.8]])
    rng = np.random.default_rng(1)
    for _ in range(30):
        x = rng.uniform(-0.6, 0.3, (2, 2))
        found = change(_counts(mean, 1.0, time), x)
        exact = np.einsum("wmb,mb->wb", mean, np.exp(x) - 1.0)
        assert (np.abs(found.nepers - exact) < found.third + 1e-9).all() and (found.third > 0.0).all()
    x = np.array([[-0.5, -0.2], [0.0, 0.0]])
    for scale in (
        0.5,
        2.0,
    ):  # n gamma-distributed with variance scale n̄: ⟨e^{n x}⟩ = (1 - scale x)^(-n̄ / scale)
        found = change(_counts(mean, scale, time), x)
        np.testing.assert_allclose(
            found.nepers, -mean[:, 0] / scale * np.log(1.0 - scale * x[0]), rtol=1e-12
        )


def test_nothing_changes_with_the_same_materials() -> None:
    echogram = _echogram(_counts(np.full((3, 2, 2), 4.0), 1.0, np.array([0.1, 0.2, 0.3])))
    same = refurnished(echogram, {"carpet": [0.2, 0.5], "plaster": [0.05, 0.1]})
    np.testing.assert_allclose(same.energy, echogram.energy, rtol=1e-6)
    np.testing.assert_array_equal(same.early.energy, echogram.early.energy)
    np.testing.assert_allclose(same.relative_error, echogram.relative_error, rtol=1e-6)


def test_discrete_arrivals_change_by_what_reflected_them() -> None:
    """ρ' / ρ for each reflection by a group, ρ = 1 - α - τ; no other arrival changes."""
    echogram = _echogram(_counts(np.full((3, 2, 2), 1.0), 1.0, np.array([0.1, 0.2, 0.3])))
    other = refurnished(echogram, {"carpet": 0.4, "plaster": {125.0: 0.1, 2000.0: 0.2}})
    carpet, plaster = 0.6 / np.array([0.8, 0.5]), np.array([0.9 / 0.95, 0.75 / 0.85])
    np.testing.assert_allclose(other.early.energy, [carpet, carpet * plaster], rtol=1e-12)
    assert other.counts is None


def test_error_bars_hold_the_error_of_the_closure() -> None:
    echogram = _echogram(_counts(np.full((3, 2, 2), 3.0), 1.0, np.array([0.1, 0.2, 0.3])))
    assert echogram.counts is not None
    found = change(echogram.counts, log_ratios(GROUPS, absorption_of(GROUPS, BANDS, {"carpet": 0.4})))
    other = refurnished(echogram, {"carpet": 0.4})
    np.testing.assert_allclose(other.relative_error[1], np.hypot(0.01, found.third[0]), rtol=1e-6)
    moved = refurnished(echogram, {"carpet": 0.4}, off=1.0)
    np.testing.assert_allclose(
        moved.energy[:, 0] / other.energy[:, 0], np.exp(found.third[:1]).repeat(40, 0), rtol=1e-5
    )


def test_what_is_refused() -> None:
    counts = _counts(np.full((3, 2, 2), 6.0), 2.0, np.array([0.1, 0.2, 0.3]))
    echogram = _echogram(counts)
    for materials, words in (
        ({"marble": 0.1}, "'marble' were not counted, only those by carpet, plaster"),
        ({"carpet": 1.0}, "'carpet' must lie from 0 to below 1"),
        ({"plaster": 0.96}, "below 0.95.* between 500 and 5000 Hz"),
        ({"carpet": float("nan")}, "'carpet' must lie"),
        ({"carpet": -0.1}, "'carpet' must lie"),
        ({"carpet": [0.1, 0.2, 0.3]}, "must be a number, 2 of them"),
        ({"carpet": {}}, "must be a number"),
        ({"carpet": {0.0: 0.1}}, "must be a number"),
        ({"carpet": "soft"}, "must be a number"),
        ({"carpet": [[0.1, 0.2]]}, "must be a number"),
        ("carpet", "expected {name: absorption} or a MaterialTable"),
        ({"carpet": 0.9}, "'carpet' changes too much, from 0.2/0.5 to 0.9/0.9.*simulate anew"),
    ):
        with pytest.raises(MaterialError, match=words):
            refurnished(echogram, materials)  # type: ignore[arg-type]
    assert refurnished(echogram, {"carpet": 0.9}, force=True).energy.max() > 0.0
    with pytest.raises(MaterialError, match="has no counts of reflections"):
        refurnished(replace(echogram, counts=None), {"carpet": 0.3})


def test_a_table_of_materials() -> None:
    """Its rows of groups are taken in bands; its other rows do not matter."""
    none, absorption = np.zeros((2, 2)), np.array([[0.2, 0.3], [0.1, 0.1]])
    table = ss.MaterialTable(("plaster", "marble"), np.array([250.0, 2000.0]), absorption, none, none)
    found = absorption_of(GROUPS, BANDS, table)
    expected, _, _ = table.in_bands(BANDS)
    np.testing.assert_array_equal(found, [GROUPS.absorption[0], expected[0]])
