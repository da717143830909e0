"""Small worlds on lattices of 1 m cells, made of boxes, with known ways."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.dataset.format.splits import write_splits
from soundspaces_sim.nav.data import NavData
from soundspaces_sim.nav.views import bake_views
from soundspaces_sim.scene.generate.demo import Box, boxes_mesh
from tests.rooms import table

pytest.importorskip("gymnasium", reason="the extra `nav` is not installed")

Cell = tuple[int, int]
T_CORRIDOR = [(i, 3) for i in range(7)] + [(3, j) for j in range(3)]


def lattice_scene(cells: Iterable[Cell], name: str) -> ss.Scene:
    """Rooms and corridors of free cells: floor, ceiling at 2.5 m, a wall on every edge to what is not free."""
    free = set(cells)
    boxes: list[Box] = []
    for i, j in sorted(free):
        boxes.append(("floor", i - 0.1, j - 0.1, -0.1, i + 1.1, j + 1.1, 0.0))
        boxes.append(("ceiling", i - 0.1, j - 0.1, 2.5, i + 1.1, j + 1.1, 2.6))
        if (i - 1, j) not in free:
            boxes.append(("wall", i - 0.1, j - 0.1, 0.0, i, j + 1.1, 2.5))
        if (i + 1, j) not in free:
            boxes.append(("wall", i + 1, j - 0.1, 0.0, i + 1.1, j + 1.1, 2.5))
        if (i, j - 1) not in free:
            boxes.append(("wall", i, j - 0.1, 0.0, i + 1, j, 2.5))
        if (i, j + 1) not in free:
            boxes.append(("wall", i, j + 1, 0.0, i + 1, j + 1.1, 2.5))
    mesh = boxes_mesh(boxes, name)
    return ss.Scene(
        mesh.vertices,
        mesh.faces,
        np.zeros(len(mesh.faces), int),
        table(0.25, 0.3),
        mesh.labels,
        mesh.face_label,
        name,
    )


def lattice_dataset(
    cells: Iterable[Cell], out: Path, name: str, walks: int = 64, rate: int = 16000
) -> Path:
    """A dataset with a point in the middle of every cell, in the order given."""
    cells = list(cells)
    points = np.array([(i + 0.5, j + 0.5, 1.5) for i, j in cells])
    job = ss.JobConfig(
        grid=ss.GridConfig(spacing=1.0, rays=64),
        simulation=ss.SimulationConfig(
            walks=walks,
            connections=ss.ConnectionsConfig(subpaths=8),
            duration=0.5,
            radiance_transfer=ss.RadianceTransferConfig(enabled=False),  # the dearest of all for so few
            reflection="random",  # by angle single subpaths of so few are louder than the direct sound
        ),
        dataset=type(ss.JobConfig().dataset)(rate=rate),
    )
    return ss.build_dataset(lattice_scene(cells, name), out, job, points=points).folder


#: Two corridors side by side, connected at both ends and in the middle: ways with turns, and more than one of them.
LADDER = [(i, j) for j in (0, 2) for i in range(6)] + [(0, 1), (3, 1), (5, 1)]


@pytest.fixture(scope="session")
def graphs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes, one per split."""
    root = tmp_path_factory.mktemp("worlds")
    lattice_dataset(T_CORRIDOR, root, "tee")
    lattice_dataset(LADDER, root, "ladder")
    write_splits(root, {"train": ("ladder",), "test": ("tee",)})
    return root


@pytest.fixture(scope="session")
def data(graphs: Path) -> NavData:
    return NavData(graphs)


@pytest.fixture(scope="session")
def seen_data(graphs: Path, tmp_path_factory: pytest.TempPathFactory) -> NavData:
    """Copies of them with depth."""
    root = tmp_path_factory.mktemp("seen") / "worlds"
    shutil.copytree(graphs, root)
    data = NavData(root)
    for name, cells in (("tee", T_CORRIDOR), ("ladder", LADDER)):
        bake_views(data.dataset(name), scene=lattice_scene(cells, name))
    return data


@pytest.fixture(scope="session")
def two_nodes(tmp_path_factory: pytest.TempPathFactory) -> NavData:
    """A corridor of two cells."""
    root = tmp_path_factory.mktemp("two")
    lattice_dataset([(0, 0), (1, 0)], root, "pair")
    return NavData(root)
