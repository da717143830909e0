"""A new lobe and a new reflection law are two files each: a module of `transport.bsdf` and a line in a
registry."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import soundspaces_sim

_TESTS = Path(__file__).parents[1]
_TOYS = Path(__file__).parent / "toys"
_LINES = {
    "transport/bsdf/__init__.py": [
        ("import diffuse, specular, transmission\n", "import diffuse, sheen, specular, transmission\n"),
        ("specular.LOBE, transmission.LOBE)\n", "specular.LOBE, transmission.LOBE, sheen.LOBE)\n"),
    ],
    "core/numerics/reflection_laws.py": [
        ('    "angle": Entry(', '    "linear": Entry("soundspaces_sim.transport.bsdf.linear", "a toy"),\n    "angle": Entry('),
    ],
}  # fmt: skip


@pytest.fixture(scope="module")
def copy_with_toys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("toys")
    package = Path(soundspaces_sim.__file__).parent
    shutil.copytree(package, root / package.name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("sheen.py", "linear.py"):
        shutil.copy(_TOYS / name, root / package.name / "transport" / "bsdf" / name)
    for path, lines in _LINES.items():
        text = (root / package.name / path).read_text(encoding="utf-8")
        for old, new in lines:
            assert text.count(old) == 1, (path, old)
            text = text.replace(old, new)
        (root / package.name / path).write_text(text, encoding="utf-8")
    (root / "tests" / "transport").mkdir(parents=True)
    for name in (
        "__init__.py", "rooms.py", "stats.py", "transport/__init__.py", "transport/test_bsdf.py",
        "transport/test_sampling.py",
    ):  # fmt: skip
        shutil.copy(_TESTS / name, root / "tests" / name)
    shutil.copy(_TOYS / "check_toys.py", root / "tests" / "transport" / "test_toys.py")
    return root


@pytest.mark.slow
@pytest.mark.parametrize("tests", ["test_bsdf.py", "test_toys.py"])
def test_toys_are_taken_like_our_own(copy_with_toys: Path, tests: str) -> None:
    """Our own tests of lobes hold for the toy, and what it makes of rooms and planes is known in closed form."""
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-c",
        os.devnull,
        "--rootdir",
        ".",
    ]
    done = subprocess.run(
        [*command, f"tests/transport/{tests}"], cwd=copy_with_toys, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": str(copy_with_toys)},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-4000:]
