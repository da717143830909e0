"""The field behind a replay's map, from echograms and from stored waveforms alone."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.pictures.replay import goal_field
from tests.nav.conftest import T_CORRIDOR

GOAL = T_CORRIDOR.index((0, 3))


def test_the_field_of_a_goal(data: NavData) -> None:
    """In a corridor of 1 m cells the direct sound at the neighbour is 0 dB, with or without echograms."""
    ds = ss.open_dataset(data.dataset("tee").path)
    with_echograms = goal_field(ds, GOAL)
    config = ds.manifest.config
    alone = msgspec.structs.replace(config.dataset, store="waveform")
    ds.manifest = msgspec.structs.replace(
        ds.manifest, config=msgspec.structs.replace(config, dataset=alone)
    )
    from_waveforms = goal_field(ds, GOAL)
    assert with_echograms.band == "775 to 3409 Hz" and from_waveforms.band == "all frequencies"
    for field in (with_echograms, from_waveforms):
        assert len(field.points) == len(ds.points) - 1  # not the goal's own
        np.testing.assert_array_equal(field.source, ds.points[GOAL])
        away = np.linalg.norm(field.points - field.source, axis=1)
        near = int(away.argmin())
        assert away[near] == pytest.approx(1.0) and field.visible[near]
        assert field.direct[near] == pytest.approx(1.0, abs=0.02)  # air
    np.testing.assert_array_equal(with_echograms.visible, from_waveforms.visible)
    rows = [n for n in range(len(ds.points)) if n != GOAL]
    away = np.linalg.norm(from_waveforms.points - from_waveforms.source, axis=1)
    for k, n in enumerate(rows):
        energy = 4.0 * np.pi * float(np.square(ds.ambisonic(GOAL, n)[0], dtype=float).sum())
        found = from_waveforms.direct[k] / away[k] ** 2 + from_waveforms.rest[k]
        assert found == pytest.approx(max(energy, from_waveforms.direct[k] / away[k] ** 2), rel=1e-6)
