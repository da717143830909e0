"""Copies of scenes: Embree's handle is released once."""

from __future__ import annotations

import copy
import gc
import pickle
from collections.abc import Callable

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.scene.scene import Scene

CONFIG = ss.SimulationConfig(walks=16, duration=0.05)
POINTS = np.array([[1.0, 1.0, 1.2], [2.0, 1.5, 1.2]])


@pytest.mark.parametrize(
    "copied", [copy.copy, copy.deepcopy, lambda scene: pickle.loads(pickle.dumps(scene))]
)
def test_a_copy_outlives_the_scene(copied: Callable[[Scene], Scene]) -> None:
    """And the scene its copy; both simulate the same bits."""
    scene = ss.shoebox((3.0, 4.0, 2.5), absorption=0.3)
    before = ss.simulate(scene, POINTS[:1], POINTS[1:], CONFIG).energy
    again = copied(scene)
    for kept in (again, scene):
        np.testing.assert_array_equal(ss.simulate(kept, POINTS[:1], POINTS[1:], CONFIG).energy, before)
    gone = copied(scene)
    del gone, scene
    gc.collect()
    np.testing.assert_array_equal(ss.simulate(again, POINTS[:1], POINTS[1:], CONFIG).energy, before)


def test_echograms_are_pickled() -> None:
    scene = ss.shoebox((3.0, 4.0, 2.5), absorption=0.3)
    echoes = ss.simulate(scene, POINTS[:1], POINTS[1:], CONFIG)
    again = pickle.loads(pickle.dumps(echoes))
    del scene
    gc.collect()
    np.testing.assert_array_equal(again.energy, echoes.energy)
