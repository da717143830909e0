"""`make test-clients`: AudibleLight's own tests on our rlr_audio_propagation, in an environment of their own.

The release on PyPI has no tests: they come from its repository at the same tag, cloned, or from `--checkout`. The
tests that never reach the simulator, or need files that its authors download, are left out, each with a reason.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import venv
from pathlib import Path

from tests.clients.stand_in import write_apartment

RELEASE = "0.1.2"
REPOSITORY = "https://github.com/AudibleLight/AudibleLight"
ROOT = Path(__file__).resolve().parents[2]
FILES = ("test_worldstate_rlr.py", "test_with_algorithms.py", "test_synthesize.py", "test_core.py")
NEEDS = ("pytest", "pytest-rerunfailures", "opencv-python-headless")
#: Part of a test's name, and why tests that have it are left out.
LEFT_OUT = {
    "sofa": "reads measured responses from a file that its fixture downloads; no simulator",
    "scene_from_dict": "one of its cases reads that downloaded file",
    "parse_backend": "one of its cases reads that downloaded file",
    "image": "composes videos; no simulator",
    "video": "composes videos; no simulator",
    "music[microphone3": "expects 180 degrees and compares with -180, the same direction, without wrapping",
}


def _run(*command: str | Path, **options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(c) for c in command], text=True, **options)  # type: ignore[call-overload,no-any-return]


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
    mesh = tests / "test_resources" / "meshes" / "Oyens.glb"
    if not mesh.is_file():
        write_apartment(mesh)
        notes.append(
            "Oyens.glb is not in the checkout: a made-up apartment of its bounds stands in for it"
        )
    (tests / "test_resources" / "metu_foa.sofa").touch()  # or the first fixture downloads it
    return notes


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--checkout", type=Path)
    parser.add_argument("--select", default="", help="a pytest -k expression, for a few of the tests")
    options = parser.parse_args()
    folder = ROOT / "build" / "clients"
    python = _environment(folder / "environment")
    where = "import sysconfig; print(sysconfig.get_path('purelib'))"
    packages = Path(_run(python, "-c", where, check=True, capture_output=True).stdout.strip())
    notes = _place(_checkout(options.checkout, folder / "AudibleLight"), packages)
    files = [f"tests/{name}" for name in FILES]
    listed = _run(
        python, "-m", "pytest", "-q", "--collect-only", *files, cwd=packages, capture_output=True
    )
    names = [line for line in listed.stdout.splitlines() if "::" in line]
    if not names:
        sys.exit(f"no tests were found:\n{listed.stdout}{listed.stderr}")
    out = {
        n: why for n in names for part, why in LEFT_OUT.items() if part in n.partition("::")[2].lower()
    }
    keep = [name for name in names if name not in out]
    wanted = ["-k", options.select] if options.select else []
    done = _run(
        python, "-m", "pytest", "-p", "no:cacheprovider", "-q", "-rA", *wanted, *keep, cwd=packages,
        stdout=subprocess.PIPE,
    )  # fmt: skip
    print(done.stdout)
    for word in ("PASSED", "FAILED", "ERROR", "SKIPPED"):
        print(f"{word.lower()}: {len(re.findall(rf'^{word} ', done.stdout, re.M))}")
    print(f"left out: {len(out)}")
    for name, why in out.items():
        print(f"  {name}: {why}")
    print("\n".join(notes))
    return done.returncode


if __name__ == "__main__":
    sys.exit(main())
