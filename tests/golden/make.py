"""A golden dataset: what the version at hand writes, tiny, and what it reads of it, for every later one to read.

    PYTHONPATH=. python tests/golden/make.py echogram-2

writes tests/golden/echogram-2 and echogram-2.json. Made once per version of a format, before that changes; those
that are there are never made again.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import soundspaces_sim as ss
from soundspaces_sim.core.config import DatasetConfig

HERE = Path(__file__).resolve().parent
HEADINGS = (0.0, 90.0)


def values(folder: Path) -> dict[str, Any]:
    """What a reader finds in a golden dataset, as JSON has it."""
    with ss.open_dataset(folder) as ds:
        echogram = ds.echogram(0, 1)
        assert echogram.direct is not None
        table = ds.table()
        ambisonic = ds.ambisonic(0, 1)
        ears = [ds.binaural(0, 1, heading) for heading in HEADINGS]
        row = table[(table["source"] == 0) & (table["listener"] == 1)][0]
        return {
            "points": ds.points.tolist(),
            "rate": ds.rate,
            "nodes": [int(n) for n in ds.manifest.nodes],
            "histogram": echogram.histogram().astype(float).T.tolist(),
            "direct": np.asarray(echogram.direct.energy, float).tolist(),
            "delays": np.asarray(echogram.early.delay, float).tolist(),
            "planes": np.asarray(echogram.early.planes, int).tolist(),
            "relative_error": np.asarray(echogram.relative_error, float).tolist(),
            "t30": [float(row[f"t30_{b}"]) for b in range(4)],
            "c50": [float(row[f"c50_{b}"]) for b in range(4)],
            "distance": float(row["distance"]),
            "geodesic": float(row["geodesic"]),
            "ambisonic": (ambisonic.astype(float) ** 2).sum(axis=1).tolist(),
            "ears": [(ear.astype(float) ** 2).sum(axis=1).tolist() for ear in ears],
        }


def main(name: str) -> None:
    """Make `name` and `name`.json, of a room with three points."""
    folder = HERE / name
    if folder.exists():
        sys.exit(f"{folder} is there already; golden datasets are made once")
    job = ss.JobConfig(
        grid=ss.GridConfig(spacing=2.0, rays=200),
        simulation=ss.SimulationConfig(
            walks=64,
            connections=ss.ConnectionsConfig(subpaths=16),
            duration=0.2,
            materials={"enabled": True},  # type: ignore[arg-type]
        ),
        dataset=DatasetConfig(store="both", rate=8000, tile=8, headings=HEADINGS, sample_format="int16"),
    )
    with tempfile.TemporaryDirectory() as temporary:
        made = ss.build_dataset(ss.shoebox((6.0, 2.0, 2.5), 0.4, 0.5, name="golden"), temporary, job)
        for path in [p for p in made.folder.iterdir() if p.suffix not in (".json", ".h5", ".hdf5")]:
            path.unlink()  # cards
        made.folder.rename(folder)
    (HERE / f"{name}.json").write_text(json.dumps(values(folder)) + "\n")
    size = sum(p.stat().st_size for p in folder.iterdir())
    print(
        f"{folder}: {size / 1e3:.0f} kB, {len(json.loads((HERE / f'{name}.json').read_text()))} values"
    )


if __name__ == "__main__":
    main(sys.argv[1])
