"""`make test-clients`: scripts with clients' calls, clients from their own checkouts (`checkouts.py`), and
AudibleLight's own tests, in environments of their own.

The release on PyPI has no tests: they come from its repository at the same tag, cloned, or from `--checkout`. The
tests that never reach the simulator, or need files that its authors download, are left out, each with a reason.
Where its packages, the CPU build of PyTorch or the repository cannot be had, one line says so, and the scripts
alone are run.
"""

from __future__ import annotations

import argparse
import functools
import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from neighbours.rlr_audio_propagation.tests.clients.checkouts import run_checkouts
from neighbours.rlr_audio_propagation.tests.clients.stand_in import (
    write_apartment,
    write_noise,
)
from neighbours.rlr_audio_propagation.tests.clients.table import (
    run_scripts,
)
from pipelines import torch_cpu

RELEASE = "0.1.2"
REPOSITORY = "https://github.com/AudibleLight/AudibleLight"
ROOT = Path(__file__).resolve().parents[4]
FILES = (
    "test_worldstate_rlr.py", "test_with_algorithms.py", "test_synthesize.py", "test_core.py", "test_event.py",
    "test_dcase_metadata.py", "test_micarrays.py",
)  # fmt: skip
NEEDS = (
    "pytest", "pytest-rerunfailures", "opencv-python-headless", "astropy", "pyunlocbox", "scikit-image",
)  # fmt: skip
_DOWNLOADED = "reads measured responses from a file that its fixture downloads; no simulator"
_CHANCE = "draws a number and wants it within the central 95 % of its distribution; no simulator"
#: Part of a test's name, and why tests that have it are left out.
LEFT_OUT = {
    "sofa": _DOWNLOADED,
    "scene_from_dict[input_dict1]": _DOWNLOADED,
    "validate_scene_for_video": _DOWNLOADED,
    "video_generation": "draws pictures with VTK; no simulator",
    "initialise_plotter": "draws pictures with VTK; no simulator",
    "event_overrides[overrides0]": _CHANCE,
    "event_overrides[overrides2]": _CHANCE,
    "music[microphone3": "expects 180 degrees and takes -180, the same direction, for another",
}


def _run(*command: str | Path, **options: Any) -> subprocess.CompletedProcess[str]:
    clean = {
        key: value for key, value in os.environ.items() if key != "PYTHONPATH"
    }  # the wheels are what is tested
    clean["GIT_TERMINAL_PROMPT"] = "0"  # a repository that is not there asks for no name
    return subprocess.run([str(c) for c in command], text=True, env=clean, **options)


class SkippedError(Exception):
    """AudibleLight's part cannot run here, and why."""


def _wheels() -> list[Path]:
    """Both of our wheels."""
    ours = [
        *(ROOT / "dist").glob("soundspaces_sim-*.whl"),
        *(ROOT / "dist").glob("rlr_audio_propagation-*.whl"),
    ]
    if len(ours) != 2:
        sys.exit(
            f"{ROOT / 'dist'}: expected one wheel of each distribution, got {len(ours)}; run make wheels"
        )
    return ours


def _environment(folder: Path, ours: list[Path]) -> Path:
    """The Python of an environment with them."""
    python = folder / "bin" / "python"
    if not python.exists():
        venv.create(folder, with_pip=True)
    for options in (
        [],
        ["--force-reinstall", "--no-deps"],
    ):  # dependencies; then our wheels as they are now
        _run(python, "-m", "pip", "install", "--quiet", *options, *ours, check=True)
    return python


def _add_audible_light(python: Path, index: str) -> None:
    """Install the release and what its tests need. Raises `SkippedError` where that cannot be had."""
    try:
        torch = torch_cpu.arguments(str(python), index)
    except LookupError as why:
        raise SkippedError(str(why)) from why
    what = [*torch, f"audiblelight=={RELEASE}", *NEEDS]
    done = _run(python, "-m", "pip", "install", "--quiet", *what, capture_output=True)
    if done.returncode:
        raise SkippedError(f"pip cannot install it: {done.stderr.strip().splitlines()[-1]}")
    check = "from importlib.metadata import version as v; print(v('rlr_audio_propagation'), v('audiblelight'))"
    said = _run(python, "-c", check, check=True, capture_output=True).stdout.strip()
    print("installed:", said, flush=True)


def _checkout(given: Path | None, folder: Path) -> Path:
    if given is not None:
        if not (given / "tests" / FILES[0]).is_file():
            sys.exit(f"{given}: expected a checkout of {REPOSITORY} at {RELEASE}, with tests/{FILES[0]}")
        return given
    if not (folder / "tests").is_dir():
        shutil.rmtree(folder, ignore_errors=True)  # what a clone that broke off left
        how = ("--quiet", "--depth", "1", "--branch", RELEASE)
        if _run("git", "clone", *how, REPOSITORY, folder, capture_output=True).returncode:
            raise SkippedError(
                f"cannot clone {REPOSITORY}; make test-clients CHECKOUT=path takes a checkout of its tag {RELEASE}"
            )
    return folder


def _place(checkout: Path, packages: Path) -> list[str]:
    """Copy the tests beside the installed package, where they look for their files; what stands in for what."""
    tests, notes = packages / "tests", []
    shutil.rmtree(tests, ignore_errors=True)
    shutil.copytree(checkout / "tests", tests)
    resources = tests / "test_resources"
    for path, write in (
        (resources / "meshes" / "Oyens.glb", write_apartment),
        (resources / "spatialsoundevents" / "voice_whitenoise_foa.wav", write_noise),
    ):
        if not path.is_file():
            write(path)
            notes.append(
                f"{path.name} is not in the checkout: one made up by stand_in.py is in its place"
            )
    (resources / "metu_foa.sofa").touch()  # or the first fixture downloads it
    return notes


def _report(results: Path, out: dict[str, str], notes: list[str]) -> None:
    """Print each test that ran and how it ended, each that was left out and why."""
    ends: dict[str, list[str]] = {"passed": [], "failed": [], "error": [], "skipped": []}
    for case in ElementTree.parse(results).iter("testcase"):
        kinds = [child.tag for child in case if child.tag in ("failure", "error", "skipped")]
        end = {"failure": "failed"}.get(kinds[0], kinds[0]) if kinds else "passed"
        ends[end].append(f"{case.get('classname', '').rpartition('.')[2]}::{case.get('name')}")
    for end, names in ends.items():
        print(f"{end}: {len(names)}")
        print("".join(f"  {name}\n" for name in sorted(set(names))), end="")
    print(f"left out: {len(out)}")
    print("".join(f"  {name}: {why}\n" for name, why in out.items()), end="")
    print("\n".join(notes))


def _audible_light(python: Path, folder: Path, options: argparse.Namespace) -> int:
    """Run AudibleLight's tests; pytest's exit code. Raises `SkippedError` where they cannot be had."""
    checkout = _checkout(options.checkout, folder / "AudibleLight")
    _add_audible_light(python, options.torch_index)
    where = "import sysconfig; print(sysconfig.get_path('purelib'))"
    packages = Path(_run(python, "-c", where, check=True, capture_output=True).stdout.strip())
    notes = _place(checkout, packages)
    settings, results = folder / "pytest.ini", folder / "results.xml"
    settings.write_text("[pytest]\n")  # or pytest finds ours
    own = ("-c", settings, "--rootdir", packages, "-p", "no:cacheprovider", "-q", "--disable-warnings")
    pytest = functools.partial(_run, python, "-m", "pytest", *own, cwd=packages)
    files = [f"tests/{name}" for name in FILES]
    listed = pytest("--collect-only", *files, capture_output=True)
    names = [line for line in listed.stdout.splitlines() if "::" in line]
    if not names:
        sys.exit(f"no tests were found:\n{listed.stdout}{listed.stderr}")
    out = {
        n: why for n in names for part, why in LEFT_OUT.items() if part in n.partition("::")[2].lower()
    }
    keep = [name for name in names if name not in out]
    wanted = ["-k", options.select] if options.select else []
    done = pytest("--junitxml", results, *wanted, *keep)
    _report(results, out, notes)
    return done.returncode


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--checkout", type=Path)
    parser.add_argument("--select", default="", help="a pytest -k expression, for a few of the tests")
    parser.add_argument("--only-scripts", action="store_true", help="without other checkouts")
    parser.add_argument("--sources", type=Path, help="a folder with the sources of checkouts.py")
    parser.add_argument("--torch-index", default=torch_cpu.INDEX)
    options = parser.parse_args()
    folder = ROOT / "build" / "clients"
    wheels = _wheels()
    python = _environment(folder / "environment", wheels)
    failed = run_scripts([str(python)], folder / "scripts", {"PYTHONPATH": ""})
    code = 0
    if not options.only_scripts:
        failed += run_checkouts(folder, wheels, options.torch_index, options.sources)
        try:
            code = _audible_light(python, folder, options)
        except SkippedError as why:
            print(f"AudibleLight's tests are left out: {why}")
    return code or min(failed, 1)


if __name__ == "__main__":
    sys.exit(main())
