"""The scripts of `scripts`: whose calls each makes, and whether that client's own has been run here."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from neighbours.rlr_audio_propagation.tests.clients.data import (
    write_tree,
)

FOLDER = Path(__file__).resolve().parent / "scripts"


@dataclass(frozen=True)
class Client:
    """`origin`: repository and file whose calls the script makes. `genuine`: how that file itself was run on this
    engine, or "" if it was not."""

    origin: str
    genuine: str = ""


_AS_IS = "as it is"
CLIENTS: Mapping[str, Client] = {
    "tutorial": Client(
        "facebookresearch/sound-spaces, examples/soundspaces2_quick_tutorial.ipynb",
        "its cells as a script, both data sets; `waveshow(…, 48000)` given as `sr=48000` for today's librosa",
    ),
    "minimal_example": Client("facebookresearch/sound-spaces, examples/minimal_example.py", _AS_IS),
    "panoramas": Client("facebookresearch/sound-spaces, PanoIR/render_panoIR.py", _AS_IS),
    "continuous_simulator": Client(
        "facebookresearch/sound-spaces, soundspaces/continuous_simulator.py"
    ),  # itself run from its checkout: `checkouts.py`
    "moving_speakers": Client(
        "JusperLee/SonicSim, SonicSim_rir.py",
        "its functions called; empty modules for torchaudio, OpenCV and habitat-lab, which they import only",
    ),
    "novel_views": Client(
        "apple/ml-nvas3d, soundspaces_nvas3d/utils/ss_utils.py",
        "`render_ir` called; empty modules for torchaudio and habitat-lab, which it imports only",
    ),
    "audio_agent": Client("facebookresearch/habitat-sim, examples/tutorials/audio_agent.py", _AS_IS),
    "navigation": Client(
        "facebookresearch/habitat-sim, examples/tutorials/nb_python/ECCV_2020_Navigation.py"
    ),
    "measured_room": Client("studies that compare with a measured room"),
    "probe": Client("checks of a build before a large run"),
    "foa_directions": Client("beasteers/rlr-audio-propagation, tests/test_foa.py"),
    "source_grid": Client("beasteers/rlr-audio-propagation, scripts/run_grid.py"),
    "capsules": Client("makers of sets for localisation, with a repaired mesh of Gibson"),
}


def run_script(python: Sequence[str], name: str, folder: Path, settings: Mapping[str, str]) -> str:
    """What a script said when it failed in `folder`, where `write_tree` has been; "" if it passed."""
    command = [*python, "-m", "soundspaces_rlr", str(FOLDER / f"{name}.py")]
    done = subprocess.run(
        command, cwd=folder, env={**os.environ, **settings}, capture_output=True, text=True
    )
    return "" if done.returncode == 0 else f"exit code {done.returncode}\n{done.stderr[-3000:]}"


def run_scripts(python: Sequence[str], folder: Path, settings: Mapping[str, str]) -> int:
    """Run all of them and print how each ended; how many failed."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    write_tree(folder)
    failed = 0
    for name, client in CLIENTS.items():
        said = run_script(python, name, folder, settings)
        print(f"{'FAILED' if said else 'passed'}  {name}: calls of {client.origin}", flush=True)
        if said:
            print(said)
        failed += bool(said)
    return failed
