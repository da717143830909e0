"""`make test-clients`: scripts with clients' calls, and AudibleLight's own tests, in an environment of their own.

The release on PyPI has no tests: they come from its repository at the same tag, cloned, or from `--checkout`. The
tests that never reach the simulator, or need files that its authors download, are left out, each with a reason.
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

from tests.clients.stand_in import write_apartment, write_noise
from tests.clients.table import run_scripts

RELEASE = "0.1.2"
REPOSITORY = "https://github.com/AudibleLight/AudibleLight"
ROOT = Path(__file__).resolve().parents[2]
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
    return subprocess.run([str(c) for c in command], text=True, env=clean, **options)


def _environment(folder: Path) -> Path:
    """The Python of an environment with both of our wheels and AudibleLight."""
    python = folder / "bin" / "python"
    if not python.exists():
        venv.create(folder, with_pip=True)
    ours = [
        *(ROOT / "dist").glob("soundspaces_sim-*.whl"),
        *(ROOT / "dist").glob("rlr_audio_propagation-*.whl"),
    ]
    if len(ours) != 2:
        sys.exit(
            f"{ROOT / 'dist'}: expected one wheel of each distribution, got {len(ours)}; run make wheels"
        )
    for force, what in (
        ([], [*ours, f"audiblelight=={RELEASE}", *NEEDS]),
        (["--force-reinstall", "--no-deps"], ours),
    ):
        _run(python, "-m", "pip", "install", "--quiet", *force, *what, check=True)
    check = "from importlib.metadata import version as v; print(v('rlr_audio_propagation'), v('audiblelight'))"
    print(
        "installed:",
        _run(python, "-c", check, check=True, capture_output=True).stdout.strip(),
        flush=True,
    )
    return python


def _checkout(given: Path | None, folder: Path) -> Path:
    if given is not None:
        if not (given / "tests" / FILES[0]).is_file():
            sys.exit(f"{given}: expected a checkout of {REPOSITORY} at {RELEASE}, with tests/{FILES[0]}")
        return given
    if not (folder / "tests").is_dir():
        done = _run("git", "clone", "--quiet", "--depth", "1", "--branch", RELEASE, REPOSITORY, folder)
        if done.returncode:
            sys.exit(
                f"cannot clone {REPOSITORY}; give a checkout of its tag {RELEASE}: make test-clients CHECKOUT=path"
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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--checkout", type=Path)
    parser.add_argument("--select", default="", help="a pytest -k expression, for a few of the tests")
    parser.add_argument("--only-scripts", action="store_true", help="without AudibleLight's tests")
    options = parser.parse_args()
    folder = ROOT / "build" / "clients"
    python = _environment(folder / "environment")
    failed = run_scripts([str(python)], folder / "scripts", {"PYTHONPATH": ""})
    if options.only_scripts:
        return min(failed, 1)
    where = "import sysconfig; print(sysconfig.get_path('purelib'))"
    packages = Path(_run(python, "-c", where, check=True, capture_output=True).stdout.strip())
    notes = _place(_checkout(options.checkout, folder / "AudibleLight"), packages)
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
    return done.returncode or min(failed, 1)


if __name__ == "__main__":
    sys.exit(main())
