"""Derivatives of what lobes reflect by the scattering of a material's table.

A score is d ln(energy) / d(scattering): of a lobe; or of a path, whose energy is a product over its reflections,
so that it is the sum of theirs (docs/theory.md, section 11).
"""

import numpy as np

from soundspaces_sim.core.numerics.kernel import part
from soundspaces_sim.transport import bsdf
from soundspaces_sim.transport.bsdf import COUNT
from soundspaces_sim.transport.bsdf.surface import Surfaces, group_count, is_delta


def with_scores(
    surfaces: Surfaces,
    absorption: np.ndarray,
    scattering: np.ndarray,
    transmission: np.ndarray,
    own: np.ndarray,
) -> tuple[Surfaces, np.ndarray]:
    """Surfaces whose paths know how their energies depend on scattering, and (groups, b) whether they do not: where
    a lobe has no energy, but would have with other scattering, nobody walks its paths.

    (m, b) fractions as in `make_surfaces`; `own`: d(scattering) / d(scattering of the table). Lobes' energies are
    linear in scattering.
    """
    ends = [
        bsdf.lobe_energies(absorption, np.full_like(scattering, s), transmission) for s in (0.0, 1.0)
    ]
    change = (ends[1] - ends[0]) * own[:, None]
    there = surfaces.energy > 0.0
    score = np.divide(change, surfaces.energy, out=np.zeros_like(change), where=there)
    unknown = np.zeros_like(surfaces.kept, bool)
    counted = surfaces.group >= 0
    np.logical_or.at(unknown, surfaces.group[counted], ((change != 0.0) & ~there).any(axis=1)[counted])
    return surfaces._replace(score=np.ascontiguousarray(score)), unknown


def score_count(surfaces: Surfaces) -> int:
    """Number of groups for which paths carry scores: all, or none where they are not wanted."""
    return group_count(surfaces) if len(surfaces.score) else 0


def scattered_score(surfaces: Surfaces) -> np.ndarray:
    """(m, b) scores of all that scatters: see `add_scattered_scores`."""
    energy = surfaces.energy[:, ~bsdf.DELTA]
    total, change = energy.sum(axis=1), (energy * surfaces.score[:, ~bsdf.DELTA]).sum(axis=1)
    return np.divide(change, total, out=np.zeros_like(total), where=total > 0.0)


@part(forceinline=True)
def add_scores(surfaces: Surfaces, material: int, lobe: int, scores: np.ndarray) -> None:
    """Add those of a lobe to a path's `scores` (groups, b)."""
    group = surfaces.group[material]
    if 0 <= group < len(scores):
        for b in range(scores.shape[1]):
            scores[group, b] += surfaces.score[material, lobe, b]


@part(forceinline=True)
def add_scattered_scores(surfaces: Surfaces, material: int, scores: np.ndarray) -> None:
    """The same of all that scatters, as a connection or a patch takes it: of lobes of one shape."""
    group = surfaces.group[material]
    if not 0 <= group < len(scores):
        return
    for b in range(scores.shape[1]):
        energy, change = 0.0, 0.0
        for lobe in range(COUNT):
            if not is_delta(lobe):
                energy += surfaces.energy[material, lobe, b]
                change += surfaces.energy[material, lobe, b] * surfaces.score[material, lobe, b]
        if energy > 0.0:
            scores[group, b] += change / energy
