"""Sampling BSDFs: which lobe a path follows, and what becomes of its throughput.

Every band has its own lobe energies, but a path serves all bands at once. Choosing lobes by a band average alone
would make the weights of the other bands grow exponentially with the number of events (a factor 1.13 in variance
per event for scattering .1 under a mean of .26). Choosing by one band alone serves only that band. So each path
follows one *proposal* drawn from several: the average over bands, which stays close to all bands where they are
alike; each band's exact probabilities; and one that explores rare lobes on the first events. The weight of a path
is that of the whole mixture, f_b / sum_h c_h p_h: spectral MIS as in hero-wavelength sampling (Wilkie et al. 2014,
section 3), so a band's weight never exceeds 1 / c of its own proposal. MIS weights between path techniques use
`nominal` probabilities: any function of the path alone keeps them a partition of one.

Subpaths that are only reflected specularly and transmitted (`paths.specular`, `paths.guide`) have functions of
their own: they choose in proportion to the energies of all bands.
"""

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.transport import bsdf
from soundspaces_sim.transport.bsdf.surface import (
    Surfaces,
    apply_arrival_factor,
    attenuate,
    diffuse_albedo,
    is_delta,
    lobe_albedo,
    specular_albedo,
    transmission,
)

_EXPLORED_EVENTS = 3  # afterwards the exploring proposal is the average
#: Least chance, on these events, of passing what transmits and reflects; then it falls as 1 / event. Were it the
#: same for ever, sound that stays in a room would be in exponentially fewer subpaths.
_EXPLORING = 0.1
_NEGLIGIBLE = 1e-9  # band weight below which nothing is left of a path


@part
def choose_proposal(surfaces: Surfaces, u: float) -> int:
    """Proposal that a path follows, from a uniform number."""
    for h in range(len(surfaces.chance)):
        u -= surfaces.chance[h]
        if u < 0.0:
            return h
    return len(surfaces.chance) - 1


@part(forceinline=True)
def _proposal_row(surfaces: Surfaces, proposal: int, event: int) -> int:
    """Row of `Surfaces.proposal` that a path's proposal means at its `event`-th surface (from 1)."""
    last = len(surfaces.chance) - 1
    return last - 1 if proposal == last and event > _EXPLORED_EVENTS else proposal


@part(forceinline=True)
def choose_lobe(surfaces: Surfaces, material: int, proposal: int, event: int, u: float) -> int:
    """Lobe drawn from a proposal, or -1 if the surface absorbs everything."""
    h = _proposal_row(surfaces, proposal, event)
    reached, last = 0.0, -1
    for lobe in range(bsdf.COUNT):
        p = surfaces.proposal[material, h, lobe]
        if p > 0.0:
            reached, last = reached + p, lobe
            if u < reached:
                return lobe
    return last  # u within rounding of 1


@part(forceinline=True)
def update_throughput(
    surfaces: Surfaces,
    material: int,
    lobe: int,
    cos_in: float,
    event: int,
    throughput: np.ndarray,
    mixture: np.ndarray,
) -> bool:
    """Update a path's `throughput` beta (b,) and proposal ratios `mixture` (h,) by a lobe; False if nothing is
    left.

    With p the mixture's density of the path, mixture_h = p_h / p and beta_b = f_b / p, but for the factor of the
    angle of departure.
    """
    mean = 0.0
    for h in range(len(mixture)):
        mixture[h] *= surfaces.proposal[material, _proposal_row(surfaces, h, event), lobe]
        mean += surfaces.chance[h] * mixture[h]
    scale = 1.0 / mean
    for h in range(len(mixture)):
        mixture[h] *= scale
    alive = False
    for b in range(len(throughput)):
        throughput[b] *= surfaces.energy[material, lobe, b] * scale
    apply_arrival_factor(surfaces, material, lobe, cos_in, throughput)
    for b in range(len(throughput)):
        alive |= throughput[b] > _NEGLIGIBLE
    return alive


# Subpaths that are not scattered


@part(forceinline=True)
def _choose_scattering(surfaces: Surfaces, material: int, u: float) -> int:
    """Lobe that scatters, drawn in proportion to its energy."""
    left, last = u * diffuse_albedo(surfaces, material), -1
    for lobe in range(bsdf.COUNT):
        if not is_delta(lobe):
            last = lobe
            left -= lobe_albedo(surfaces, material, lobe)
            if left < 0.0:
                break
    return last


@part(forceinline=True)
def sample_split(
    surfaces: Surfaces, material: int, cos: float, scatter: bool, beta: np.ndarray, event: int, u: float
) -> int:
    """Reflect specularly, transmit or (with `scatter`) scatter, in proportion to what each takes of all bands, and
    multiply `beta` (b,) accordingly: the lobe, or -1 if nothing is left. `u`: a uniform number."""
    through, mirror = transmission(surfaces, material), specular_albedo(surfaces, material)
    diffuse = diffuse_albedo(surfaces, material) if scatter else 0.0
    back = mirror + diffuse
    if back + through <= 0.0:
        return -1
    p_through = through / (back + through)
    if through > 0.0 and back > 0.0:
        p_through = max(p_through, _EXPLORING * _EXPLORED_EVENTS / max(event, _EXPLORED_EVENTS))
    if u < p_through:
        lobe, chance = bsdf.TRANSMISSION, p_through
    elif u < p_through + (1.0 - p_through) * diffuse / back:
        chance = (1.0 - p_through) * diffuse / back
        lobe = _choose_scattering(surfaces, material, (u - p_through) / chance)
        chance *= lobe_albedo(surfaces, material, lobe) / diffuse
    else:
        lobe, chance = bsdf.SPECULAR, (1.0 - p_through) * mirror / back
    left = attenuate(surfaces, material, lobe, cos, beta, chance)
    return lobe if left > _NEGLIGIBLE else -1


@part(forceinline=True)
def sample_specular(surfaces: Surfaces, material: int, cos: float, energy: np.ndarray, u: float) -> int:
    """Reflect specularly or transmit, in proportion to what either takes of all bands, and multiply `energy` (b,)
    accordingly: the lobe, or -1 if the surface does neither."""
    through, mirror = transmission(surfaces, material), specular_albedo(surfaces, material)
    if mirror + through <= 0.0:
        return -1
    p_through = through / (mirror + through)
    if u < p_through:
        attenuate(surfaces, material, bsdf.TRANSMISSION, cos, energy, p_through)
        return bsdf.TRANSMISSION
    attenuate(surfaces, material, bsdf.SPECULAR, cos, energy, 1.0 - p_through)
    return bsdf.SPECULAR
