"""A forward tracer for two rooms with a thick wall between them that ends above the floor, apart from the engine.

Rays leave the source evenly, lose α at every surface, and are mirrored, or sent by Lambert's law with probability s.
A listener is a sphere: the energy density there is the mean of chord lengths over its volume.
"""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True)
def trace(
    rng: np.random.Generator, rays: int, source: np.ndarray, spheres: np.ndarray, size: np.ndarray, wall: np.ndarray,
    absorption: float, scattering: float, edges: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """(listeners, windows) energy for 1 J, without the direct sound. `spheres` (listeners, 4): centre and radius, m.
    A room [0, `size`]; `wall`: x of its faces and the height at which it ends. `edges`: lengths of windows, m."""
    out = np.zeros((len(spheres), len(edges) - 1))
    for _ in range(rays):
        at, to = source.copy(), np.empty(3)
        to[2], turn = 2.0 * rng.random() - 1.0, 2.0 * np.pi * rng.random()
        across = np.sqrt(1.0 - to[2] ** 2)
        to[0], to[1] = across * np.cos(turn), across * np.sin(turn)
        energy, length, reflected = 1.0 / rays, 0.0, False
        while length < edges[-1] and energy * rays > 1e-6:
            far, axis, normal = 1e30, 0, 0.0
            for k in range(3):
                if abs(to[k]) > 1e-12:
                    reach = ((size[k] if to[k] > 0.0 else 0.0) - at[k]) / to[k]
                    if reach < far:
                        far, axis, normal = reach, k, -np.sign(to[k])
            for face in range(2):  # of the wall, from outside
                inwards = 1.0 if face == 0 else -1.0
                if to[0] * inwards > 1e-12 and (wall[face] - at[0]) * inwards >= 0.0:
                    reach = (wall[face] - at[0]) / to[0]
                    if 1e-9 < reach < far and at[2] + reach * to[2] > wall[2]:
                        far, axis, normal = reach, 0, -inwards
            if to[2] > 1e-12 and at[2] <= wall[2]:  # its underside
                reach = (wall[2] - at[2]) / to[2]
                if 1e-9 < reach < far and wall[0] < at[0] + reach * to[0] < wall[1]:
                    far, axis, normal = reach, 2, -1.0
            for i in range(len(spheres)):
                middle = ((spheres[i, :3] - at) * to).sum()
                off = ((spheres[i, :3] - at) ** 2).sum() - middle**2
                if reflected and off < spheres[i, 3] ** 2:
                    half = np.sqrt(spheres[i, 3] ** 2 - off)
                    first, last = max(middle - half, 0.0), min(middle + half, far)
                    window = np.searchsorted(edges, length + 0.5 * (first + last)) - 1
                    if last > first and 0 <= window < out.shape[1]:
                        out[i, window] += (
                            energy * (last - first) / (4.0 / 3.0 * np.pi * spheres[i, 3] ** 3)
                        )
            at += far * to
            at[axis] += 1e-7 * normal
            length, energy, reflected = length + far, energy * (1.0 - absorption), True
            if rng.random() < scattering:
                up, turn = rng.random(), 2.0 * np.pi * rng.random()
                to[axis] = normal * np.sqrt(up)
                to[(axis + 1) % 3] = np.sqrt(1.0 - up) * np.cos(turn)
                to[(axis + 2) % 3] = np.sqrt(1.0 - up) * np.sin(turn)
            else:
                to[axis] = -to[axis]
    return out
