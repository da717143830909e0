"""Air takes of every bin what it takes of a path of that length, whatever technique made it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import soundspaces_sim as ss
from tests import iso9613
from tests.rooms import box, plain, table


@pytest.mark.parametrize("transfer", [True, False])
def test_bins_keep_what_air_leaves_of_their_path(transfer: bool) -> None:
    """The same subpaths with air and without: their ratio is the band's mean over ISO 9613-1 at the length of
    the path, of single arrivals to 1e-4, of bins to what lengths differ by in them (6 % in a bin of 10 ms at
    most)."""
    scene = box((7.0, 5.0, 3.0), table(0.1, 0.4))
    echoes = [
        ss.simulate(
            scene, [1.5, 2.0, 1.2], [5.3, 3.1, 1.6],
            plain(walks=160, duration=0.6, denoise=False, radiance_transfer=transfer, air_absorption=air),
        )[0, 0]
        for air in (True, False)
    ]  # fmt: skip
    with_air, without = echoes
    bands = with_air.bands
    for a, b in zip(with_air.arrivals, without.arrivals, strict=True):
        expected = [iso9613.left(*band, 343.0 * a.delay) for band in pairwise(bands)]
        np.testing.assert_allclose(a.energy / b.energy, expected, rtol=1e-4)
    middles = 0.5 * (with_air.time_edges[1:] + with_air.time_edges[:-1])
    for i in np.flatnonzero((without.energy[:, 0] > 0.0).all(axis=1))[::5]:
        expected = [iso9613.left(*band, 343.0 * middles[i]) for band in pairwise(bands)]
        np.testing.assert_allclose(with_air.energy[i, 0] / without.energy[i, 0], expected, rtol=0.06)
