"""Stated errors against the spread over seeds (docs/validation.md): homes, an office and a room."""

from __future__ import annotations

import numpy as np
import pytest

from tests.transport.error_table import LISTENERS, NAMES, spreads

SEEDS = 24
SCENES = ["home-7001", "home-7003", "home-7005", "home-7011", "office-7001", "room-7002"]


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_stated_errors_are_the_spread_over_seeds(name: str) -> None:
    """z is 1 in the root mean square. Its square over so many independent values has the error sqrt(2 / number), of
    which three are allowed: early energy of four listeners as so many values, in the mean over bands; all
    others, which one end's subpaths move together, as one. Early was 1.17 to 1.66 in homes where patches of a
    group were taken for alike."""
    found, counted = spreads(name, 3000, SEEDS)
    early, late = (NAMES.index(what) for what in ("early", "late"))
    assert counted[late].min() >= 0.75
    squares = np.square(found)
    assert np.isfinite(squares[early]).any()
    assert abs(np.nanmean(squares[early]) - 1.0) < 3.0 * np.sqrt(2.0 / (SEEDS * LISTENERS))
    for what, of_bands in zip(NAMES, squares, strict=True):
        known = of_bands[np.isfinite(of_bands)]
        assert (known < 1.0 + 3.0 * np.sqrt(2.0 / SEEDS)).all(), (what, of_bands)
