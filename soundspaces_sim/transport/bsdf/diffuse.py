"""Lambert's law: the same radiance in all directions."""

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.scene.rays.directions import INV_PI, pdf_cosine, sample_cosine


@part(forceinline=True)
def sample(_, normal, u, v):
    return sample_cosine(normal[0], normal[1], normal[2], u, v)


@part(forceinline=True)
def pdf(_, normal, d_out):
    return pdf_cosine(normal[0] * d_out[0] + normal[1] * d_out[1] + normal[2] * d_out[2])


@part(forceinline=True)
def value(_, normal, d_out):
    return INV_PI
