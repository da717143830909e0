"""A toy lobe: half of the diffuse energy goes rather forward and back than to the sides,
f = (1 + cos(2 (phi_out - phi_in)) / 2) / pi, with azimuths phi about the normal."""

import math

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, dot, orthonormal_frame
from soundspaces_sim.transport.bsdf.lobe import Lobe


def energy(absorption: np.ndarray, scattering: np.ndarray, transmission: np.ndarray) -> np.ndarray:
    return np.full(absorption.shape, 0.5)


@part
def _azimuth(normal: Vec3, d: Vec3) -> float:
    s, t = orthonormal_frame(normal)
    return math.atan2(dot(d, t), dot(d, s))


@part
def sample(d_in: Vec3, normal: Vec3, uv: tuple[float, float]) -> Vec3:
    low, high = 0.0, 2.0 * math.pi
    for _ in range(60):  # inverts the distribution of the azimuth from that of incidence
        middle = 0.5 * (low + high)
        if middle + 0.25 * math.sin(2.0 * middle) < 2.0 * math.pi * uv[1]:
            low = middle
        else:
            high = middle
    phi = _azimuth(normal, d_in) + low
    r, z = math.sqrt(uv[0]), math.sqrt(1.0 - uv[0])
    s, t = orthonormal_frame(normal)
    x, y = r * math.cos(phi), r * math.sin(phi)
    return (
        x * s[0] + y * t[0] + z * normal[0],
        x * s[1] + y * t[1] + z * normal[1],
        x * s[2] + y * t[2] + z * normal[2],
    )


@part
def value(d_in: Vec3, normal: Vec3, d_out: Vec3) -> float:
    between = _azimuth(normal, d_out) - _azimuth(normal, d_in)
    return (1.0 + 0.5 * math.cos(2.0 * between)) / math.pi


@part
def pdf(d_in: Vec3, normal: Vec3, d_out: Vec3) -> float:
    return float(value(d_in, normal, d_out) * max(dot(normal, d_out), 0.0))


LOBE = Lobe("sheen", energy, sample, pdf, value, of="diffuse")
