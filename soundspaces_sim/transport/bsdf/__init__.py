"""BSDFs: how surfaces reflect, scatter and transmit sound (bidirectional scattering distribution functions).

A surface's BSDF is a sum of *lobes*, one file each, and a *reflection law*, which says how their energy depends
on the angle of incidence. Nothing outside this package names a lobe: `surface` answers by property
(`specular_albedo`, `diffuse_albedo`, `transmission`, `is_delta`, …), `sampling` draws.

Conventions: directions are unit vectors (x, y, z) along which sound travels, `d_in` to the surface and `d_out`
away from it; `normal` is on the side from which sound comes. Surfaces are two-sided.

**A lobe** is a file here that ends with its record (`lobe.Lobe`), and a line in `LOBES`. `value` times the cosine
of d_out is `pdf`, integrates to one over the hemisphere, and is the same with both directions reversed and swapped
(reciprocity): tests/transport/test_bsdf.py holds every lobe to that. A lobe that takes a part of another one's
energy names it (`of`). One delta lobe reflects and one transmits, as image sources and straight paths through walls
assume.

Patches (`radiance_transfer`) carry late sound of Lambertian lobes. Where a scene has another one that scatters,
receiver volumes make late sound (`radiance_transfer.prepared.late_technique`).

**A reflection law** is a file here and its row in the table of laws (`core.numerics.reflection_laws`). It has

    parameters(absorption, transmission, free) -> (m, 2, b, p)
        of m materials in b bands; `free` (m,): which hang free in air; for reflection and for transmission
    factor(parameters, cos)
        (compiled) energy at an angle of incidence over that at random incidence

Means of `factor` over random incidence are one: coefficients of materials are those at random incidence.
"""

from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.reflection_laws import REFLECTION_LAWS
from soundspaces_sim.transport.bsdf import diffuse, specular, transmission

LOBES = (diffuse.LOBE, specular.LOBE, transmission.LOBE)
LAWS: tuple[ModuleType, ...] = tuple(import_module(law.target) for law in REFLECTION_LAWS.values())
LAW_NAMES = tuple(REFLECTION_LAWS)

COUNT = len(LOBES)
DELTA = np.array([lobe.delta for lobe in LOBES])
TRANSMITS = np.array([lobe.transmits for lobe in LOBES])
LAMBERTIAN = np.array([lobe.lambertian for lobe in LOBES])


def _only(which: np.ndarray) -> int:
    (number,) = np.flatnonzero(which)
    return int(number)


SPECULAR = _only(DELTA & ~TRANSMITS)
TRANSMISSION = _only(DELTA & TRANSMITS)


def select(functions: list[Any]) -> Any:
    """A compiled function of (number, …) that calls the function of that number with the rest; the last one for
    numbers beyond."""
    first = functions[-1]

    @part(forceinline=True)
    def chosen(number: int, *arguments: Any) -> Any:
        return first(*arguments)

    for number in reversed(range(len(functions) - 1)):
        chosen = _either(number, functions[number], chosen)
    return chosen


def _either(own: int, function: Any, others: Any) -> Any:
    @part(forceinline=True)
    def chosen(number: int, *arguments: Any) -> Any:
        if number == own:
            return function(*arguments)
        return others(number, *arguments)

    return chosen


sample = select([lobe.sample for lobe in LOBES])
pdf = select([lobe.pdf for lobe in LOBES])
value = select([lobe.value for lobe in LOBES])
factor = select([law.factor for law in LAWS])


def lobe_energies(
    absorption: np.ndarray, scattering: np.ndarray, transmission: np.ndarray
) -> np.ndarray:
    """(m, COUNT, b) fraction of the energy that comes to a surface which each lobe takes."""
    energies: dict[str, np.ndarray] = {}
    for lobe in LOBES:
        share = lobe.energy(absorption, scattering, transmission)
        if lobe.of is not None:
            share, energies[lobe.of] = share * energies[lobe.of], (1.0 - share) * energies[lobe.of]
        energies[lobe.name] = share
    return np.stack(list(energies.values()), axis=1)
