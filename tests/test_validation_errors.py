"""Errors against measured rooms: pair by pair, and of the mean over pairs, on numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import validate
from benchmarks.accuracy import public_rooms
from benchmarks.accuracy.ptb_studio import of_means, pair_by_pair


def test_errors_of_pairs_do_not_average_out() -> None:
    """T30 of 1.1 and 1.9 s for 1 and 2 s: 10 % and 5 % are 2 and 1 JND; their means are alike, 1.5 s. C80 of 3
    and 1 dB for 1 and 2 dB: 2 and 1 JND, means 0.5 dB apart. D50: 0.05 is one JND."""
    values = {
        "T30": np.array([[1.1], [1.9]]),
        "C": np.array([[3.0], [1.0]]),
        "D": np.array([[0.5], [0.7]]),
    }
    wanted = {
        "T30": np.array([[1.0], [2.0]]),
        "C": np.array([[1.0], [2.0]]),
        "D": np.array([[0.6], [0.6]]),
    }
    single, means = pair_by_pair(values, wanted), of_means(values, wanted)
    np.testing.assert_allclose(single["T30"].ravel(), [2.0, 1.0], rtol=1e-12)
    np.testing.assert_allclose(single["C"].ravel(), [2.0, 1.0], rtol=1e-12)
    np.testing.assert_allclose(single["D"].ravel(), [2.0, 2.0], rtol=1e-12)
    for name, error in (("T30", 0.0), ("C", 0.5), ("D", 0.0)):
        assert means[name].item() == pytest.approx(error, abs=1e-12)


def test_where_the_mean_alone_is_published() -> None:
    """Every pair is compared with it; means of pairs are compared as before."""
    values, wanted = {"C": np.array([[3.0, 1.0], [1.0, 2.0]])}, {"C": np.array([[2.0, 1.0]])}
    np.testing.assert_allclose(pair_by_pair(values, wanted)["C"], [[1.0, 0.0], [1.0, 1.0]])
    np.testing.assert_allclose(of_means(values, wanted)["C"], [[0.0, 0.5]])


def test_a_table_has_both_with_the_spread_over_seeds(monkeypatch: pytest.MonkeyPatch) -> None:
    def figures(_walks: int) -> dict[str, validate.Figure]:
        def off(seed: int, _settings: dict[str, object]) -> tuple[dict[str, float], ...]:
            one = {"T20": 1.0 + seed, "EDT": 2.0, "C": 0.5, "D": 0.25}
            return one, {p: 0.1 * v for p, v in one.items()}

        return {"a room": off}

    monkeypatch.setattr(validate, "_figures", figures)
    monkeypatch.setattr(public_rooms, "available", lambda: ["elmia"])
    text = validate.pairs(400)
    assert "100 subpaths per point" in text
    assert "| a room, pair by pair | 2.00 ± 1.00 | 2.00 ± 0.00 | 0.50 ± 0.00 | 0.25 ± 0.00 |" in text
    assert "| a room, of the mean over pairs | 0.20 ± 0.10 |" in text
    assert "*seminar room (BRAS CR2): not made anew here, as its data were absent.*" in text
    assert "Elmia hall: not made" not in text
