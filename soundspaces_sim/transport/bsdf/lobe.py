"""What a lobe of a BSDF is: the record that its file ends with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3


@part(forceinline=True)
def _nothing(d_in: Vec3, normal: Vec3, d_out: Vec3) -> float:
    """`pdf` and `value` of a delta lobe: no given direction is its own."""
    return 0.0


class Lobe(NamedTuple):
    """One way in which a surface sends sound on.

    `name`: for messages. `energy(absorption, scattering, transmission)` (m, b): fraction of what comes, or, if the
    lobe takes part of another one's energy, `of`, the fraction of that. Compiled: `sample(d_in, normal, uv)` a
    direction from two uniform numbers; `pdf(d_in, normal, d_out)` its density, 1/sr; `value(d_in, normal, d_out)`
    energy scattered into d_out, 1/sr, of 1 that the lobe takes. `delta`: one direction only, without `pdf` and
    `value`; `transmits`: it goes on behind the surface; `lambertian`: `value` is constant. `explored`: least
    probability with which proposals that explore take it.
    """

    name: str
    energy: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    sample: Any
    pdf: Any = _nothing
    value: Any = _nothing
    delta: bool = False
    transmits: bool = False
    lambertian: bool = False
    explored: float = 0.0
    of: str | None = None
