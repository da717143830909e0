"""Accuracy against a real room: the studio of Round Robin III (PTB), curtains open and closed.

Question: By how many just-noticeable differences is the studio off, by model?

Method: Mean absolute error over 6 octave bands × 6 pairs, in just-noticeable differences: 5 % for T30 and EDT,
1 dB for C80, 5 percentage points for D50. Materials and positions are the round robin's; nothing is tuned. One
seed; `make validate` has the same by octave, in docs/validation.md.

Amortised: Nothing is timed.

Takes: 10 minutes. Argument: subpaths per point (4000). Needs ../shared/reference/ptb_studio.
"""

from __future__ import annotations

import csv
import json
from typing import Any

import numpy as np
import trimesh

import soundspaces_sim as ss
from benchmarks.tools.record import Table, table
from benchmarks.tools.scenes import SHARED, require
from soundspaces_sim.echogram.measures import room_measures
from soundspaces_sim.scene.materials import pass_absorption, porous_share
from soundspaces_sim.scene.porous_layers import with_free_sheets

FOLDER = SHARED / "reference" / "ptb_studio"
PARAMETERS = ("T30", "EDT", "C", "D")


def load_studio(state: str, sheets: bool = True) -> tuple[ss.Scene, dict]:
    """The studio with curtains 'open' or 'closed', and its description; `sheets`: curtains that hang free are."""
    room = json.loads((FOLDER / "room.json").read_text())
    mesh: Any = trimesh.load(FOLDER / f"studio_{state}.ply", process=False)
    names = list(room["materials"])
    rows = [room["materials"][n] for n in names]
    absorption = np.array([r["absorption"] for r in rows])
    table = ss.MaterialTable(
        tuple(names),
        room["frequency_hz"],
        absorption,
        np.array([r["scattering"] for r in rows]),
        np.zeros_like(absorption),
        np.array(
            [
                porous_share(pass_absorption(a)) if "curtain" in n else np.full(len(a), np.nan)
                for n, a in zip(names, absorption, strict=True)
            ]
        ),
    )
    of_face = json.loads((FOLDER / f"studio_{state}_face_materials.json").read_text())
    faces = np.array([names.index(n) for n in of_face])
    scene = ss.Scene(mesh.vertices, mesh.faces, faces, table, name=f"studio_{state}")
    return with_free_sheets(scene) if sheets else scene, room


def measured() -> dict[tuple[str, str, int, str], float]:
    with open(FOLDER / "measured.csv") as file:
        return {
            (r["room"], r["param"], int(r["band_hz"]), r["pair"]): float(r["value"])
            for r in csv.DictReader(file)
        }


def differences(state: str, walks: int, seed: int = 0, **settings: Any) -> dict[str, np.ndarray]:
    """Absolute errors (pairs, bands) in JND of each parameter; `settings`: of the engine."""
    return differences_of(load_studio(state)[0], state, walks, seed, **settings)


def config_of(room: dict, walks: int, **settings: Any) -> ss.SimulationConfig:
    """Octave bands and climate of the studio."""
    octaves = np.array(room["frequency_hz"], float)
    return ss.SimulationConfig(
        bands=tuple(np.append(octaves / np.sqrt(2.0), octaves[-1] * np.sqrt(2.0))),
        walks=walks, connections=ss.ConnectionsConfig(subpaths=128), temperature_c=room["temperature_c"],
        humidity_percent=room["humidity_pct"], max_duration=4.0, **settings,
    )  # fmt: skip


def differences_of(
    scene: ss.Scene, state: str, walks: int, seed: int = 0, **settings: bool
) -> dict[str, np.ndarray]:
    """`differences` of a scene that stands for the studio in that state."""
    return against_measured(computed(scene, walks, seed, **settings), state)


def computed(scene: ss.Scene, walks: int, seed: int = 0, **settings: Any) -> dict[str, np.ndarray]:
    """(pairs, bands) of each parameter in a scene that stands for the studio, sources outermost."""
    room = json.loads((FOLDER / "room.json").read_text())
    config = config_of(room, walks, **settings)
    sources, receivers = room["sources_m"], room["receivers_m"]
    echoes = ss.simulate(scene, list(sources.values()), list(receivers.values()), config, seed)
    found = [room_measures(echoes[i, j]) for i in range(echoes.shape[0]) for j in range(echoes.shape[1])]
    names = {"T30": "t30", "EDT": "edt", "C": "c80", "D": "d50"}
    return {p: np.array([getattr(m, names[p]) for m in found]) for p in PARAMETERS}


def measured_pairs(state: str) -> dict[str, np.ndarray]:
    """(pairs, bands) of each parameter as measured, sources outermost."""
    room, truth = json.loads((FOLDER / "room.json").read_text()), measured()
    pairs = [s + r for s in room["sources_m"] for r in room["receivers_m"]]
    out = {}
    for p in PARAMETERS:
        want = np.array(
            [[truth[f"ptb_studio_{state}", p, f, pair] for f in room["frequency_hz"]] for pair in pairs]
        )
        out[p] = 0.01 * want if p == "D" else want  # that table is in per cent
    return out


def against_measured(values: dict[str, np.ndarray], state: str) -> dict[str, np.ndarray]:
    """Absolute errors in JND of (pairs, bands) values, sources outermost."""
    return pair_by_pair(values, measured_pairs(state))


def pair_by_pair(values: dict[str, np.ndarray], wanted: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """(pairs, bands) absolute errors in JND of values (pairs, bands), for what is wanted: (pairs, bands), or
    (1, bands) where the mean over pairs alone is published."""
    return {p: jnd(p, values[p], want) for p, want in wanted.items() if p in values}


def of_means(values: dict[str, np.ndarray], wanted: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """(1, bands) absolute errors in JND of the mean over pairs, where what single pairs are off by averages
    out."""
    return pair_by_pair(
        *({p: np.nanmean(v, axis=0, keepdims=True) for p, v in x.items()} for x in (values, wanted))
    )


def jnd(parameter: str, ours: np.ndarray, want: np.ndarray) -> np.ndarray:
    """Absolute differences in JND; times in s, C80 in dB, D50 from 0 to 1."""
    if parameter in ("T20", "T30", "EDT"):
        return np.abs(ours / want - 1.0) / 0.05
    return np.abs(ours - want) / (1.0 if parameter == "C" else 0.05)


def errors(state: str, walks: int, seed: int = 0, **settings: Any) -> dict[str, float]:
    """Mean error in JND per parameter; `settings`: of the engine."""
    return {p: float(v.mean()) for p, v in differences(state, walks, seed, **settings).items()}


_MODELS: dict[str, dict[str, Any]] = {
    "neither diffraction nor porous layers, scattering of the table": {
        "diffraction": False, "porous_layers": False, "scattering": "table",
    },
    "diffraction": {"porous_layers": False, "scattering": "table"},
    "porous layers": {"diffraction": False, "scattering": "table"},
    "default": {},
}  # fmt: skip
#: Of the round robin's report, and the targets of this project.
_OTHERS = (
    ("target", "mean", 1.5, 2.2, 1.0, 1.0),
    ("plain forward tracer", "mean", 1.64, 2.6, 1.09, 1.06),
    ("round robin, best of 17 programs in each", "mean", 1.44, 2.18, 0.96, 0.97),
)


def run(walks: str = "4000") -> list[Table]:
    """Errors by model and state of the curtains."""
    require(FOLDER)
    rows: list[tuple[object, ...]] = []
    for name, settings in _MODELS.items():
        found = [errors(state, int(walks), **settings) for state in ("open", "closed")]
        rows += [
            (name, f"curtains {state}", *(f[p] for p in PARAMETERS))
            for state, f in zip(("open", "closed"), found, strict=True)
        ]
        rows.append((name, "mean", *(float(np.mean([f[p] for f in found])) for p in PARAMETERS)))
    heads = ["", "", *((name, "JND") for name in ("T30", "EDT", "C80", "D50"))]
    note = f"{int(walks):,} subpaths per point."
    return [table("Mean errors, 6 octave bands × 6 pairs", heads, [*rows, *_OTHERS], note)]
