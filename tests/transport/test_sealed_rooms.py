"""No sound passes where none can, and what an opening lets pass is what an independent tracer says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import soundspaces_sim as ss
from tests.marks import few
from tests.rooms import box, plain, table, two_rooms
from tests.stats import limit, repeat
from tests.transport.forward_tracer import forward_echogram
from tests.transport.partitions import sealed_cells

TRANSFER: tuple[dict[str, Any], ...] = ({"subpaths": "shared"}, {"subpaths": "own"}, {"enabled": False})


def _check_cells(seed: int, transfer: dict[str, Any], walks: int) -> None:
    """Every band and bin between two cells is exactly zero, and none is within a cell."""
    cells = sealed_cells(np.random.default_rng(seed))
    chosen = ss.RadianceTransferConfig(**transfer)
    config = ss.SimulationConfig(walks=walks, duration=0.12, radiance_transfer=chosen)
    echoes = ss.simulate(cells.scene, cells.points, cells.points, config, seed)
    what = f"seed {seed}: {cells.what}, {transfer}"
    for i in range(len(cells.points)):
        for j in range(len(cells.points)):
            energy = echoes[i, j].histogram(0.01)  # of direct sound and early paths too
            assert np.all(energy == 0.0) if i != j else np.all(energy.sum(axis=1) > 0.0), what


@pytest.mark.parametrize("k", few(range(6), 0))
def test_nothing_passes_partitions(k: int) -> None:
    for seed in range(5 * k, 5 * (k + 1)):
        _check_cells(seed, TRANSFER[seed % 3], 24)


@pytest.mark.slow
@pytest.mark.parametrize("group", range(10))
def test_nothing_passes_many_partitions(group: int) -> None:
    for seed in range(1000 + 30 * group, 1000 + 30 * (group + 1)):
        for transfer in TRANSFER:
            _check_cells(seed, transfer, 128)


@pytest.mark.parametrize("gap", [1e-6, 1e-4, 1e-3])
def test_a_hairline_lets_pass_little(gap: float) -> None:
    """An opening of S m² between rooms of absorption area A lets pass S / A of the energy: below −30 dB for 1 mm, and
    never the −20 dB that area on both sides of the wall gave."""
    scene = two_rooms(table(0.3, 0.5), door=False, gap=gap)
    points = np.array([[1.2, 1.0, 1.2], [6.5, 2.8, 1.4]])
    echoes = ss.simulate(scene, points, points, plain(walks=256, duration=0.2))
    near, far = (echoes[0, k].histogram(0.2)[:, 0].mean() for k in range(2))
    assert far < 2.0 * near * (4.0 * gap / 20.0) + 1e-6 * near


def _with_opening(kind: str) -> ss.Scene:
    """Two rooms of 3 x 3 x 2.4 m and a partition that is not welded to them, with an opening."""
    room, thick = box((6.0, 3.0, 2.4), table(0.2, 0.5)), 0.0 if kind != "thick" else 0.12
    boxes = {
        "sheet": [
            (0.0, 1.3, 0.0, 2.4),
            (1.7, 3.0, 0.0, 2.4),
            (1.3, 1.7, 0.0, 0.9),
            (1.3, 1.7, 1.3, 2.4),
        ],
        "below the ceiling": [(-0.2, 3.1, -0.1, 2.2)],
        "thick": [(0.0, 2.6, 0.0, 2.4), (2.6, 3.0, 0.0, 1.8)],
    }[kind]
    vertices, faces = [room.vertices], [room.faces]
    count = len(room.vertices)
    for y0, y1, z0, z1 in boxes:
        if thick:
            part = box((thick, y1 - y0, z1 - z0), table(0.2, 0.5))
            vertices.append(part.vertices + [3.03, y0, z0])
            faces.append(part.faces + count)
        else:
            vertices.append(np.array([[3.03, y0, z0], [3.03, y1, z0], [3.03, y1, z1], [3.03, y0, z1]]))
            faces.append(np.array([[0, 1, 2], [0, 2, 3]]) + count)
        count += len(vertices[-1])
    return ss.Scene(
        np.concatenate(vertices),
        np.concatenate(faces),
        np.zeros(sum(map(len, faces)), int),
        room.materials,
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sheet", "below the ceiling", "thick"])
def test_an_opening_lets_pass_what_a_forward_tracer_says(kind: str) -> None:
    """Energy beyond from 50 to 150 ms, where radiance transfer makes it: within 4.0 standard errors of 3 %."""
    scene, p, q = _with_opening(kind), [0.8, 1.0, 1.2], [4.9, 1.9, 1.3]
    edges = np.array([0.05, 0.15])

    def ours(seed: int) -> np.ndarray:
        e = ss.simulate(scene, [p], [q], plain(walks=1000, duration=0.16), seed)[0, 0].histogram(0.01)
        return np.array([e[0, 5:15].sum()])

    def theirs(seed: int) -> np.ndarray:
        rows = np.ones(len(scene.faces))
        return forward_echogram(
            scene.corners, 0.2 * rows, 0.5 * rows, 0.0 * rows, np.array(p), np.array(q), edges * 343.0,
            40000, np.random.default_rng(seed), radius=0.35,
        )  # fmt: skip

    x, y = repeat(ours, 12)[:, 0], repeat(theirs, 24)[:, 0]
    error = np.sqrt(x.var(ddof=1) / len(x) + y.var(ddof=1) / len(y))
    assert error < 0.03 * y.mean()
    assert abs(x.mean() - y.mean()) < limit(1) * error, (x.mean() / y.mean(), error / y.mean())
