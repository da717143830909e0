"""What is known of each building of a collection: a line of JSON in `homes.jsonl` when it is finished or has
failed.

OUT/<home>/            dataset
OUT/homes.jsonl, OUT/log.txt
OUT/splits.toml, OUT/episodes/replica/v1/<split>/
OUT/collection.json, README.md, datasheet.md, report.md, figures/
"""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np

from soundspaces_collections.rooms import RoomTimes, median_of, rooms_of
from soundspaces_sim import DatasetError, RirDataset, Scene
from soundspaces_sim.parts import read_floorplan, read_text, storeys_of

NAME = "homes.jsonl"
_MOST = 2**31  # bytes

#: Measures of which distributions are kept: lower and upper edge and width of a bin.
BINS = {"t30": (0.0, 6.0, 0.05), "c50": (-30.0, 50.0, 1.0), "drr": (-50.0, 30.0, 1.0)}
_FLOOR_LABELS = ("floor",)
_LEVEL = 0.9  # cosine of the steepest normal of a floor


class Distribution(msgspec.Struct, frozen=True, kw_only=True):
    """Of a measure over pairs, per band: `counts` (bands, bins) in `BINS`; medians of the value and of its standard
    error; pairs without a value are not counted."""

    counts: list[list[int]]
    median: list[float | None]
    error: list[float | None]


class Record(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Of one building. `processor_s`: of making its dataset, None if that was not seen (it was interrupted, or done
    elsewhere); `error`: why there is none. `area`: of its floors, m². `early_error`, `late_error`: medians of
    relative standard errors, per band."""

    scene: str
    error: str = ""
    processor_s: float | None = None
    wall_s: float | None = None
    points: int = 0
    bytes: int = 0
    area: float = 0.0
    storeys: int = 0
    largest: float = 0.0  # share of the points in the navigation graph's largest part
    early_error: list[float | None] = []
    late_error: list[float | None] = []
    rooms: list[RoomTimes] = []
    measures: dict[str, Distribution] = {}

    @property
    def described(self) -> bool:
        """Whether statistics are in it."""
        return bool(self.measures)


def read_records(out: Path) -> dict[str, Record]:
    """The last record of each building. A last line that was cut off is left out. Raises `DatasetError`."""
    path = out / NAME
    if not path.exists():
        return {}
    found: dict[str, Record] = {}
    lines = read_text(path, DatasetError, "record of a collection", _MOST).splitlines(keepends=True)
    for number, line in enumerate(lines, 1):
        if number == len(lines) and not line.endswith("\n"):
            break
        try:
            record = msgspec.json.decode(line, type=Record)
        except msgspec.MsgspecError as error:
            raise DatasetError(f"{path}, line {number}: {error}; delete that line") from error
        before = found.get(record.scene)
        if before is not None and record.processor_s is None and not record.error:
            times = {"processor_s": before.processor_s, "wall_s": before.wall_s}
            record = msgspec.structs.replace(record, **times)
        found[record.scene] = record
    return found


def add_record(out: Path, record: Record) -> None:
    """Append a record; one that was cut off before is ended first."""
    path = out / NAME
    try:
        cut = path.exists() and path.stat().st_size > 0 and path.read_bytes()[-1:] != b"\n"
        with open(path, "ab") as file:
            file.write(b"\n" * cut + json.dumps(msgspec.to_builtins(record)).encode() + b"\n")
    except OSError as error:
        raise DatasetError(f"{path}: cannot write this file ({error})") from error


def describe(ds: RirDataset, scene: Scene) -> Record:
    """Statistics of a finished dataset and the scene it was made of."""
    manifest, table = ds.manifest, ds.table()
    bands = range(len(manifest.config.simulation.bands) - 1)
    parts = np.array(manifest.components, np.int64)
    parts = parts[parts >= 0]
    size = sum(e.bytes for e in manifest.entries)
    return Record(
        scene=manifest.scene,
        points=len(manifest.points),
        bytes=size + (ds.path / "manifest.json").stat().st_size,
        area=round(floor_area(scene), 2),
        storeys=len(np.unique(storeys_of(read_floorplan(ds.path), ds.points))),
        largest=float(np.bincount(parts).max() / len(manifest.points)) if len(parts) else 0.0,
        early_error=[median_of(table[f"early_error_{b}"]) for b in bands],
        late_error=[median_of(table[f"late_error_{b}"]) for b in bands],
        rooms=rooms_of(ds),
        measures={
            name: Distribution(
                counts=[_counts(table[f"{name}_{b}"], name) for b in bands],
                median=[median_of(table[f"{name}_{b}"]) for b in bands],
                error=[median_of(table[f"{name}_error_{b}"]) for b in bands],
            )
            for name in BINS
        },
    )


def floor_area(scene: Scene) -> float:
    """m² of faces that are labelled as floors and look up."""
    a, b, c = np.moveaxis(scene.vertices[scene.faces].astype(float), 1, 0)
    normals = np.cross(b - a, c - a)
    twice = np.linalg.norm(normals, axis=1)
    # the last, which stands for faces without a label, is none
    floors = np.array([*(label.split("-")[0] in _FLOOR_LABELS for label in scene.labels), False])
    up = floors[scene.face_label] & (normals[:, 2] > _LEVEL * twice)
    return float(0.5 * twice[up].sum())


def edges_of(name: str) -> np.ndarray:
    """Edges of the bins of a measure."""
    low, high, width = BINS[name]
    return low + width * np.arange(round((high - low) / width) + 1)


def _counts(values: np.ndarray, name: str) -> list[int]:
    """Values beyond the last edges count in the outermost bins."""
    edges = edges_of(name)
    known = np.clip(values[np.isfinite(values)].astype(float), edges[0], np.nextafter(edges[-1], 0.0))
    return [int(n) for n in np.histogram(known, edges)[0]]
