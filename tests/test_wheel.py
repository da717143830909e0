"""The wheel works outside the checkout, with only itself and its dependencies."""

import os
import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

_USE = """
import soundspaces_sim as ss
assert "/clean/" in ss.__file__, ss.__file__
config = ss.JobConfig(grid=ss.GridConfig(spacing=4.0, rays=100),
                      simulation=ss.SimulationConfig(walks=16, joined_walks=8, duration=0.1))
result = ss.build_dataset(ss.load_scene("demo"), "out", config)
ds = ss.open_dataset(result.folder)
print(ds.binaural(0, 1).shape)
"""


_READ = """
import sys
import soundspaces_sim as ss
from soundspaces_sim.core.io.resources import resource
assert "/clean/" in ss.__file__, ss.__file__
assert len(ss.load_scene("demo").faces) > 1000  # materials and labels are there
for preset in ("default", "paper", "patio"):
    ss.load_config(resource("pipelines", preset + ".toml"))
assert ss.verify_dataset(sys.argv[1], full=True)[1] == []
with ss.open_dataset(sys.argv[1]) as ds:
    print(ds.binaural(0, 1).shape, len(ds.table()))
"""


def _run(*command: str | Path, cwd: Path) -> str:
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run([str(c) for c in command], cwd=cwd, capture_output=True, text=True, env=env)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an environment `clean` that has only the wheel and what it needs."""
    folder = tmp_path_factory.mktemp("wheel")
    _run(sys.executable, "-m", "build", "--wheel", "--outdir", folder / "dist", ROOT, cwd=folder)
    (wheel,) = (folder / "dist").glob("*.whl")
    venv.create(folder / "clean", with_pip=True)
    _run(folder / "clean" / "bin" / "python", "-m", "pip", "install", "--quiet", wheel, cwd=folder)
    return folder


def test_wheel_verifies_and_reads_what_a_checkout_has_built(clean: Path, dataset_folder: Path) -> None:
    python = clean / "clean" / "bin" / "python"
    assert _run(python, "-c", _READ, dataset_folder, cwd=clean).startswith("(2, ")
    help_text = _run(clean / "clean" / "bin" / "soundspaces-sim", "--help", cwd=clean)
    assert "rirs" in help_text


@pytest.mark.slow
def test_wheel_builds(clean: Path) -> None:
    """Compiles every kernel anew, which takes minutes."""
    assert _run(clean / "clean" / "bin" / "python", "-c", _USE, cwd=clean).startswith("(2, ")
