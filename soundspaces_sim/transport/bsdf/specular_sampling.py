"""Sampling of paths that are mirrored and transmitted, but not scattered (`paths.specular`, `paths.guide`)."""

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.transport import bsdf
from soundspaces_sim.transport.bsdf.surface import (
    NEGLIGIBLE,
    Surfaces,
    attenuate,
    diffuse_albedo,
    is_delta,
    lobe_albedo,
    specular_albedo,
    transmission,
)

_LEAST_TRANSMISSION = 0.1  # probability of passing a surface that transmits and reflects


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
    surfaces: Surfaces, material: int, cos: float, scatter: bool, energy: np.ndarray, u: float
) -> int:
    """Reflect specularly, transmit or (with `scatter`) scatter, in proportion to what each takes of all bands, and
    multiply `energy` (b,) accordingly: the lobe, or -1 if nothing is left. `u`: a uniform number."""
    through, mirror = transmission(surfaces, material), specular_albedo(surfaces, material)
    diffuse = diffuse_albedo(surfaces, material) if scatter else 0.0
    back = mirror + diffuse
    if back + through <= 0.0:
        return -1
    p_through = through / (back + through)
    if through > 0.0 and back > 0.0:
        p_through = max(p_through, _LEAST_TRANSMISSION)
    if u < p_through:
        lobe, chance = bsdf.TRANSMISSION, p_through
    elif u < p_through + (1.0 - p_through) * diffuse / back:
        chance = (1.0 - p_through) * diffuse / back
        lobe = _choose_scattering(surfaces, material, (u - p_through) / chance)
        chance *= lobe_albedo(surfaces, material, lobe) / diffuse
    else:
        lobe, chance = bsdf.SPECULAR, (1.0 - p_through) * mirror / back
    left = attenuate(surfaces, material, lobe, cos, energy, chance)
    return lobe if left > NEGLIGIBLE else -1


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
