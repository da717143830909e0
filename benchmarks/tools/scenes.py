"""Scenes that several benchmarks share."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

import soundspaces_sim as ss
from benchmarks.tools.record import ROOT, UnavailableError
from tests.rooms import table as materials

SHARED = ROOT.parent / "shared"
HOUSE = SHARED / "scenes" / "aws_small_house"
BOX = (6.0, 5.0, 2.7)
ABSORPTION, SCATTERING = 0.2, 0.3
_WITHIN = np.array([[1.001], [0.999]])  # of a band's edges, between which values are constant


def require(path: Path) -> Path:
    """The path. Raises `UnavailableError` where it is absent."""
    if not path.exists():
        raise UnavailableError(f"{path} is absent")
    return path


def house() -> ss.Scene:
    """aws_small_house as labelled. Raises `UnavailableError` where ../shared lacks it."""
    return ss.load_scene(require(HOUSE))


def shuffled_points(scene: ss.Scene, spacing: float = 1.0) -> np.ndarray:
    """(n, 3) points of a scene's grid in an order that is always the same."""
    grid = ss.make_grid(scene, spacing).points
    return np.asarray(grid[np.random.default_rng(0).permutation(len(grid))])


def one_material(scene: ss.Scene) -> ss.Scene:
    """The scene with one material on all surfaces."""
    table, zeros = materials(ABSORPTION, SCATTERING), np.zeros(len(scene.faces), int)
    return ss.Scene(scene.vertices, scene.faces, zeros, table, name=scene.name)


def in_own_bands(scene: ss.Scene, edges: np.ndarray, *values: np.ndarray) -> ss.Scene:
    """The scene with absorption, scattering and transmission (m, b) of its materials, constant between `edges`
    (b + 1,), Hz above 0."""
    materials = scene.materials
    frequency = (_WITHIN * np.array([edges[:-1], edges[1:]])).T.ravel()
    columns = ss.MaterialTable(
        materials.names,
        frequency,
        *(np.repeat(value, 2, axis=1) for value in values),
        reflection=materials.reflection,
        mounting=materials.mounting,
    )
    return replace(scene, materials=columns)


def shoebox(scattering: float = SCATTERING) -> ss.Scene:
    """The box with that material, or another scattering."""
    mesh = trimesh.creation.box(extents=BOX)
    table = materials(ABSORPTION, scattering)
    zeros = np.zeros(len(mesh.faces), int)
    return ss.Scene(mesh.vertices + np.array(BOX) / 2.0, mesh.faces, zeros, table, name="shoebox")
