"""Waves at a half-plane and a wedge against exact diffraction; a twin of the time loop; what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
import soundspaces_waves as sw
from soundspaces_waves.placing import place_points
from soundspaces_waves.row_algebra import LANES
from soundspaces_waves.scheme import make_wave_scene
from soundspaces_waves.solve import _source_taps, listener_taps
from soundspaces_waves.stepping import advance, still

import soundspaces_sim as ss
from tests.marks import ci_slow
from tests.rooms import box, table
from tests.transport.exact_wedge import diffracted

HALF = 4.5  # m, of the cube of air
DRY = ss.SimulationConfig(air_absorption=False)


def _edge_scene(wedge: bool) -> ss.Scene:
    """The half-plane z = 0, x > 0, or the rigid quadrant x > 0, z < 0, in a cube of air whose corners two small
    triangles hold."""
    corner = np.array([[0, 0, 0], [0.05, 0, 0], [0, 0.05, 0.0]])
    vertices = [corner - HALF, HALF - corner]
    faces = [[0, 1, 2], [3, 4, 5]]
    quads = [[[0, -HALF, 0], [HALF, -HALF, 0], [HALF, HALF, 0], [0, HALF, 0]]]
    if wedge:
        quads.append([[0, -HALF, 0], [0, HALF, 0], [0, HALF, -HALF], [0, -HALF, -HALF]])
    for n, quad in enumerate(quads):
        vertices.append(np.array(quad, float))
        faces += [[6 + 4 * n, 7 + 4 * n, 8 + 4 * n], [6 + 4 * n, 8 + 4 * n, 9 + 4 * n]]
    return ss.Scene(
        np.concatenate(vertices), np.array(faces), np.zeros(len(faces), int), table(0.0, 0.0)
    )


def _exact(
    n: float, source: tuple[float, float], listener: tuple[float, float], k: np.ndarray
) -> np.ndarray:
    """Pressure at (r, angle) of a source at (r, angle), in the plane across the edge; free field 1 / (sqrt(4 pi) r)."""
    (rs, ts), (rr, tr) = source, listener
    total = diffracted(n, rs, ts, rr, tr, 1e-6, k)
    for angle in (tr - ts, tr + ts, 2.0 * n * np.pi - tr - ts):  # direct, and mirrored by either face
        if abs(angle) < np.pi:
            d = np.sqrt(rs**2 + rr**2 - 2.0 * rs * rr * np.cos(angle))
            total = total + np.exp(-1j * k * d) / d
    return np.asarray(total / np.sqrt(4.0 * np.pi))


def _about(place: np.ndarray, edge: float) -> tuple[float, float]:
    """(r, angle) about an edge along y at x = `edge`."""
    return float(np.hypot(place[0] - edge, place[2])), float(
        np.arctan2(place[2], place[0] - edge) % (2 * np.pi)
    )


@ci_slow
@pytest.mark.parametrize(
    ("n", "cells", "limit"), [(2.0, 12.13, 0.7), (1.5, 12.13, 0.3), (2.0, 12.0, 0.7)]
)
def test_half_plane_and_wedge(n: float, cells: float, limit: float) -> None:
    """Bands of half an octave, lit, beside the boundary of the shadow and deep in it, 320 degrees from the face.

    A plate ends where its links do, half-way between cells: with 12.13 cells per wavelength 56 cells fill the cube, and
    its edge is where it should be. With 12 there are 55, and it is half a cell too long: what is heard is the exact
    field of such a plate, 1.3 dB less in the shadow."""
    angles = np.radians([20.0, 110.0, 170.0, 215.0, 240.0, 262.0] + [320.0] * (n == 2.0))
    places = 1.2 * np.stack([np.cos(angles), np.zeros_like(angles), np.sin(angles)], axis=1)
    at = 1.4 * np.array([np.cos(np.radians(50.0)), 0.0, np.sin(np.radians(50.0))])
    low = sw.simulate_low(_edge_scene(n == 1.5), at, places, 0.1, DRY, cells_per_wavelength=cells)
    spacing = low.discretisation.spacing
    edge = 0.0 if round(2.0 * HALF / spacing) % 2 == 0 else -0.5 * spacing
    for l, place in enumerate(places):
        frequency, found = low.transfer(0, l)
        exact = _exact(n, _about(at, edge), _about(place, edge), 2.0 * np.pi * frequency / 343.0)
        for first in (60.0, 85.0, 120.0):
            band = (frequency >= first) & (frequency < first * np.sqrt(2.0))
            energy = [(np.abs(h[band]) ** 2).sum() for h in (found[0], exact)]
            assert abs(10.0 * np.log10(energy[0] / energy[1])) < limit, (l, first)


def test_the_time_loop_is_that_of_a_slow_twin() -> None:
    """First-order form in double precision: pressures, velocities on links and in branches, one cell after the other."""
    values = np.array([[0.1, 0.5], [0.6, 0.2], [0.2, 0.2]])
    materials = ss.MaterialTable(
        ("a", "b", "cloth (free-hanging)"), np.array([63.0, 125.0]), values, 0 * values,
        np.array([[0.0, 0.0], [0.1, 0.1], [0.5, 0.5]]),
    )  # fmt: skip
    room = box((2.1, 1.7, 1.9), materials, [0, 1, 0, 1, 0, 0])
    sheet = np.array([[1.0, 0.3, 0.2], [1.1, 1.4, 0.2], [1.0, 0.9, 1.6]])
    scene = ss.Scene(
        np.concatenate([room.vertices, sheet, sheet + [0.5, 0.1, 0.0]]),
        np.concatenate([room.faces, [[8, 9, 10], [11, 12, 13]]]),
        np.append(room.face_material, [2, 1]),
        materials,
    )
    waves = make_wave_scene(scene, 176.0, 8.0, 343.0)
    place = place_points(scene, waves.lattice, waves.component, np.array([[0.4, 0.5, 0.6]]), "source")
    scheme = waves.scheme(np.unique(waves.component[place[0][0]]))
    steps, rng = 120, np.random.default_rng(0)
    signal = rng.standard_normal(steps)
    record = np.zeros((steps, 4, LANES), np.float32)
    field = still(waves.lattice.cells, scheme)
    advance(0, steps, scheme, field, _source_taps(waves, place), signal, listener_taps(place), record)

    step, matrix, volume, lam = waves.step, waves.matrix, waves.volume, waves.courant
    walls, layers = waves.walls, waves.layers
    p, total, feed_total = np.zeros(len(volume)), np.zeros(len(volume)), 0.0
    velocity, displacement = np.zeros((2, len(walls.cell)))
    through = np.zeros(len(layers.near))
    resist = walls.resistance + 2 * walls.mass / step + 0.5 * walls.stiffness * step
    for t in range(steps):
        cells, weights = place[0]
        np.testing.assert_allclose(record[t, 0, 0], weights[0] @ p[cells], atol=2e-5 * 30)
        total += p  # links: the sum of what drives them
        feed_total += signal[t]
        drop = p[layers.near] - p[layers.far]
        through += (drop - layers.resistance * through) / (layers.mass / step + 0.5 * layers.resistance)
        inflow = -(lam**2) * (matrix @ total)
        np.subtract.at(inflow, layers.near, lam * layers.area * through)
        np.add.at(inflow, layers.far, lam * layers.area * through)
        inflow[cells] += lam**2 / waves.lattice.spacing * weights[0] * feed_total
        pull, push = np.zeros(len(volume)), np.zeros(len(volume))
        force = 2 * walls.mass / step * velocity - walls.stiffness * displacement
        np.add.at(pull, walls.cell, 0.5 * lam * walls.area / resist)
        np.add.at(push, walls.cell, lam * walls.area * force / resist)
        after = (p * (volume - pull) + inflow - push) / (volume + pull)
        u = (0.5 * (after + p)[walls.cell] + force) / resist
        velocity, displacement = 2 * u - velocity, displacement + step * u
        p = after
    assert np.abs(record[:, 0]).max() > 1e-2


@pytest.mark.parametrize(
    ("what", "error"),
    [
        ({"duration": math.nan}, ss.ConfigError), ({"duration": 0.0}, ss.ConfigError),
        ({"edge": math.nan}, ss.ConfigError), ({"edge": 5.0}, ss.ConfigError),
        ({"cells_per_wavelength": math.nan}, ss.ConfigError), ({"cells_per_wavelength": 3.0}, ss.ConfigError),
        ({"reactance": math.inf}, ss.ConfigError), ({"listeners": [[1.0, math.nan, 1.0]]}, ss.PointError),
        ({"sources": [[9.0, 1.0, 1.0]]}, ss.PointError), ({"scene": 3}, ss.SceneError),
    ],
)  # fmt: skip
def test_what_is_refused(what: dict[str, object], error: type[Exception]) -> None:
    given: dict[str, object] = {
        "scene": ss.shoebox((3.0, 2.5, 2.4)), "sources": [[1.0, 1.0, 1.0]], "listeners": [[2.0, 1.5, 1.2]], "duration": 0.1,
    }  # fmt: skip
    with pytest.raises(error):
        sw.simulate_low(**{**given, **what})  # type: ignore[arg-type]


def test_a_lattice_that_is_too_large_is_refused_before_memory_is_taken() -> None:
    with pytest.raises((ss.SimulationError, ss.ConfigError), match="cells"):
        sw.simulate_low(
            ss.shoebox((300.0, 300.0, 50.0)), [1.0, 1.0, 1.0], [2.0, 1.0, 1.0], 0.1, edge=400.0
        )
