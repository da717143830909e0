"""Clients that need habitat-lab, run from their own checkouts, unchanged, by the scripts of `own_code/`.

They are cloned at the commits below, or taken from a folder that has them by these names. What cannot be had is left
out with a line that says why.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import venv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from neighbours.rlr_audio_propagation.tests.clients.data import write_tree
from pipelines import torch_cpu

FOLDER = Path(__file__).resolve().parent / "own_code"


@dataclass(frozen=True)
class Source:
    """A repository at a commit, and the folder in it that goes on the path."""

    repository: str
    commit: str
    path: str = "."


SOURCES: Mapping[str, Source] = {
    "habitat-lab-0.3.4": Source(
        "https://github.com/facebookresearch/habitat-lab", "cdbb4880519505adf45fba0f0c0c3a3fd18a2a55", "habitat-lab"
    ),
    "habitat-lab-0.2.2": Source(
        "https://github.com/facebookresearch/habitat-lab", "0f454f62e41050bc90ca468c62db35d7484923ff"
    ),
    "sound-spaces": Source(
        "https://github.com/facebookresearch/sound-spaces", "287184fd7067a0385558492716355c54875500ee"
    ),
    "SAVN-CE": Source("https://github.com/yichenzeng24/SAVN-CE", "9c7a1a3b1eae95fa027ad5e3b73914595b5b44c9"),
}  # fmt: skip
#: Scripts, and the sources whose folders each wants on its path.
CLIENTS: Mapping[str, tuple[str, ...]] = {
    "habitat_lab": ("habitat-lab-0.3.4",),
    "savnce_simulator": ("SAVN-CE",),
    "soundspaces_simulator": ("sound-spaces", "habitat-lab-0.2.2"),
}
#: What the four import. OpenCV 5 returns contours in a shape that habitat-lab 0.2.2 does not take; gym 0.23 is made by
#: setuptools of its day.
_FIRST = ("setuptools<66", "wheel")
_GYM = ("--no-build-isolation", "gym==0.23.0")
_REST = (
    "attrs", "gitpython", "hydra-core", "ifcfg", "imageio", "imageio-ffmpeg", "librosa", "matplotlib", "moviepy==1.0.3",
    "numpy-quaternion", "omegaconf", "opencv-python-headless==4.10.0.84", "pillow", "psutil", "scikit-image",
    "tensorboard", "torchsummary", "tqdm", "yacs",
)  # fmt: skip
#: The networks of two checkouts are subclasses of torchvision's, of which there is no CPU build beside PyTorch's; no
#: network is made.
_TORCHVISION = "class BasicBlock: ...\nclass Bottleneck: ...\nconv1x1 = conv3x3 = None\n"


class MissingError(Exception):
    """What a client needs cannot be had here, and why."""


def run_checkouts(folder: Path, wheels: list[Path], index: str, given: Path | None) -> int:
    """Run the scripts in `folder` with these wheels of ours; how many failed. `given`: a folder with the sources."""
    clean = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | {"GIT_TERMINAL_PROMPT": "0"}
    failed, python = 0, None
    for script, sources in CLIENTS.items():
        names = ", ".join(f"{name} {SOURCES[name].commit[:10]}" for name in sources)
        try:
            path = [str(_source(name, folder, given, clean) / SOURCES[name].path) for name in sources]
            python = python or _environment(folder / "checkouts_environment", wheels, index, clean)
        except MissingError as why:
            print(f"left out  {script}: {names}: {why}", flush=True)
            continue
        place = folder / "checkouts" / script
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
        write_tree(place)
        path.append(str(_stand_in(python, folder, clean)))
        command = [str(python), "-m", "soundspaces_rlr", str(FOLDER / f"{script}.py")]
        done = subprocess.run(
            command, cwd=place, env={**clean, "PYTHONPATH": os.pathsep.join(path)}, capture_output=True, text=True
        )  # fmt: skip
        failed += done.returncode != 0
        print(f"{'FAILED' if done.returncode else 'passed'}  {script}: {names}, unchanged", flush=True)
        if done.returncode:
            print(done.stderr[-3000:])
    return failed


def _source(name: str, folder: Path, given: Path | None, env: Mapping[str, str]) -> Path:
    """Where a source lies. Raises `MissingError`."""
    source = SOURCES[name]
    if given is not None:
        if not (given / name / source.path).is_dir():
            raise MissingError(f"{given / name} is no folder")
        return given / name
    place = folder / "sources" / name
    if not (place / ".git" / "whole").is_file():
        shutil.rmtree(place, ignore_errors=True)  # what a clone that broke off left
        place.mkdir(parents=True)
        for command in (
            ["init", "--quiet"],
            ["fetch", "--quiet", "--depth", "1", source.repository, source.commit],
            ["checkout", "--quiet", "FETCH_HEAD"],
        ):
            if subprocess.run(["git", *command], cwd=place, env=env, capture_output=True).returncode:
                raise MissingError(
                    f"cannot clone {source.repository}; SOURCES=folder takes one with {name} in it"
                )
        (place / ".git" / "whole").touch()
    return place


def _environment(folder: Path, wheels: list[Path], index: str, env: Mapping[str, str]) -> Path:
    """The Python of an environment with what the clients import. Raises `MissingError`."""
    python = folder / "bin" / "python"
    if not python.exists():
        venv.create(folder, with_pip=True)
    try:
        torch = torch_cpu.arguments(str(python), index)
    except LookupError as why:
        raise MissingError(str(why)) from why
    ours = [str(wheel) for wheel in wheels]
    for options in (_FIRST, ours, ("--force-reinstall", "--no-deps", *ours), _GYM, _REST, torch):
        done = subprocess.run(
            [str(python), "-m", "pip", "install", "--quiet", *options], env=env, capture_output=True, text=True
        )  # fmt: skip
        if done.returncode:
            raise MissingError(
                f"pip cannot install {' '.join(options)}: {done.stderr.strip().splitlines()[-1]}"
            )
    return python


def _stand_in(python: Path, folder: Path, env: Mapping[str, str]) -> Path:
    """A folder for the end of the path, with an empty torchvision where there is none."""
    place = folder / "stand_in"
    place.mkdir(parents=True, exist_ok=True)
    if subprocess.run(
        [str(python), "-c", "import torchvision"], env=env, capture_output=True
    ).returncode:
        models = place / "torchvision" / "models"
        models.mkdir(parents=True, exist_ok=True)
        for file, text in (
            (models.parent / "__init__.py", ""),
            (models / "__init__.py", "ResNet18_Weights = None\n"),
            (models / "resnet.py", _TORCHVISION),
        ):
            file.write_text(text, encoding="utf-8")
        print("torchvision is not installed: empty modules are in its place", file=sys.stderr)
    return place
