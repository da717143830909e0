"""Levels along random walks in three dimensions, in a room beside a body of finite size: how far they step."""

import numpy as np
import pytest
import trimesh

import soundspaces_sim as ss
from tests.marks import ci_slow
from tests.rooms import plain
from tests.transport.edge_walks import SPEED

_ROOM = np.array([6.0, 5.0, 3.0])  # m
_BODIES = {
    "pillar": ([3.0, 2.0, 0.0], [3.5, 2.5, 3.0]),
    "cupboard": ([3.0, 2.0, 0.0], [4.0, 2.5, 1.5]),
    "half wall": ([3.0, 0.0, 0.0], [3.1, 3.0, 3.0]),
    "table": ([2.5, 2.0, 0.7], [4.0, 3.0, 0.75]),
    "screen": ([3.0, 1.0, 0.0], [3.0, 3.0, 1.5]),
}
_CONFIG = plain(walks=8, duration=0.05, diffraction=True, bands=(0, 176, 775, 3409, 8000))
_STEP = 0.01  # m
_MARGIN = 0.03  # m, from the body's bounds


def _scene(kind: str) -> ss.Scene:
    """The body in a room whose walls take nearly everything."""
    room = trimesh.creation.box(bounds=np.array([np.zeros(3), _ROOM]))
    room.invert()
    low, high = _BODIES[kind]
    if low[0] < high[0]:
        body = trimesh.creation.box(bounds=np.array([low, high]))
    else:
        corners = [[low[0], y, z] for y, z in ((1.0, 0.0), (3.0, 0.0), (3.0, 1.5), (1.0, 1.5))]
        body = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    vertices = np.concatenate([room.vertices, body.vertices])
    faces = np.concatenate([room.faces, body.faces + len(room.vertices)])
    material = (np.arange(len(faces)) >= len(room.faces)).astype(int)
    absorption = np.array([[0.999] * 2, [0.1] * 2])
    materials = ss.MaterialTable(
        ("room", "body"), np.array([125.0, 8000.0]), absorption, np.zeros((2, 2)), np.zeros((2, 2))
    )
    return ss.Scene(vertices, faces, material, materials, name=kind)


def _walk(kind: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(Source, places (n, 3)) that keep off the body's bounds."""
    low, high = np.array(_BODIES[kind][0]) - _MARGIN, np.array(_BODIES[kind][1]) + _MARGIN
    while True:
        source = rng.uniform([0.5, 0.5, 0.3], _ROOM - [0.5, 0.5, 0.3])
        a, b = rng.uniform([0.3, 0.3, 0.2], _ROOM - [0.3, 0.3, 0.2], (2, 3))
        count = int(np.linalg.norm(b - a) / _STEP)
        places = a + (b - a) * np.linspace(0.0, 1.0, max(count, 2))[:, None]
        every = np.vstack([places, source])
        if count >= 60 and not ((every > low) & (every < high)).all(axis=1).any():
            return source, places


def _steps(kind: str, seed: int, walks: int) -> np.ndarray:
    """(n, 2) dB in the lowest two bands by which a step of 1 cm is larger than both of its neighbours."""
    scene, rng, found = _scene(kind), np.random.default_rng(seed), []
    edges = [(88.0, 176.0), (176.0, 775.0)]
    k = 2.0 * np.pi / SPEED * np.array([np.geomspace(a, b, 41)[1::2] for a, b in edges])
    for _ in range(walks):
        source, places = _walk(kind, rng)
        echoes, level = ss.simulate(scene, [source], places, _CONFIG), np.empty((len(places), 2))
        for i in range(len(places)):
            pressure = np.zeros(k.shape, complex)
            for a in echoes[0, i].arrivals:
                # a wall doubles a pressure, a corner of two walls doubles it twice
                assert (a.energy * 4.0 * np.pi * (a.delay * SPEED) ** 2 < 16.0).all(), a
                pressure += np.sqrt(a.energy[:2])[:, None] * np.exp(-1j * k * a.delay * SPEED)
            level[i] = 10.0 * np.log10((np.abs(pressure) ** 2).mean(axis=1))
        step = np.abs(np.diff(level, axis=0))
        found.append(step[1:-1] - np.maximum(step[:-2], step[2:]))
    return np.concatenate(found)


#: dB: most that a step may be beyond its neighbours in the two bands
_WANTED = {
    "pillar": (1.5, 0.7),
    "half wall": (0.5, 0.3),
    "screen": (1.1, 0.5),
    "cupboard": (1.3, 1.5),
    "table": (1.1, 0.6),
}
#: The same, as reached: docs/validation.md, Known issues
_REACHED = {
    "pillar": (1.5, 0.8),
    "half wall": (0.7, 0.4),
    "screen": (1.1, 0.5),
    "cupboard": (1.3, 2.0),
    "table": (1.1, 0.6),
}


@pytest.mark.parametrize("kind", ["screen", "half wall"])
@ci_slow  # steps along walks in a plane: tests/transport/test_edge_walks.py
def test_steps_of_a_few_walks(kind: str) -> None:
    """Two walks beside what the bounds are narrow for."""
    steps = _steps(kind, 3, 2)
    assert (steps.max(axis=0) < _WANTED[kind]).all(), steps.max(axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", _BODIES)
@pytest.mark.parametrize("seed", [1, 2])
def test_steps_of_many_walks(kind: str, seed: int) -> None:
    """Eight walks beside each body: of 1,000 steps fewer than two are more than 1 dB beyond their neighbours."""
    steps = _steps(kind, seed, 8)
    most = steps.max(axis=0)
    assert (most < _REACHED[kind]).all(), most
    assert (np.mean(steps > 1.0, axis=0) < 2e-3).all()
    if not (most < _WANTED[kind]).all():
        pytest.xfail(f"known issue, edges that are not parallel: {most} dB, {_WANTED[kind]} wanted")
