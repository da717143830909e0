"""A slow, obvious twin of the engine: forward energy tracing, one band at a time, in numpy.

No connections, no MIS, no Embree, no shared code: rays leave the source uniformly, lobes are drawn with the
band's own probabilities, absorption weights them, and whatever crosses a small sphere about the listener
after at least one reflection is recorded as (length inside) / (volume).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Pattern = Callable[[np.ndarray], np.ndarray]  # (n, 3) directions away from an end to (n,) energy gains


def _intersect(
    corners: np.ndarray, origin: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Nearest triangle of each ray (Moeller & Trumbore 1997): (distance, index)."""
    best = np.full(len(origin), np.inf)
    which = np.full(len(origin), -1)
    for i, (a, b, c) in enumerate(corners):
        e1, e2 = b - a, c - a
        p = np.cross(direction, e2)
        det = p @ e1
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / det
            s = origin - a
            u = (s * p).sum(axis=1) * inverse
            q = np.cross(s, e1)
            v = (direction * q).sum(axis=1) * inverse
            t = q @ e2 * inverse
        hit = (u >= -1e-12) & (v >= -1e-12) & (u + v <= 1.0 + 1e-12) & (t > 1e-9) & (t < best)
        best[hit], which[hit] = t[hit], i
    return best, which


def forward_echogram(
    corners: np.ndarray,
    absorption: np.ndarray,
    scattering: np.ndarray,
    transmission: np.ndarray,
    source: np.ndarray,
    listener: np.ndarray,
    edges: np.ndarray,
    rays: int,
    rng: np.random.Generator,
    radius: float,
    emit: Pattern | None = None,
    receive: Pattern | None = None,
) -> np.ndarray:
    """(bins,) reverberant fluence between path lengths `edges` (m). Coefficients are per triangle.

    `emit`, `receive`: patterns of the source and of the listener, which weight rays.
    """
    z = rng.uniform(-1.0, 1.0, rays)
    phi = rng.uniform(0.0, 2.0 * np.pi, rays)
    d = np.stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z], axis=1)
    o = np.broadcast_to(source, (rays, 3)).copy()
    weight, length, reflected = np.full(rays, 1.0 / rays), np.zeros(rays), np.zeros(rays, bool)
    if emit is not None:
        weight = weight * emit(d)
    volume = 4.0 / 3.0 * np.pi * radius**3
    out = np.zeros(len(edges) - 1)
    e12 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normals = np.cross(*e12)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    while len(o):
        t, face = _intersect(corners, o, d)
        to = listener - o
        closest = (to * d).sum(axis=1)
        miss2 = (to**2).sum(axis=1) - closest**2
        half = np.sqrt(np.maximum(radius**2 - miss2, 0.0))
        inside = np.maximum(np.minimum(closest + half, t) - np.maximum(closest - half, 0.0), 0.0)
        use = reflected & (miss2 < radius**2) & (inside > 0.0)
        heard = weight * inside / volume
        if receive is not None:
            heard = heard * receive(-d)
        out += np.histogram((length + np.maximum(closest, 0.0))[use], edges, weights=heard[use])[0]
        alive = (face >= 0) & (length + t < edges[-1] + 1.0)
        o, d, weight, length, reflected, t, face = (
            x[alive] for x in (o, d, weight, length, reflected, t, face)
        )
        o, length = o + t[:, None] * d, length + t
        n = normals[face] * -np.sign((normals[face] * d).sum(axis=1))[:, None]
        tau, rho = transmission[face], 1.0 - absorption[face] - transmission[face]
        weight = weight * (tau + rho)
        through = rng.uniform(size=len(o)) * (tau + rho) < tau
        diffuse = ~through & (rng.uniform(size=len(o)) < scattering[face])
        mirror = ~through & ~diffuse
        d[mirror] -= 2.0 * (d * n).sum(axis=1)[mirror, None] * n[mirror]
        random = rng.normal(size=(len(o), 3))
        random /= np.linalg.norm(random, axis=1, keepdims=True)
        lambert = n + random  # a unit normal plus a uniform unit vector is cosine-distributed
        lambert /= np.linalg.norm(lambert, axis=1, keepdims=True)
        d[diffuse] = lambert[diffuse]
        reflected = reflected | ~through
        o = o + np.where(through, -1e-6, 1e-6)[:, None] * n
        keep = weight > 1e-9 / rays
        o, d, weight, length, reflected = (x[keep] for x in (o, d, weight, length, reflected))
    return out
