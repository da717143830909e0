"""Energies of diffracted paths in the shadow, and the interference of diffracted with geometrical sound in the
light.

In the shadow a path brings the mean of |p_d|² over its band. In the light the direct sound (or a reflection) takes
the mean of |1 + p_d / p_g|², p_g its own pressure, so that energies are continuous through a shadow boundary. The
reflected wave's terms belong to the reflection, and are tapered with the distance from the shadow boundary.

Of several edges the mean of p_d / p_g counts, weighted by the fourth power of its size: the strongest decides, and
the two edges of a slab count as the one that they are to sound.
"""

import math
from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.scene.rays.directions import INV_4PI
from soundspaces_sim.transport.diffraction.paths import MAX_DETOUR, DiffractedPath, cosine_taper
from soundspaces_sim.transport.diffraction.spectrum import Quadrature
from soundspaces_sim.transport.path_table import WAVE_POINTS

#: times the amplitude of what goes straight: a disc on its axis reflects so much, a strip one with the direct sound
#: adds no more; sums and products over many edges, each of which acts as if it was alone, could
_MOST = 2.0
_MAX_PHASE = 2.0 * math.pi  # `MAX_DETOUR`, times k


class Interference(NamedTuple):
    """Sums over the edges that a geometrical path passes: its ratio r = p_d / p_g, weighted by |r|⁴, and |r|⁴."""

    ratio: np.ndarray  # (b, h) complex
    weight: np.ndarray  # (b, h)


class Wave(NamedTuple):
    """What a path brings per band: its energy, J/m² for 1 J, and its wave (`PathTable.wave`)."""

    energy: np.ndarray  # (b,)
    field: np.ndarray  # (b, n) complex


def make_wave(bands: int) -> Wave:
    """Empty."""
    return Wave(np.empty(bands), np.empty((bands, WAVE_POINTS), np.complex128))


@part(forceinline=True)
def mean_square(field: np.ndarray, b: int, quadrature: Quadrature) -> float:
    """Of a field (b, g) in a band."""
    square = 0.0
    for g in range(len(quadrature.weight)):
        p = field[b, g]
        square += quadrature.weight[g] * (p.real * p.real + p.imag * p.imag)
    return square


@part
def write_wave(field: np.ndarray, quadrature: Quadrature, wave: Wave) -> None:
    """The mean square of a field (b, g) over each band, and its wave."""
    for b in range(len(wave.energy)):
        square = mean_square(field, b, quadrature)
        wave.energy[b] = square
        scale = 1.0 / math.sqrt(square) if square > 0.0 else 0.0
        for n in range(wave.field.shape[1]):
            total = 0j
            for g in range(len(quadrature.weight)):
                total += quadrature.project[n, g] * field[b, g]
            wave.field[b, n] = scale * total


@part
def turn(field: np.ndarray, quadrature: Quadrature, later: float) -> None:
    """Let a field (b, g) be that of a path which is longer by `later` m: the sound is the same."""
    for b in range(field.shape[0]):
        for g in range(field.shape[1]):
            phase = quadrature.k[b, g] * later
            field[b, g] *= complex(math.cos(phase), math.sin(phase))


@part
def mean_energy(field: np.ndarray, quadrature: Quadrature, wave: Wave) -> float:
    """What a field (b, g), 1/m, brings, without air; the largest of its energies."""
    write_wave(field, quadrature, wave)
    most = 0.0
    for b in range(len(wave.energy)):
        wave.energy[b] *= INV_4PI
        most = max(most, wave.energy[b])
    return most


@part(forceinline=True)
def detour_taper(detour: float, k: float) -> float:
    """1 where a geometrical path passes an edge closely, down to 0 at a detour of a wavelength or `MAX_DETOUR`."""
    return cosine_taper(2.0 * max(detour / min(MAX_DETOUR, _MAX_PHASE / k) - 0.5, 0.0))


@part(forceinline=True)
def merged_share(k: float, later: float, detour: float) -> float:
    """Part of a strip's reflection that is one with the direct sound, over which it comes `later`, m: all up to
    half a wavelength, nothing from a whole one on; `detour` of the direct sound by the strip's edges, m."""
    return detour_taper(max(later, 0.0), k) * detour_taper(detour, k)


@part(forceinline=True)
def reflected_share(path: DiffractedPath) -> float:
    """Part of the reflected wave's terms that interferes with the incident wave: 1 at the shadow boundary, 0 at
    the reflection boundary and beyond; the rest interferes with the reflection."""
    to_shadow = math.pi - (path.phi_r - path.phi_s)
    between = 2.0 * min(path.phi_s, math.pi * path.n - path.phi_r)
    return cosine_taper(max(to_shadow, 0.0) / between) if to_shadow < between else 0.0


@part
def clear(sums: Interference) -> None:
    """No edges yet."""
    sums.ratio[:, :], sums.weight[:, :] = 0.0, 0.0


@part(forceinline=True)
def weigh(r: complex, b: int, g: int, sums: Interference) -> None:
    """Add a ratio to the sums at a wave number."""
    weight = (r.real * r.real + r.imag * r.imag) ** 2
    sums.ratio[b, g] += weight * r
    sums.weight[b, g] += weight


@part
def add_field(field: np.ndarray, weight: float, total: np.ndarray) -> None:
    """total += weight * field, (b, h) both."""
    for b in range(total.shape[0]):
        for h in range(total.shape[1]):
            total[b, h] += weight * field[b, h]


@part
def scale_field(field: np.ndarray, weight: float) -> None:
    """field *= weight; without a weight 0, whatever it was."""
    for b in range(field.shape[0]):
        for h in range(field.shape[1]):
            field[b, h] = weight * field[b, h] if weight > 0.0 else 0j


@part
def copy_field(field: np.ndarray, to: np.ndarray) -> None:
    """to = field, (b, h) both."""
    for b in range(to.shape[0]):
        for h in range(to.shape[1]):
            to[b, h] = field[b, h]


@part(forceinline=True)
def mean_ratio(sums: Interference, b: int, g: int) -> complex:
    """r at a wave number, 0 of no edges."""
    return sums.ratio[b, g] / sums.weight[b, g] if sums.weight[b, g] > 0.0 else 0j


@part(forceinline=True)
def bounded(factor: complex) -> complex:
    """A factor of what goes straight, of at most `_MOST`."""
    return factor * (_MOST / max(abs(factor), _MOST))


@part(forceinline=True)
def both_sides(before: complex, after: complex) -> complex:
    """1 + what edges before and after a path's own add to it, as parts of it.

    What both do is their product, but no more than one of them does: by more edges sound is not louder, and where
    the path itself is next to nothing, as at the end of its edge, a product of two ratios to it has no bound.
    """
    return 1.0 + before + after + before * after / max(abs(before), abs(after), 1.0)


@part
def write_factor(sums: Interference, quadrature: Quadrature, wave: Wave) -> None:
    """The mean of |1 + r|² over each band, r the weighted mean over the edges, and the wave 1 + r."""
    for b in range(len(wave.energy)):
        for g in range(len(quadrature.weight)):
            if sums.weight[b, g] > 0.0:
                sums.ratio[b, g] /= sums.weight[b, g]
            sums.ratio[b, g] = bounded(1.0 + sums.ratio[b, g])
    write_wave(sums.ratio, quadrature, wave)
