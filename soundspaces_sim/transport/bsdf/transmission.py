"""Transmission straight on, without refraction."""

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3
from soundspaces_sim.transport.bsdf.lobe import Lobe


def energy(absorption: np.ndarray, scattering: np.ndarray, transmission: np.ndarray) -> np.ndarray:
    return transmission


@part(forceinline=True)
def sample(d_in: Vec3, normal: Vec3, uv: tuple[float, float]) -> Vec3:
    return d_in


LOBE = Lobe("transmission", energy, sample, delta=True, transmits=True, explored=0.1)
