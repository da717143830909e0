"""Transmission straight on."""

from soundspaces_sim.core.numerics.kernel import part


@part(forceinline=True)
def sample(d_in, normal, u, v):
    return d_in
