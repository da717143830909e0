"""Accuracy against two more measured rooms whose data are public: a seminar room (BRAS CR2) and a hall (Elmia).

Question: By how many just-noticeable differences are two public rooms off?

Method: Errors in just-noticeable differences as in `ptb_studio`, pair by pair and of the mean over pairs.
Materials and positions are as published; nothing is tuned. Data are looked for in ../shared/reference, or in
the folder that VALIDATION_ROOMS names:

- ``bras_cr2``: BRAS (Aspöck, Brinkmann, Ackermann, Weinzierl, Vorländer 2020, doi:10.14279/depositonce-6726,
  CC BY-SA 4.0), its complex room 2: ``mat_CR2_*.csv`` (the "fitted estimates": absorption scaled to the measured
  T by Eyring's formula), ``Evaluation_CR2_{T20,EDT,C80,D50}.txt`` (measured, mean over 10 pairs); ``scene9.ac``
  and ``Scene09_Informed.rpf`` of the informed simulations (Aspöck, RWTH publication 803828, CC BY-NC-SA 4.0).
  github.com/krzysztofarendt/building3d-rs at 60b4ed3 has all of them, below ``validation/bras``.
- ``elmia``: PTB's Round Robin II (Bork 2000), the hall in Jönköping: ``elmia.ply``, ``material_catt.txt``,
  ``elmia_coordinates.xls`` and ``Auswertung_Phase_II.xls``, with what 13 entries computed, as I-Simpa carries
  them: github.com/Universite-Gustave-Eiffel/I-Simpa at 929a5c8, ``src/isimpa/resources/doc/tutorial/tutorial 2``.

Amortised: Nothing is timed.

Takes: 10 minutes. Arguments: subpaths per point (4000), seeds (1). Needs the data, and the extra ``validate``.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

import soundspaces_sim as ss
from benchmarks.accuracy.ptb_studio import FOLDER, of_means, pair_by_pair
from benchmarks.tools.record import Table, UnavailableError, table
from soundspaces_sim.echogram.measures import room_measures

ROOMS = Path(os.environ.get("VALIDATION_ROOMS", FOLDER.parent))
OCTAVES = np.array([125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0])
_PARAMETERS = {
    "T30/s": "T30",
    "EDT/s": "EDT",
    "D/%": "D",
    "C/dB": "C",
}  # as the round robin's sheets say it


@dataclass(frozen=True)
class Room:
    """A room as published. `measured`, and each of `others`: (pairs, octaves) per parameter, or (1, octaves) for
    the mean over pairs; times in s, C80 in dB, D50 from 0 to 1."""

    scene: ss.Scene
    sources: np.ndarray
    receivers: np.ndarray
    measured: dict[str, np.ndarray]
    others: tuple[dict[str, np.ndarray], ...]
    temperature_c: float
    humidity_percent: float


def available() -> list[str]:
    """Names of the rooms whose folders are there."""
    return [name for name in ("bras_cr2", "elmia") if (ROOMS / name).is_dir()]


def load(name: str) -> Room:
    """A room by name."""
    return {"bras_cr2": _seminar_room, "elmia": _hall}[name](ROOMS / name)


def _triangles(points: np.ndarray, polygon: list[int]) -> list[list[int]]:
    """A flat polygon as triangles; it may be concave."""
    if len(polygon) == 3:
        return [polygon]
    corners = points[polygon]
    normal = np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)
    if np.linalg.norm(normal) < 1e-12:
        return []
    plane = trimesh.geometry.plane_transform(corners[0], normal / np.linalg.norm(normal))
    flat = trimesh.transform_points(corners, plane)[:, :2]
    import mapbox_earcut

    rows = mapbox_earcut.triangulate_float64(flat, np.array([len(flat)], np.uint32)).reshape(-1, 3)
    return [[polygon[i] for i in row] for row in rows]


def _upright(points: np.ndarray) -> np.ndarray:
    """(n, 3) of a frame whose y is up."""
    return np.asarray(points)[:, [0, 2, 1]] * [1.0, -1.0, 1.0]


def _seminar_room(folder: Path) -> Room:
    lines = (folder / "scene9.ac").read_text().splitlines()
    names = [line.split('"')[1].split("_")[-1] for line in lines if line.startswith("MATERIAL")]
    vertices: list[list[float]] = []
    faces: list[list[int]] = []
    material: list[int] = []
    at = 0
    while at < len(lines):
        word, *rest = lines[at].split() or [""]
        at += 1
        if word == "numvert":
            before, count = len(vertices), int(rest[0])
            vertices += [[float(x) for x in line.split()] for line in lines[at : at + count]]
            at += count
        elif word == "mat":
            of = int(rest[0])
        elif word == "refs":
            polygon = [before + int(line.split()[0]) for line in lines[at : at + int(rest[0])]]
            at += int(rest[0])
            new = _triangles(np.array(vertices), polygon)
            faces += new
            material += [of] * len(new)
    rows = [np.loadtxt(folder / f"mat_CR2_{name}.csv", delimiter=",") for name in names]
    table = ss.MaterialTable(
        tuple(names),
        rows[0][0],
        np.array([r[1] for r in rows]),
        np.array([r[2] for r in rows]),
        np.zeros((len(rows), len(rows[0][0]))),
    )
    scene = ss.Scene(
        _upright(np.array(vertices)), np.array(faces), np.array(material), table, name="bras_cr2"
    )
    text = (folder / "Scene09_Informed.rpf").read_text()

    def places(key: str) -> np.ndarray:
        (found,) = re.findall(rf"^{key} = *(.*)$", text, re.MULTILINE)
        return _upright(np.array([float(x) for x in found.split(",")]).reshape(-1, 3))

    measured = {}
    for name, key, scale in (
        ("T20", "T20", 1.0),
        ("EDT", "EDT", 1.0),
        ("C80", "C", 1.0),
        ("D50", "D", 0.01),
    ):
        frequency, value = np.loadtxt(folder / f"Evaluation_CR2_{name}.txt", delimiter=",")
        near = [np.abs(np.log2(frequency / f)) < 0.5 for f in OCTAVES]  # thirds of an octave
        measured[key] = scale * np.array([[value[n].mean() for n in near]])
    return Room(scene, places("sourcePositions"), places("receiverPositions"), measured, (), 19.5, 41.7)


def _hall(folder: Path) -> Room:
    import xlrd

    lines = (folder / "elmia.ply").read_text("latin-1").splitlines()
    count = {kind: int(n) for kind, n in re.findall(r"element (\w+) (\d+)", "\n".join(lines[:20]))}
    first = lines.index("end_header") + 1
    vertices = np.array([line.split()[:3] for line in lines[first : first + count["vertex"]]], float)
    first += count["vertex"]
    faces: list[list[int]] = []
    layer: list[int] = []
    for line in lines[first : first + count["face"]]:
        n, *rest = (int(x) for x in line.split())
        new = _triangles(vertices, rest[:n])
        faces += new
        layer += [rest[n]] * len(new)
    first += count["face"]
    names = [
        "".join(chr(int(c)) for c in line.split()[1:]) for line in lines[first : first + count["layer"]]
    ]
    text = (folder / "material_catt.txt").read_text()
    found = {
        name: ([float(x) for x in a.split()], [float(x) for x in s.split()] or [10.0] * 6)
        for name, a, s in re.findall(r"(\w+) = < ([\d ]+)>(?: L < ([\d ]+)>)?", text)
    }
    found["interiorwall"] = found["interiorwalls"]  # the mesh has it in the singular
    rows = [found[{"linol": "linoleum"}.get(n, n)] for n in names]
    table = ss.MaterialTable(
        tuple(names), OCTAVES, 0.01 * np.array([r[0] for r in rows]), 0.01 * np.array([r[1] for r in rows]),
        np.zeros((len(rows), 6)),
    )  # fmt: skip
    scene = ss.Scene(vertices, np.array(faces), np.array(layer), table, name="elmia")
    sheet = xlrd.open_workbook(folder / "elmia_coordinates.xls").sheet_by_name("source-receiver")
    places = {sheet.cell_value(r, 0): sheet.row_values(r, 1, 4) for r in range(sheet.nrows)}
    book = xlrd.open_workbook(folder / "Auswertung_Phase_II.xls")
    entries = [s.name for s in book.sheets() if re.fullmatch(r"\d+(DXF)?", s.name)]
    return Room(
        scene, np.array([places["S1"], places["S2"]]), np.array([places[f"R{i}"] for i in range(1, 7)]),
        _sheet(book.sheet_by_name("measured")), tuple(_sheet(book.sheet_by_name(n)) for n in entries),
        20.0, 50.0,
    )  # fmt: skip


def _sheet(sheet: object) -> dict[str, np.ndarray]:
    """What a sheet of the round robin says: (12 pairs, 6 octaves) per parameter, NaN where it says nothing."""
    out = {}
    for r in range(sheet.nrows):  # type: ignore[attr-defined]
        name = _PARAMETERS.get(str(sheet.cell_value(r, 0)))  # type: ignore[attr-defined]
        if name is not None:
            rows = [sheet.row_values(r + 1 + b, 1, 13) for b in range(6)]  # type: ignore[attr-defined]
            values = np.array([[x if isinstance(x, float) else np.nan for x in row] for row in rows]).T
            out[name] = 0.01 * values if name == "D" else values
    return out


def bands() -> tuple[float, ...]:
    """Edges of the octaves, Hz."""
    return tuple(np.append(OCTAVES / np.sqrt(2.0), OCTAVES[-1] * np.sqrt(2.0)))


def computed(room: Room, walks: int, seed: int = 0, **settings: Any) -> dict[str, np.ndarray]:
    """(pairs, octaves) per parameter, sources outermost; `settings`: of the engine."""
    config = ss.SimulationConfig(
        bands=bands(), walks=walks, connections=ss.ConnectionsConfig(subpaths=128),
        temperature_c=room.temperature_c, humidity_percent=room.humidity_percent, speed_of_sound=None,
        max_duration=5.0, **settings,
    )  # fmt: skip
    echoes = ss.simulate(room.scene, room.sources, room.receivers, config, seed)
    pairs = [(i, j) for i in range(len(room.sources)) for j in range(len(room.receivers))]
    found = [room_measures(echoes[i, j]) for i, j in pairs]
    return {
        name: np.array([getattr(m, key) for m in found])
        for name, key in (("T20", "t20"), ("T30", "t30"), ("EDT", "edt"), ("C", "c80"), ("D", "d50"))
    }


def differences(room: Room, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Absolute errors in JND, (pairs, octaves), pair by pair: where the mean over pairs alone is published, of
    each pair against that, so that what pairs truly differ by counts as error."""
    return pair_by_pair(values, room.measured)


def run(walks: str = "4000", seeds: str = "1") -> list[Table]:
    """Errors by octave, and those of other programs, of each room that is there."""
    if not available():
        raise UnavailableError(f"{ROOMS} has neither bras_cr2 nor elmia")
    heads = [
        "",
        "seed",
        *((f"{f:g} Hz", "JND") for f in OCTAVES),
        ("mean", "JND"),
        ("of the mean over pairs", "JND"),
    ]
    tables = []
    for name in available():
        room = load(name)
        rows: list[tuple[object, ...]] = []
        for seed in range(int(seeds)):
            values = computed(room, int(walks), seed)
            off, means = differences(room, values), of_means(values, room.measured)
            rows += [
                (key, seed, *np.nanmean(v, axis=0), np.nanmean(v), np.nanmean(means[key]))
                for key, v in off.items()
            ]
        for key in room.measured:
            rest = [float(np.nanmean(differences(room, o)[key])) for o in room.others if key in o]
            if rest:
                empty = [None] * len(OCTAVES)
                rows.append(
                    (f"{key}, median of {len(rest)} entries", "", *empty, float(np.median(rest)), None)
                )
                rows.append((f"{key}, best of them", "", *empty, min(rest), None))
        tables.append(
            table(f"{name}, {len(room.scene.faces):,} triangles, {int(walks):,} subpaths", heads, rows)
        )
    return tables
