"""Reading is light: opening a dataset imports neither the tracer nor the renderer."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

_READ = """
import json, sys
import soundspaces_sim as ss
after_import = sorted(sys.modules)
with ss.open_dataset(sys.argv[1]) as ds:
    bins = len(ds.echogram(0, 1).energy)
    after_echogram = sorted(sys.modules)
    rows = len(ds.table())
    ds.sample(3, 0, distance=(0.0, 100.0)), ds.nearest(ds.points[0])
    after_table = sorted(sys.modules)
    ds.binaural(0, 1)
print(json.dumps([bins, rows, after_import, after_echogram, after_table, sorted(sys.modules)]))
"""
_HEAVY = ("numba", "llvmlite", "embreex", "scipy", "networkx", "trimesh", "soundfile", "matplotlib")
_NAMES_ALONE = [
    "soundspaces_sim.rendering",
    "soundspaces_sim.rendering.renderers",
]  # which load no renderer
_ROOMS = ("transport", "scene", "build", "rendering")


def _loaded(modules: list[str], names: tuple[str, ...]) -> list[str]:
    return [m for m in modules if m.startswith(tuple(n + "." for n in names)) or m in names]


_WORK = """
import json, sys
import soundspaces_sim as ss
ss.simulate, ss.build_dataset, ss.open_dataset, ss.binaural_rir
print(json.dumps(sorted(sys.modules)))
"""


def test_what_starts_a_job_leaves_out() -> None:
    """Parts of SciPy that few calls need cost half a second: `import scipy` loads them on first use."""
    done = subprocess.run(
        [sys.executable, "-c", _WORK], cwd=ROOT, capture_output=True, text=True, check=True
    )
    parts = ("signal", "optimize", "interpolate", "stats", "ndimage")
    assert _loaded(json.loads(done.stdout), ("matplotlib", *(f"scipy.{part}" for part in parts))) == []


def test_what_opening_a_dataset_loads(dataset_folder: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _READ, str(dataset_folder)], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    bins, rows, imported, echogram, table, sound = json.loads(done.stdout)
    assert bins > 10 and rows > 10
    assert _loaded(imported, (*_HEAVY, "numpy", "h5py")) == []
    rooms = tuple(f"soundspaces_sim.{room}" for room in _ROOMS)
    for modules in (echogram, table):
        assert "h5py" in modules and "soundspaces_sim.dataset.reader" in modules
        assert _loaded(modules, (*_HEAVY, *rooms)) == _NAMES_ALONE
    assert "numba" in sound and "soundspaces_sim.rendering.ambisonics" in sound
    assert _loaded(sound, ("embreex", *rooms[:3])) == []  # sound needs no tracer either
