"""Diffuse reflection by Lambert's law: the same radiance in all directions, f = 1 / pi.

Source: Kuttruff, Room Acoustics, 4.1; the scattering coefficient of ISO 17497-1 is its share of what is reflected.
"""

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, dot
from soundspaces_sim.scene.rays.directions import INV_PI, pdf_cosine, sample_cosine_hemisphere
from soundspaces_sim.transport.bsdf.lobe import Lobe


def energy(absorption: np.ndarray, scattering: np.ndarray, transmission: np.ndarray) -> np.ndarray:
    return np.maximum(1.0 - absorption - transmission, 0.0) * scattering


@part(forceinline=True)
def sample(d_in: Vec3, normal: Vec3, uv: tuple[float, float]) -> Vec3:
    return sample_cosine_hemisphere(normal, uv[0], uv[1])


@part(forceinline=True)
def pdf(d_in: Vec3, normal: Vec3, d_out: Vec3) -> float:
    return pdf_cosine(dot(normal, d_out))


@part(forceinline=True)
def value(d_in: Vec3, normal: Vec3, d_out: Vec3) -> float:
    return INV_PI


LOBE = Lobe("diffuse", energy, sample, pdf, value, lambertian=True, explored=0.25)
