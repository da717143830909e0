"""Emission: where sound leaves a point.

Sources and listeners are both omnidirectional points, so the same subpath serves in both roles. What a source or a
listener prefers is put on afterwards, from the directions that the tables keep (`echogram.endpoints`).
"""

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.core.numerics.rng import combine, hashed_uniform
from soundspaces_sim.core.numerics.vec3 import Vec3
from soundspaces_sim.scene.rays.directions import sample_sphere, stratified_pair
from soundspaces_sim.transport.tables import BATCHES


@part
def emit(key: int, index: int) -> Vec3:
    """First direction of subpath `index` of the point of this `key`: stratified within its batch.

    Every batch is a randomly shifted low-discrepancy set of its own, so batches are independent.
    """
    batch = index % BATCHES
    batch_key = combine(key, 2 * batch + 1)
    u, v = stratified_pair(index // BATCHES, hashed_uniform(batch_key, 1), hashed_uniform(batch_key, 2))
    return sample_sphere(u, v)
