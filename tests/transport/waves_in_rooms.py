"""Finite differences in time for any mesh: a cubic grid whose links are cut where a triangle crosses them.

The standard leapfrog scheme at its Courant limit (Botteldooren 1995); a cut link is a locally reacting wall of specific
admittance `ADMITTANCE`. A pulse of one cell has (3 h / 4 pi) / r in a free field at low frequencies, h the side of a
cell, as p_tt - c² lap p = delta(t) h³ / dt² has, with c dt = h / sqrt 3.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import trimesh
from scipy.signal import butter, sosfreqz
from trimesh.ray.ray_pyembree import RayMeshIntersector

import soundspaces_sim as ss
from tests.transport.wave_twin import OPEN, SPEED, advance, walls_of

STEP = 0.045  # m: ten points per wave at 760 Hz
ADMITTANCE = 0.05
#: absorption at random incidence of that (Kuttruff, Room Acoustics, the integral over angles)
ABSORPTION = 0.29
_AWAY = (0.37, 0.26, 0.15)  # of a cell: no wall of a scene lies on cells' centres
_AROUND = 3  # cells
_AGAIN = 1e-4  # m, past a triangle, from where the next one is looked for
_LONGEST = 4096  # steps of a response
_SOFT = 0.005  # s, over which a response ends
_TIME_STEP = STEP / SPEED / np.sqrt(3.0)
_FREE = 3.0 * STEP / (4.0 * np.pi)  # m, |P| r of a pulse


def _cut_links(scene: ss.Scene, low: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Of each cell, as `advance` has them."""
    rays = RayMeshIntersector(trimesh.Trimesh(scene.vertices, scene.faces, process=False))
    links = np.full(shape, OPEN, np.uint8)
    for axis in range(3):
        ends = [1 if a == axis else int(shape[a]) for a in range(3)]
        lines = np.indices(ends).reshape(3, -1).T
        from_, way = low + (lines + 0.5) * STEP, np.zeros(lines.shape)
        from_[:, axis], way[:, axis] = low[axis] - STEP, 1.0
        alive = np.arange(len(lines))
        while len(alive):
            at, ray, _ = rays.intersects_location(from_[alive], way[alive], multiple_hits=False)
            alive = alive[ray]
            cell = lines[alive].copy()
            cell[:, axis] = np.floor((at[:, axis] - low[axis]) / STEP - 0.5).astype(int)
            cell = cell[(cell[:, axis] >= 0) & (cell[:, axis] < shape[axis] - 1)]
            links[tuple(cell.T)] &= np.uint8(255 - (2 << 2 * axis))
            cell[:, axis] += 1
            links[tuple(cell.T)] &= np.uint8(255 - (1 << 2 * axis))
            from_[alive] = at + _AGAIN * way[alive]
    return links


class Room:
    """A scene as a grid."""

    def __init__(self, scene: ss.Scene) -> None:
        low, high = scene.bounds
        self._low = low - (_AROUND - np.array(_AWAY)) * STEP
        shape = np.ceil((high - low) / STEP).astype(int) + 2 * _AROUND
        self._links = _cut_links(scene, self._low, shape)

    def centres(self, points: np.ndarray) -> np.ndarray:
        """(n, 3) m, of the cells that points are in."""
        return np.asarray(self._low + (self._cells(points) + 0.5) * STEP)

    def _cells(self, points: np.ndarray) -> np.ndarray:
        return np.asarray(np.floor((points - self._low) / STEP).astype(int))

    def responses(self, source: np.ndarray, points: np.ndarray, until: float) -> np.ndarray:
        """(n, steps) pressure times distance after a pulse of a free field's 1 / r, up to `until` s."""
        p = np.zeros(self._links.shape, np.float32)
        before, cells = p.copy(), self._cells(points)
        p[tuple(self._cells(source))] = 1.0
        keep, over = walls_of(ADMITTANCE)
        out = np.empty((len(points), round(until / _TIME_STEP)))
        for n in range(out.shape[1]):
            out[:, n] = p[tuple(cells.T)]
            advance(p, before, self._links, keep, over)
            p, before = before, p
        return np.asarray(out * (np.linalg.norm(points - source, axis=1)[:, None] / _FREE))


def _filtered(pulses: np.ndarray, band: tuple[float, float]) -> np.ndarray:
    """(n, 2 `_LONGEST`) what a band-pass without phase leaves of responses (n, steps); what it puts before the first
    step is at the end. A band must be cut out before an instant is: within 10 ms a tone of 40 Hz has any frequency."""
    sos = butter(4, band, "bandpass", fs=1.0 / _TIME_STEP, output="sos")
    gain = np.abs(sosfreqz(sos, 2.0 * np.pi * np.fft.rfftfreq(2 * _LONGEST))[1]) ** 2
    return np.asarray(
        np.fft.irfft(np.fft.rfft(pulses, 2 * _LONGEST, axis=1) * gain, 2 * _LONGEST, axis=1)
    )


def energy_until(responses: np.ndarray, band: tuple[float, float]) -> np.ndarray:
    """(n, steps) energy that responses (n, steps) have in a band up to each step, over that of a pulse of 1 in all."""
    steps = responses.shape[1]
    soft = np.clip((steps - np.arange(steps)) * _TIME_STEP / _SOFT, 0.0, 1.0)
    energy = _filtered(responses * np.sin(0.5 * np.pi * soft) ** 2, band) ** 2
    before = energy[:, _LONGEST:].sum(axis=1)
    return np.asarray(before[:, None] + np.cumsum(energy[:, :steps], axis=1)) / _of_pulse(band)[1]


@cache
def _of_pulse(band: tuple[float, float]) -> tuple[np.ndarray, float]:
    """(Share of the energy of a filtered pulse that comes up to each step, from `_LONGEST` before it; its energy)."""
    pulse = np.zeros((1, _LONGEST))
    pulse[0, 0] = 1.0
    energy = np.roll(_filtered(pulse, band)[0] ** 2, _LONGEST)
    return np.cumsum(energy) / energy.sum(), float(energy.sum())


def share_until(t: np.ndarray, band: tuple[float, float]) -> np.ndarray:
    """Share of the energy of a pulse, in a band as `energy_until` has it, that comes up to t s after the pulse."""
    return np.asarray(np.interp(t / _TIME_STEP, np.arange(-_LONGEST, _LONGEST), _of_pulse(band)[0]))


def step_of(t: float) -> int:
    """The step at t s."""
    return int(t / _TIME_STEP)
