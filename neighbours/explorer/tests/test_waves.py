"""The explorer on a dataset with waves."""

from __future__ import annotations

import numpy as np
from soundspaces_explorer import payloads
from soundspaces_parameters.of_waves import low_levels, octaves_below

import soundspaces_sim as ss
from neighbours.waves.tests.test_low_clients import ds as ds, folder as folder


def test_waves_are_those_of_the_reader(ds: ss.RirDataset) -> None:
    """Responses and measures of the explorer are those of the reader."""
    np.testing.assert_array_equal(payloads.response(ds, 0, 1, 0.0), ds.binaural(0, 1))
    found = payloads.pair(ds, 0, 1)
    assert found["measures"]["c80"] and found["waves"]["bands"] == [63.0, 125.0]
    for name, values in found["waves"]["measures"].items():
        own = ds.parameters(name, pairs=[(0, 1)], waves=True)[name][0, :2]
        np.testing.assert_allclose(np.array(values, float), own, rtol=0.0, atol=1e-4)
    wanted = low_levels(ds.low(0, 1), octaves_below(176.0))
    np.testing.assert_allclose(found["waves"]["level"], wanted, atol=0.01)
    assert payloads.pair(ds, 2, 2)["waves"]["edge"] == 176.0
    assert payloads.overview(ds)["points"]
