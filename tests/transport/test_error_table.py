"""Stated errors against the spread over seeds (docs/validation.md): two homes, a room and the demo."""

from __future__ import annotations

import numpy as np
import pytest

from tests.transport.error_table import LISTENERS, NAMES, spreads

SEEDS = 24
SCENES = ["home-7001", "home-7005", "room-7002", "demo"]


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_stated_errors_are_the_spread_over_seeds(name: str) -> None:
    """z is 1 in the root mean square, in the mean over bands. Its square over so many independent values has the
    error sqrt(2 / number), of which three are allowed: early energy of four listeners as so many values; all others,
    which one end's subpaths move together, as one."""
    found, counted = spreads(name, 3000, SEEDS)
    assert counted[:2].min() >= 0.75
    squares = np.nanmean(np.square(found), axis=1)
    assert abs(squares[NAMES.index("early")] - 1.0) < 3.0 * np.sqrt(2.0 / (SEEDS * LISTENERS)), found
    assert (np.abs(squares - 1.0) < 3.0 * np.sqrt(2.0 / SEEDS)).all(), dict(
        zip(NAMES, found, strict=True)
    )
