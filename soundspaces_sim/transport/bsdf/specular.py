"""Specular reflection: the angle of incidence is that of reflection."""

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, reflect
from soundspaces_sim.transport.bsdf.lobe import Lobe


def energy(absorption: np.ndarray, scattering: np.ndarray, transmission: np.ndarray) -> np.ndarray:
    return np.maximum(1.0 - absorption - transmission, 0.0) * (1.0 - scattering)


@part(forceinline=True)
def sample(d_in: Vec3, normal: Vec3, uv: tuple[float, float]) -> Vec3:
    return reflect(d_in, normal)


LOBE = Lobe("specular", energy, sample, delta=True)
