"""Apartments: flats whose height and finishes differ, soft to bare, evenly over their numbers."""

from __future__ import annotations

import numpy as np
import pytest
from soundspaces_agents.flats import load_flat
from soundspaces_agents.flats.apartment import FINISHES, apartment_mesh, bareness
from soundspaces_agents.flats.boxes import flat_mesh

import soundspaces_sim as ss
from soundspaces_sim.core.config import GraphConfig
from soundspaces_sim.scene.materials import load_materials


def absorption_area(scene: ss.Scene) -> float:
    """m² at 1 kHz, by the areas of all triangles."""
    a, b, c = (scene.corners[:, k] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    k = int(np.argmin(np.abs(scene.materials.frequency_hz - 1000.0)))
    return float((area * scene.materials.absorption[scene.face_material, k]).sum())


def test_finishes_are_ordered_and_known() -> None:
    """By the table's absorption at 1 kHz nothing is much softer than what stands before it."""
    table = load_materials()
    k = int(np.argmin(np.abs(table.frequency_hz - 1000.0)))
    alpha = dict(zip(table.names, table.absorption[:, k], strict=True))
    for thing, materials in FINISHES.items():
        values = [alpha[m] if m else 0.0 for m in materials]
        assert max(np.diff(values)) < 0.16, thing
        assert values[-1] <= 0.12 < 0.35 <= values[0] or thing in (
            "wall",
            "window",
            "pillow",
            "blanket",
        ), thing


def test_any_run_of_numbers_covers_the_range() -> None:
    for first in (0, 24, 28, 1000):
        found = np.sort([bareness(k) for k in range(first, first + 24)])
        assert np.diff([found[-1] - 1.0, *found]).max() < 0.1  # three distances: at most .083 for 24


@pytest.mark.parametrize("seed", [3, 5])
def test_an_apartment_is_one_piece_and_the_same_every_time(seed: int) -> None:
    scene = load_flat(f"apartment-{seed}")
    mesh = apartment_mesh(seed)
    assert mesh.vertices.tobytes() == apartment_mesh(seed).vertices.tobytes()
    assert len(mesh.vertices) != len(flat_mesh(seed).vertices)  # plans of their own
    assert 2.5 <= scene.bounds[1, 2] - 0.2 <= 4.0
    assert [note for note in scene.notes if "lie in one plane" not in note] == []
    grid = ss.make_grid(scene, config=ss.GridConfig(spacing=1.0, rays=200))
    graph = ss.make_graph(scene, grid, GraphConfig())
    assert (graph.component[graph.nodes] == 0).all() and 44 <= len(graph.nodes) <= 69
    labels = {label.partition("-")[0] for label in scene.labels}
    assert {"wall", "floor", "ceiling"} <= labels


def test_bare_apartments_absorb_less() -> None:
    soft, bare = (load_flat(f"apartment-{k}") for k in (5, 8))  # .09 and .94 bare
    assert absorption_area(soft) > 5.0 * absorption_area(bare)
    with pytest.raises(ss.SceneError, match="apartment: expected a number"):
        apartment_mesh(-1)
