"""The wheel works outside the checkout, with only itself and its dependencies."""

import email
import os
import subprocess
import sys
import venv
import zipfile
from collections.abc import Iterable
from importlib.metadata import distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from tests.marks import ci_slow

ROOT = Path(__file__).resolve().parents[1]

_USE = """
import soundspaces_sim as ss
assert "/clean/" in ss.__file__, ss.__file__
config = ss.JobConfig(grid=ss.GridConfig(spacing=4.0, rays=100),
                      simulation=ss.SimulationConfig(walks=16, connections={"subpaths": 8}, duration=0.1))
result = ss.build_dataset(ss.load_scene("demo"), "out", config)
ds = ss.open_dataset(result.folder)
print(ds.binaural(0, 1).shape)
"""


_READ = """
import sys
import soundspaces_sim as ss
from soundspaces_sim.core.io.resources import resource
from soundspaces_sim.rendering.hrtf import load_hrtf
assert "/clean/" in ss.__file__, ss.__file__
assert len(ss.load_scene("demo").faces) > 1000  # materials and labels are there
for preset in ("default", "paper", "patio"):
    ss.load_config(resource("pipelines", preset + ".toml"))
assert ss.verify_dataset(sys.argv[1], full=True)[1] == []
with ss.open_dataset(sys.argv[1]) as ds:
    print(ds.echogram(0, 1).energy.shape[1:], len(ds.table()), load_hrtf().ir.shape[1])
"""


def _run(*command: str | Path, cwd: Path) -> str:
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run([str(c) for c in command], cwd=cwd, capture_output=True, text=True, env=env)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    _run(sys.executable, "-m", "build", "--wheel", "--outdir", folder, ROOT, cwd=folder)
    (found,) = folder.glob("*.whl")
    return found


def _needed(texts: Iterable[str], extras: set[str], found: dict[str, set[str]]) -> None:
    """Add to `found` the distributions that requirements name, with their extras, and what these need in turn."""
    for requirement in map(Requirement, texts):
        if requirement.marker and not any(
            requirement.marker.evaluate({"extra": e}) for e in extras | {""}
        ):
            continue
        if requirement.extras | {""} <= found.get(requirement.name, set()):
            continue
        there = distribution(requirement.name)
        assert requirement.specifier.contains(there.version, prereleases=True), requirement
        found.setdefault(requirement.name, {""}).update(requirement.extras)
        _needed(there.requires or (), requirement.extras, found)


@ci_slow
def test_wheel_verifies_and_reads_what_a_checkout_has_built(
    wheel: Path, dataset_folder: Path, tmp_path: Path
) -> None:
    """In an environment that has the wheel and links to what it says it needs, and nothing else."""
    venv.create(tmp_path / "clean", with_pip=False)
    python = tmp_path / "clean" / "bin" / "python"
    _run(
        sys.executable,
        "-m",
        "pip",
        "--python",
        python,
        "install",
        "--quiet",
        "--no-deps",
        wheel,
        cwd=tmp_path,
    )
    (site,) = (tmp_path / "clean" / "lib").glob("python*/site-packages")
    with zipfile.ZipFile(wheel) as file:
        (name,) = (n for n in file.namelist() if n.endswith(".dist-info/METADATA"))
        texts = email.message_from_bytes(file.read(name)).get_all("Requires-Dist", [])
    found: dict[str, set[str]] = {}
    _needed(texts, set(), found)
    assert {"numba", "typer", "h5py"} <= found.keys() and "matplotlib" not in found
    for name in found:
        there = distribution(name)
        for top in {path.parts[0] for path in there.files or ()} - {"..", "__pycache__", "bin"}:
            if not (site / top).exists():
                (site / top).symlink_to(Path(str(there.locate_file(top))))
    assert _run(python, "-c", _READ, dataset_folder, cwd=tmp_path).startswith("(9, 4) 56 2")
    assert "rirs" in _run(tmp_path / "clean" / "bin" / "soundspaces-sim", "--help", cwd=tmp_path)


@pytest.mark.slow
def test_wheel_builds(wheel: Path, tmp_path: Path) -> None:
    """Installed by pip with what it needs; compiles every kernel anew, which takes minutes."""
    venv.create(tmp_path / "clean", with_pip=True)
    python = tmp_path / "clean" / "bin" / "python"
    _run(python, "-m", "pip", "install", "--quiet", wheel, cwd=tmp_path)
    assert _run(python, "-c", _USE, cwd=tmp_path).startswith("(2, ")
