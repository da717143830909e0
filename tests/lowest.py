"""`make test-lowest`: the lowest versions that pyproject.toml allows build a small dataset, and read one of the newest.

    python -m tests.lowest [--environment .venv-lowest]

The lowest versions are those of every dependency, the extras of the tests included, in an environment of their own
with kernels of their own; the newest are those of the environment that runs this. Both build, each verifies and reads
what both built, and the numbers are the same.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import tomllib
import venv
from pathlib import Path
from typing import Any

import numpy as np
from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[1]
_NEIGHBOURS = ("buildings", "exports", "rooms", "parameters", "renderers", "pictures")
_NAME = "soundspaces-sim"
_VERSIONS = """
import json, sys
from importlib.metadata import version
print(json.dumps({name: version(name) for name in sys.argv[1:]}))
"""
_READ = """
import json, sys
import h5py, numpy as np
import soundspaces_sim as ss
found = {}
with ss.open_dataset(sys.argv[1] + "/set/demo", rate=16000) as ds:
    for name in ("t30", "c50"):
        found[name] = ds.parameters(name, pairs=[(0, 1)])[name].ravel().tolist()
    found["rendered"] = ds.binaural(0, 1).ravel().tolist()
with ss.open_dataset(sys.argv[1] + "/set/demo") as ds:
    found["stored"] = ds.binaural(0, 1).ravel().tolist()
with h5py.File(sys.argv[1] + "/rooms/rooms-000000.h5") as file:
    for name in file:
        found[name] = file[name][...].ravel().tolist() + [len(file[name].attrs["labels"])]
print(json.dumps(found))
"""
_BUILD = (
    "soundspaces_sim.cli rirs demo --spacing 4 --walks 16 --store both --out set",
    "soundspaces_rooms --count 2 --format hdf5 --walks 16 --out rooms",
    "soundspaces_sim.cli table set/demo --out pairs.parquet",
    "soundspaces_parameters set/demo --out octaves.xlsx",
    "soundspaces_sim.cli export wav set/demo --out wav",
    "soundspaces_sim.cli export sofa set/demo --out sofa",
    "soundspaces_pictures plot set/demo --out map.png",
    "soundspaces_pictures report set/demo",
)


def floors(project: dict[str, Any], *extras: str) -> dict[str, str]:
    """The lowest version of each package that the project and these extras need here, by name."""
    found: dict[str, str] = {}
    optional = project["optional-dependencies"]
    wanted = [
        Requirement(r) for r in [*project["dependencies"], *(r for e in extras for r in optional[e])]
    ]
    for requirement in wanted:
        if requirement.marker is not None and not requirement.marker.evaluate():
            continue
        if requirement.name == _NAME:
            found |= floors({**project, "dependencies": []}, *requirement.extras)
        else:
            (found[requirement.name],) = (s.version for s in requirement.specifier if s.operator == ">=")
    return found


def _run(python: Path, *arguments: str, cwd: Path) -> str:
    """What Python prints. Raises `SystemExit` with its words if it fails."""
    sources = (ROOT, *(ROOT / "neighbours" / name / "src" for name in _NEIGHBOURS))
    own = {"PYTHONPATH": os.pathsep.join(map(str, sources)), "PYTHONSAFEPATH": "1"}
    if python != Path(sys.executable):  # versions of Numba would write over each other's kernels
        own["NUMBA_CACHE_DIR"] = str(python.parents[1] / "kernels")
    done = subprocess.run(
        [str(python), *arguments], cwd=cwd, env={**os.environ, **own}, capture_output=True, text=True
    )
    if done.returncode:
        raise SystemExit(f"{python} {' '.join(arguments)[:200]}\n{done.stdout}{done.stderr}")
    return done.stdout


def install(folder: Path) -> Path:
    """Python of an environment with the lowest versions. Raises `SystemExit` where pip took others."""
    python = folder / "bin" / "python"
    if not python.exists():
        venv.create(folder, with_pip=True)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    lowest = floors(project, "test")
    constraints = folder / "constraints.txt"
    constraints.write_text("".join(f"{name}=={version}\n" for name, version in lowest.items()))
    pip = "-m pip install --quiet --disable-pip-version-check --no-compile --only-binary :all:"
    _run(python, *pip.split(), "-c", str(constraints), *lowest, cwd=folder)
    found = json.loads(_run(python, "-c", _VERSIONS, *lowest, cwd=folder))
    for name, version in lowest.items():
        if Version(found[name]) != Version(version):
            raise SystemExit(f"{name}: pyproject.toml allows {version}, pip took {found[name]}")
    return python


def differences(one: dict[str, list[float]], other: dict[str, list[float]]) -> list[str]:
    """Names of what two readings of the same files have different, by more than a float's rounding."""
    return [
        name
        for name in one.keys() | other.keys()
        if len(one.get(name, [])) != len(other.get(name, []))
        or not np.allclose(one[name], other[name], 1e-4, 1e-7, equal_nan=True)
    ]


def main() -> int:
    """Build and read with both; 1 where a reading differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--environment", type=Path, default=ROOT / ".venv-lowest")
    pythons = {
        "lowest": install(parser.parse_args().environment.resolve()),
        "newest": Path(sys.executable),
    }
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        for writer, python in pythons.items():
            place = Path(folder) / writer
            place.mkdir()
            for line in _BUILD:
                _run(python, "-m", *line.split(), cwd=place)
            readings = []
            for reader in pythons.values():
                _run(reader, "-m", "soundspaces_sim.cli", "verify", "--full", "set/demo", cwd=place)
                readings.append(json.loads(_run(reader, "-c", _READ, ".", cwd=place)))
            wrong = differences(*readings)
            failed += len(wrong)
            print(f"built by the {writer}: {', '.join(wrong) or 'nothing'} read differently", flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
