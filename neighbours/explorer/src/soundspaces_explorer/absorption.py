"""A scene whose materials absorb other shares of sound, and the file of materials that says so."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from soundspaces_sim import MaterialTable, Scene
from soundspaces_sim.parts import limit_transmission, overlay_tables

_INSIDE = 1e-6  # relative, by which frequencies lie beside an edge or a step


def with_absorption(scene: Scene, chosen: Mapping[str, np.ndarray], bands: Sequence[float]) -> Scene:
    """The scene with other absorption (B,) of some materials between edges (B + 1,), Hz."""
    before = scene.materials
    table = overlay_tables(before, chosen_table(before, chosen, bands))
    row = np.array([table.index(name) for name in before.names])
    return replace(scene, materials=table, face_material=row[scene.face_material])


def chosen_table(
    table: MaterialTable, chosen: Mapping[str, np.ndarray], bands: Sequence[float]
) -> MaterialTable:
    """The chosen materials alone, so that an overlay leaves all others as they are.

    A table is a staircase over log frequency with steps half way between two frequencies. So two frequencies just
    within the edges of every band give it one value throughout, and two beside every step of the table keep the
    steps of other materials where they are.
    """
    edges, steps = np.asarray(bands, float), np.sqrt(table.frequency_hz[:-1] * table.frequency_hz[1:])
    ends = np.maximum(edges, 1.0)
    beside = (
        np.concatenate([ends[:-1], steps]) * (1 + _INSIDE),
        np.concatenate([ends[1:], steps]) * (1 - _INSIDE),
    )
    frequency = np.unique(np.concatenate(beside))
    band = np.clip(np.searchsorted(edges, frequency, "right") - 1, 0, len(edges) - 2)
    rows = [table.index(name) for name in chosen]
    absorption = np.array([np.asarray(a, float) for a in chosen.values()])
    _, scattering, transmission = table.in_bands(bands)
    return MaterialTable(
        tuple(chosen),
        frequency,
        absorption[:, band],
        scattering[rows][:, band],
        limit_transmission(absorption, transmission[rows])[:, band],
        table.sheet[rows][:, np.searchsorted(steps, frequency, "right")],
        reflection=tuple(table.reflection[row] for row in rows),
        mounting=tuple(table.mounting[row] for row in rows),
    )


def materials_file(table: MaterialTable) -> str:
    """TOML that `load_materials` and `--materials` read."""

    def numbers(values: np.ndarray) -> str:
        return "[" + ", ".join(f"{float(x):.10g}" for x in values) + "]"

    lines = [f"frequency_hz = {numbers(table.frequency_hz)}"]
    for row, name in enumerate(table.names):
        lines += ["", f"[materials.{json.dumps(name)}]"]
        for column in ("absorption", "scattering", "transmission"):
            lines.append(f"{column} = {numbers(getattr(table, column)[row])}")
        if np.isfinite(table.sheet[row]).all():
            lines.append(f"sheet = {numbers(table.sheet[row])}")
        if table.reflection[row]:
            lines.append(f'reflection = "{table.reflection[row]}"')
    return "\n".join(lines) + "\n"
