"""Random directions: each `sample_x` has its `pdf_x`, per steradian, beside it.

Directions are unit vectors; `u`, `v` are uniform in [0, 1). Source of the mappings: Pharr, Jakob, Humphreys,
Physically Based Rendering, appendix A.5.
"""

import math

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.vec3 import Vec3, orthonormal_frame

INV_4PI = 1.0 / (4.0 * math.pi)
INV_PI = 1.0 / math.pi

# Plastic-number sequence (Roberts 2018): a low-discrepancy additive recurrence in two dimensions.
_R2_1 = 0.7548776662466927
_R2_2 = 0.5698402909980532


@part
def sample_sphere(u: float, v: float) -> Vec3:
    """Uniform direction on the unit sphere from two uniform numbers."""
    z = 1.0 - 2.0 * u
    r = math.sqrt(max(0.0, 1.0 - z * z))
    phi = 2.0 * math.pi * v
    return r * math.cos(phi), r * math.sin(phi), z


@part
def stratified_pair(index: int, shift_u: float, shift_v: float) -> tuple[float, float]:
    """Point `index` of the R2 sequence under a random shift modulo 1 (each point is uniform)."""
    u = shift_u + (index + 1) * _R2_1
    v = shift_v + (index + 1) * _R2_2
    return u - math.floor(u), v - math.floor(v)


@part(forceinline=True)
def sample_cosine_hemisphere(n: Vec3, u: float, v: float) -> Vec3:
    """Direction about the unit normal n, with a density in proportion to its cosine (Lambert)."""
    r = math.sqrt(u)
    phi = 2.0 * math.pi * v
    x, y, z = r * math.cos(phi), r * math.sin(phi), math.sqrt(max(0.0, 1.0 - u))
    s, t = orthonormal_frame(n)
    return (
        x * s[0] + y * t[0] + z * n[0],
        x * s[1] + y * t[1] + z * n[1],
        x * s[2] + y * t[2] + z * n[2],
    )


@part
def pdf_cosine(cos_theta: float) -> float:
    """Of `sample_cosine_hemisphere`: cos / pi."""
    return max(0.0, cos_theta) * INV_PI
