"""What a surface does to a path of sound: its BSDF by property, evaluated and with its densities.

A surface reflects rho = 1 - absorption - transmission, of which the fraction `scattering` is diffuse (Lambert) and
the rest specular; `transmission` passes straight on. Lobes, reflection laws and conventions: `transport.bsdf`.

With g(c) the factor of a reflection law at an angle of incidence of cosine c, specular reflection and transmission
are multiplied by their g, and diffuse reflection by g of both angles, f = (rho s / pi) g(c_in) g(c_out): as the
mean of g is one, it scatters rho s g(c_in), and it is reciprocal. Lobes are drawn as if there were no angles, so
densities and MIS weights do not depend on the law; only energies do, by the angle of incidence
(`sampling.update_throughput`, `attenuate`) and that of departure (`apply_departure_factor`).
"""

from typing import NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, dot, negate
from soundspaces_sim.transport import bsdf
from soundspaces_sim.transport.bsdf import COUNT, SPECULAR, TRANSMISSION

_AVERAGE_SHARE, _EXPLORE_SHARE = 0.45, 0.15  # of paths; the bands share the rest


class Surfaces(NamedTuple):
    """BSDFs of m materials for kernels: b bands, l lobes, h = b + 2 proposals (the bands', average, exploring)."""

    energy: np.ndarray  # (m, l, b) energy fraction of each lobe at random incidence
    proposal: np.ndarray  # (m, h, l) probability of each lobe under each proposal
    chance: np.ndarray  # (h,) share of paths that follow each proposal
    nominal: np.ndarray  # (m, l) probability in MIS weights, 0 of delta lobes
    law: np.ndarray  # (m,) reflection law, row of `bsdf.LAWS`; of 0 energies do not depend on angles
    parameters: np.ndarray  # (m, 2, b, p) of the law, of what is reflected and of what is transmitted
    group: np.ndarray  # (m,) in which reflections are counted, -1 for none: see `reflection_counts`
    kept: np.ndarray  # (groups, b) of a reflection's energy at the anchor of its group: 1 + `anchors`


def make_surfaces(
    absorption: np.ndarray,
    scattering: np.ndarray,
    transmission: np.ndarray,
    law: np.ndarray | None = None,
    free: np.ndarray | None = None,
    group: np.ndarray | None = None,
    anchor: np.ndarray | None = None,
) -> Surfaces:
    """BSDFs from (m, b) energy fractions; (m,) rows of `bsdf.LAWS`, by default 0, which hang free, by default none,
    and the group of each, by default none, whose (groups, b) `anchors` are given."""
    count, bands = absorption.shape
    law = np.zeros(count, np.int64) if law is None else np.array(law, np.int64)
    free = np.zeros(count, bool) if free is None else free
    energy = bsdf.lobe_energies(absorption, scattering, transmission)
    mean = energy.mean(axis=2)
    explore = mean.copy()
    total = np.maximum(mean.sum(axis=1), 1e-300)
    for lobe, record in enumerate(bsdf.LOBES):
        present = mean[:, lobe] > 0.0
        explore[present, lobe] = np.maximum(mean[present, lobe], record.explored * total[present])
    rows = [energy.transpose(0, 2, 1), mean[:, None, :], explore[:, None, :]]
    proposal = np.concatenate(rows, axis=1)
    # A band that absorbs everything has no preference: it proposes what the average does.
    empty = proposal.sum(axis=2) <= 0.0
    proposal[empty] = np.broadcast_to(mean[:, None, :], proposal.shape)[empty]
    proposal /= np.maximum(proposal.sum(axis=2, keepdims=True), 1e-300)
    chance = np.full(bands + 2, (1.0 - _AVERAGE_SHARE - _EXPLORE_SHARE) / bands)
    chance[-2:] = _AVERAGE_SHARE, _EXPLORE_SHARE
    group = np.full(count, -1) if group is None else np.array(group, np.int64)
    kept = np.ones((0, bands)) if anchor is None else 1.0 + anchor
    return Surfaces(
        energy=np.ascontiguousarray(energy),
        proposal=np.ascontiguousarray(proposal),
        chance=chance,
        nominal=np.where((mean > 0.0) & ~bsdf.DELTA, proposal.mean(axis=1), 0.0),
        law=law,
        parameters=_law_parameters(law, absorption, transmission, free),
        group=group,
        kept=kept,
    )


def law_rows(names: tuple[str, ...], default: str) -> np.ndarray:
    """(m,) rows of `bsdf.LAWS` of laws by name; `default` is that of materials that name none."""
    return np.array([bsdf.LAW_NAMES.index(name or default) for name in names], np.int64)


def group_count(surfaces: Surfaces) -> int:
    """Number of groups in which reflections are counted."""
    return len(surfaces.kept)


def _law_parameters(
    law: np.ndarray, absorption: np.ndarray, transmission: np.ndarray, free: np.ndarray
) -> np.ndarray:
    """(m, 2, b, p) parameters of each material's law; p is that of the law with most."""
    found = {
        k: bsdf.LAWS[k].parameters(absorption[law == k], transmission[law == k], free[law == k])
        for k in np.unique(law)
    }
    most = max((array.shape[3] for array in found.values()), default=0)
    out = np.zeros((len(law), 2, absorption.shape[1], most))
    for k, array in found.items():
        out[law == k, :, :, : array.shape[3]] = array
    return out


# Properties


@part(forceinline=True)
def is_delta(lobe: int) -> bool:
    """Whether sound leaves in one direction, not in a spread of them."""
    return bsdf.DELTA[lobe]


@part(forceinline=True)
def is_transmission(lobe: int) -> bool:
    """Whether sound goes on behind the surface."""
    return bsdf.TRANSMITS[lobe]


@part(forceinline=True)
def lobe_albedo(surfaces: Surfaces, material: int, lobe: int) -> float:
    """Energy of a lobe at random incidence, summed over bands."""
    out = 0.0
    for b in range(surfaces.energy.shape[2]):
        out += surfaces.energy[material, lobe, b]
    return out


@part(forceinline=True)
def specular_albedo(surfaces: Surfaces, material: int) -> float:
    """Energy that is reflected in the mirror direction, at random incidence, summed over bands."""
    return lobe_albedo(surfaces, material, SPECULAR)


@part(forceinline=True)
def transmission(surfaces: Surfaces, material: int) -> float:
    """Energy that passes straight on, at random incidence, summed over bands."""
    return lobe_albedo(surfaces, material, TRANSMISSION)


@part(forceinline=True)
def diffuse_albedo(surfaces: Surfaces, material: int) -> float:
    """Energy that is scattered, at random incidence, summed over bands."""
    out = 0.0
    for lobe in range(COUNT):
        if not is_delta(lobe):
            out += lobe_albedo(surfaces, material, lobe)
    return out


@part(forceinline=True)
def can_connect(surfaces: Surfaces, material: int) -> bool:
    """Whether a vertex on this material can be connected: it scatters."""
    for lobe in range(COUNT):
        if surfaces.nominal[material, lobe] > 0.0:
            return True
    return False


# Energies


@part(forceinline=True)
def _angular_factor(surfaces: Surfaces, material: int, lobe: int, cos: float, band: int) -> float:
    """Energy that a lobe takes at an angle of incidence, over random incidence; g of both angles where it
    scatters."""
    way = 1 if is_transmission(lobe) else 0
    return bsdf.factor(surfaces.law[material], surfaces.parameters[material, way, band], cos)


@part(forceinline=True)
def apply_arrival_factor(
    surfaces: Surfaces, material: int, lobe: int, cos: float, energy: np.ndarray
) -> None:
    """Multiply `energy` (b,) by the law's factor of the angle of incidence, for the energy that a lobe takes."""
    if surfaces.law[material] != 0:
        for b in range(len(energy)):
            energy[b] *= _angular_factor(surfaces, material, lobe, cos, b)


@part(forceinline=True)
def apply_departure_factor(
    surfaces: Surfaces, material: int, lobe: int, cos_out: float, energy: np.ndarray
) -> None:
    """Multiply `energy` (b,) of a path by the law's factor of the direction that a lobe has drawn, if it
    scatters."""
    if not is_delta(lobe):
        apply_arrival_factor(surfaces, material, lobe, cos_out, energy)


@part(forceinline=True)
def apply_emission_factor(surfaces: Surfaces, material: int, cos_out: float, energy: np.ndarray) -> None:
    """The same of energy (b,) that sets out from a surface as Lambertian lobes scatter."""
    for lobe in range(COUNT):
        if bsdf.LAMBERTIAN[lobe]:
            apply_arrival_factor(surfaces, material, lobe, cos_out, energy)
            return


@part(forceinline=True)
def attenuate(
    surfaces: Surfaces, material: int, lobe: int, cos: float, energy: np.ndarray, chance: float
) -> float:
    """Multiply `energy` (b,) by what a lobe takes of it, drawn with probability `chance`; the largest that is
    left."""
    left = 0.0
    for b in range(len(energy)):
        energy[b] *= surfaces.energy[material, lobe, b] / chance
    apply_arrival_factor(surfaces, material, lobe, cos, energy)
    for b in range(len(energy)):
        left = max(left, energy[b])
    return left


@part(forceinline=True)
def attenuate_specular(surfaces: Surfaces, material: int, cos: float, energy: np.ndarray) -> float:
    """Multiply `energy` (b,) by what is reflected in the mirror direction at this angle; the largest that is
    left."""
    return attenuate(surfaces, material, SPECULAR, cos, energy, 1.0)


@part(forceinline=True)
def attenuate_transmission(surfaces: Surfaces, material: int, cos: float, energy: np.ndarray) -> float:
    """Multiply `energy` (b,) by what passes straight on at this angle; the largest that is left."""
    return attenuate(surfaces, material, TRANSMISSION, cos, energy, 1.0)


@part(forceinline=True)
def _share_of(surfaces: Surfaces, material: int, lobe: int, cos: float, band: int) -> float:
    here = surfaces.energy[material, lobe, band]
    if surfaces.law[material] != 0:
        here *= _angular_factor(surfaces, material, lobe, cos, band)
    return here


@part(forceinline=True)
def specular_reflectance(surfaces: Surfaces, material: int, cos: float, band: int) -> float:
    """Fraction of a band's energy that is reflected in the mirror direction at this angle."""
    return _share_of(surfaces, material, SPECULAR, cos, band)


@part(forceinline=True)
def transmittance(surfaces: Surfaces, material: int, cos: float, band: int) -> float:
    """Fraction of a band's energy that passes straight on at this angle."""
    return _share_of(surfaces, material, TRANSMISSION, cos, band)


@part(forceinline=True)
def lambertian_reflectance(surfaces: Surfaces, material: int, cos: float, band: int) -> float:
    """Fraction of a band's energy that Lambertian lobes scatter at this angle of incidence, but for the factor of
    the angle of departure."""
    out = 0.0
    for lobe in range(COUNT):
        if bsdf.LAMBERTIAN[lobe]:
            out += _share_of(surfaces, material, lobe, cos, band)
    return out


# Densities and values of what scatters


@part(forceinline=True)
def pdf(surfaces: Surfaces, material: int, d_in: Vec3, normal: Vec3, d_out: Vec3) -> float:
    """Nominal density, 1/sr, with which a path that comes along `d_in` leaves along `d_out`; 0 by delta lobes."""
    out = 0.0
    for lobe in range(COUNT):
        if surfaces.nominal[material, lobe] > 0.0:
            out += surfaces.nominal[material, lobe] * bsdf.pdf(lobe, d_in, normal, d_out)
    return out


@part(forceinline=True)
def reverse_pdf(surfaces: Surfaces, material: int, d_in: Vec3, normal: Vec3, d_out: Vec3) -> float:
    """`pdf` of the same event on the reversed path."""
    return pdf(surfaces, material, negate(d_out), normal, negate(d_in))


@part(forceinline=True)
def evaluate(
    surfaces: Surfaces, material: int, d_in: Vec3, normal: Vec3, d_out: Vec3, energy: np.ndarray
) -> None:
    """Multiply `energy` (b,) by the BSDF f(d_in, d_out), 1/sr, without delta lobes."""
    cos_in, cos_out = -dot(normal, d_in), dot(normal, d_out)
    for b in range(len(energy)):
        value = 0.0
        for lobe in range(COUNT):
            if surfaces.nominal[material, lobe] > 0.0:
                here = surfaces.energy[material, lobe, b] * bsdf.value(lobe, d_in, normal, d_out)
                if surfaces.law[material] != 0:
                    here *= _angular_factor(surfaces, material, lobe, cos_in, b)
                    here *= _angular_factor(surfaces, material, lobe, cos_out, b)
                value += here
        energy[b] *= value


# For patches


def lambertian_energy(surfaces: Surfaces) -> np.ndarray:
    """(m, b) energy that Lambertian lobes scatter at random incidence."""
    return np.asarray(surfaces.energy[:, bsdf.LAMBERTIAN].sum(axis=1))


def non_lambertian(surfaces: Surfaces, materials: np.ndarray) -> str:
    """Name of a lobe that scatters but is not Lambertian, of any of these materials (rows); "" if there is none."""
    for lobe in np.flatnonzero(~bsdf.DELTA & ~bsdf.LAMBERTIAN):
        if (surfaces.energy[np.unique(materials), lobe] > 0.0).any():
            return str(bsdf.LOBES[lobe].name)
    return ""
