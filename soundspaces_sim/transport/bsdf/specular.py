"""Specular reflection: the angle of incidence is that of reflection."""

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.scene.rays.directions import reflect


@part(forceinline=True)
def sample(d_in, normal, u, v):
    return reflect(d_in[0], d_in[1], d_in[2], normal[0], normal[1], normal[2])
