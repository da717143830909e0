"""`make wheels`: installs each distribution of dist/ into an empty environment, and uses it there.

    python -m tests.use_wheels dist

The wheel and the sdist of soundspaces_sim: the command answers, the demo scene is read with its materials,
presets and schemas are there. With `--simulate` a small dataset is built and read too, which compiles every
kernel: minutes.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

_READ = """
import sys
import soundspaces_sim as ss
from soundspaces_sim.core.io.resources import resource
from soundspaces_sim.dataset.format.schema import schema
from soundspaces_sim.rendering.hrtf import load_hrtf
assert sys.prefix in ss.__file__, ss.__file__
scene = ss.load_scene("demo")
for preset in ("default", "paper", "patio"):
    ss.load_config(resource("pipelines", preset + ".toml"))
assert schema("echogram") and load_hrtf().ir.shape[1] == 2
print(ss.__version__, len(scene.faces), "faces")
"""
_SIMULATE = """
import soundspaces_sim as ss
config = ss.JobConfig(grid=ss.GridConfig(spacing=4.0, rays=100), simulation=ss.SimulationConfig(walks=16, duration=0.1))
with ss.open_dataset(ss.build_dataset(ss.load_scene("demo"), "out", config).folder) as ds:
    print(ds.binaural(0, 1).shape, ds.table().shape)
"""


def use(distribution: Path, simulate: bool = False) -> str:
    """What the distribution prints in an environment of its own. Raises `SystemExit` with its words if it
    fails."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        venv.create(place / "env", with_pip=True)
        bin_ = place / "env" / ("Scripts" if os.name == "nt" else "bin")
        python = bin_ / "python"
        said = _run(
            python,
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
            distribution,
            cwd=place,
        )
        said += _run(python, "-c", _READ, cwd=place)
        assert "rirs" in _run(bin_ / "soundspaces-sim", "--help", cwd=place)
        return said + (_run(python, "-c", _SIMULATE, cwd=place) if simulate else "")


def _run(*command: str | Path, cwd: Path) -> str:
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run([str(c) for c in command], cwd=cwd, capture_output=True, text=True, env=env)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(map(str, command))[:200]}\n{done.stdout}{done.stderr}")
    return done.stdout


def main(arguments: list[str]) -> None:
    folder = Path(arguments[0]).resolve()
    found = sorted([*folder.glob("soundspaces_sim-*.whl"), *folder.glob("soundspaces_sim-*.tar.gz")])
    if len(found) != 2:
        raise SystemExit(
            f"{folder}: expected a wheel and an sdist of soundspaces_sim, got {[f.name for f in found]}"
        )
    for distribution in found:
        print(distribution.name, use(distribution, "--simulate" in arguments).strip(), sep=": ")


if __name__ == "__main__":
    main(sys.argv[1:])
