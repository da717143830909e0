"""The wheel works outside the checkout, with only itself and its dependencies."""

import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

_USE = """
import soundspaces_sim as ss
assert "site-packages" in ss.__file__ or "clean" in ss.__file__, ss.__file__
config = ss.JobConfig(grid=ss.GridConfig(spacing=4.0, rays=100),
                      simulation=ss.SimulationConfig(walks=16, joined_walks=8, duration=0.1))
result = ss.build_dataset(ss.load_scene("demo"), "out", config)
ds = ss.open_dataset(result.folder)
print(ds.binaural(0, 1).shape)
"""


_READ = """
import sys
import soundspaces_sim as ss
assert ss.verify_dataset(sys.argv[1], full=True)[1] == []
with ss.open_dataset(sys.argv[1]) as ds:
    print(ds.binaural(0, 1).shape, len(ds.table()))
"""


def _run(*command: str | Path, cwd: Path) -> str:
    done = subprocess.run([str(c) for c in command], cwd=cwd, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_wheel_in_a_clean_environment(tmp_path: Path, dataset_folder: Path) -> None:
    """It builds, and it verifies and reads what a checkout has built."""
    _run(sys.executable, "-m", "build", "--wheel", "--outdir", tmp_path / "dist", ROOT, cwd=tmp_path)
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    venv.create(tmp_path / "clean", with_pip=True)
    python = tmp_path / "clean" / "bin" / "python"
    _run(python, "-m", "pip", "install", "--quiet", wheel, cwd=tmp_path)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    assert _run(python, "-c", _USE, cwd=elsewhere).startswith("(2, ")
    assert _run(python, "-c", _READ, dataset_folder, cwd=elsewhere).startswith("(2, ")
    help_text = _run(tmp_path / "clean" / "bin" / "soundspaces-sim", "--help", cwd=elsewhere)
    assert "rirs" in help_text
