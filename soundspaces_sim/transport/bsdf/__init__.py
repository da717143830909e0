"""Lobes: the ways in which a wall sends sound on, one file each.

A lobe has a number and up to three functions of directions. Directions are (x, y, z) unit vectors along
which sound travels: `d_in` to the wall, `d_out` away from it; `normal` is on the side from which it came.

    sample(d_in, normal, u, v) -> d_out    from two uniform numbers
    pdf(d_in, normal, d_out)               density of `sample`, per steradian
    value(d_in, normal, d_out)             energy scattered into d_out, 1/sr, of 1 that the lobe reflects

`value` integrates to one over the hemisphere with the cosine of d_out, and is the same with both directions
reversed and swapped (reciprocity). Delta lobes have `sample` alone: no join can hit their direction.

`scatters[lobe]`: not a delta lobe. `passes[lobe]`: sound goes on behind the wall. `even[lobe]`: `value` is
constant, so that patches carry it in late sound (`radiance_transfer`). Where a scene has a lobe that scatters,
but not evenly, receiver volumes make late sound (`model.late_technique`).

A new lobe is a file, its number and row here, and its line in the three functions below.
"""

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.transport.bsdf import diffuse
from soundspaces_sim.transport.bsdf import specular as mirror
from soundspaces_sim.transport.bsdf import transmission as through

DIFFUSE, MIRROR, THROUGH = range(3)
NAMES = ("diffuse", "mirror", "through")
LOBES = len(NAMES)

SCATTERS = np.array([True, False, False])
PASSES = np.array([False, False, True])
EVEN = np.array([True, False, False])


@part(forceinline=True)
def scatters(lobe):
    """Whether sound leaves in a spread of directions, not in one."""
    return SCATTERS[lobe]


@part(forceinline=True)
def passes(lobe):
    """Whether sound goes on behind the wall."""
    return PASSES[lobe]


@part(forceinline=True)
def even(lobe):
    """Whether sound is scattered alike into all directions, from wherever it came."""
    return EVEN[lobe]


@part
def sample(lobe, d_in, normal, u, v):
    """Direction in which sound leaves, from two uniform numbers."""
    if lobe == DIFFUSE:
        return diffuse.sample(d_in, normal, u, v)
    if lobe == MIRROR:
        return mirror.sample(d_in, normal, u, v)
    return through.sample(d_in, normal, u, v)


@part
def pdf(lobe, d_in, normal, d_out):
    """Density of `sample`, per steradian; 0 for a delta lobe."""
    if lobe == DIFFUSE:
        return diffuse.pdf(d_in, normal, d_out)
    return 0.0


@part
def value(lobe, d_in, normal, d_out):
    """Energy scattered into `d_out`, 1/sr, of 1 that the lobe reflects; 0 for a delta lobe."""
    if lobe == DIFFUSE:
        return diffuse.value(d_in, normal, d_out)
    return 0.0
