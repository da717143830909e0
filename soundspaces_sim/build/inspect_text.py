"""The report of `inspect` as a page."""

from __future__ import annotations

import numpy as np

from soundspaces_sim.build.inspect import SceneReport
from soundspaces_sim.build.inspect_t30 import WALKS
from soundspaces_sim.core.numerics.bands import center_frequencies
from soundspaces_sim.scene.frame import DOUBT
from soundspaces_sim.scene.labels import WITHOUT


def _list_areas(areas: dict[str, float], most: int = 5) -> str:
    listed = [f"{label or 'no label'} {area:.1f}" for label, area in list(areas.items())[:most]]
    return ", ".join(listed) + (", …" if len(areas) > most else "")


def _storey_lines(r: SceneReport) -> list[str]:
    """How many points are on each storey, and whether one can walk there; what is no storey."""
    lines = []
    for low, high, count, air, walked, area in zip(
        r.floor_low,
        r.floor_high,
        r.storey_points,
        r.in_air,
        r.storeys.walked,
        r.storeys.area,
        strict=True,
    ):
        floor = f"{low:.2f}" if high - low < 0.01 else f"{low:.2f} to {high:.2f}"
        free = f", {area:.1f} m² to stand on" if np.isfinite(area) else ""
        above = f", {air} of them in mid-air" if air else ""
        way = "" if walked else "; cannot be walked onto"
        lines.append(f"    floor at {floor} m: {count} points{above}{free}{way}")
    return lines + [f"    {reason}" for reason in r.storeys.left_out]


def report_text(r: SceneReport) -> str:
    """The report as a page."""
    bands = " ".join(f"{f:>8.0f}" for f in center_frequencies(r.bands))
    lines = [
        f"{r.name}",
        f"  {r.triangles:,} triangles in {r.components:,} pieces; {r.size[0]:.1f} × {r.size[1]:.1f} × "
        f"{r.size[2]:.1f} m; surface {r.area:.0f} m², enclosed volume about {r.volume:.0f} m³",
        *(
            f"  note: {note}" for note in r.notes if WITHOUT not in note and not note.startswith(DOUBT)
        ),  # the table of materials has these
        "",
        "Where points stand",
        f"  {len(r.storeys.floors)} storey(s); of {r.candidates} points, {r.spacing:g} m apart, {r.points} survive",
        *_storey_lines(r),
        "  closed-ness of these, at 0, 10, 50, 90, 100 %: "
        + "  ".join(f"{c:.2f}" for c in r.closedness),
        f"  {100.0 * r.escape:.2f} % of reflections lead out of the mesh",
        "",
        "Materials                       area m²   share   met by sound",
    ]
    for name, area in sorted(r.material_areas.items(), key=lambda item: -item[1]):
        met = 100.0 * r.material_share.get(name, 0.0)
        lines.append(f"  {name:<28s}{area:>9.1f}  {100.0 * area / r.area:5.1f} %      {met:5.1f} %")
    lines += [
        f"  without a label             {r.unlabelled_area:>9.1f}  {100.0 * r.unlabelled_area / r.area:5.1f} %",
        f"  of the default material     {r.default_area:>9.1f}  {100.0 * r.default_area / r.area:5.1f} %"
        + (f"  ({_list_areas(r.default_labels)})" if r.default_labels else ""),
        "",
        f"Sound                    Hz {bands}",
        "  mean absorption           " + " ".join(f"{a:>8.2f}" for a in r.absorption),
        "  T30, simulated, s         " + " ".join(f"{t:>8.2f}" for t in r.t30),
        "  … known to, s             " + " ".join(f"{t:>8.3f}" for t in r.t30_spread),
        "  T60 after Eyring, s       " + " ".join(f"{t:>8.2f}" for t in r.eyring),
        f"  T30 is the median of {r.t30_pairs} pairs of points, {WALKS:,} subpaths each. It is known to as much as",
        "  laboratories differ that measure absorption (ISO 12999-2, one standard deviation). Eyring's formula",
        f"  assumes a diffuse field, with the measured mean free path of {r.free_path:.2f} m, and takes what walls",
        "  let through as absorbed; where the two disagree, the field is not diffuse, or rooms are coupled",
        "",
    ]
    lines += [f"warning: {w}" for w in r.warnings] or ["Nothing looks wrong."]
    return "\n".join(lines)
