"""This checkout beside another one of the same project: start, compiling, a tile, rendering, memory.

Question: By what factor do import, compiling, a tile, rendering and memory differ from another checkout's?

Method: Fresh processes of the same interpreter and the same libraries, in turn, each with one of the two
checkouts first on its path; which of the two comes first changes from round to round. Processor seconds (user
and system, kernels' compilers and other children included), because other work on the machine changes them
least; memory is the largest resident set. Per quantity the geometric mean of the rounds' ratios, this checkout
over the other, with the standard error of its logarithm as a factor: a ratio of 1.02 ×/÷ 1.05 does not differ
from 1.

Amortised: Compiling starts from empty caches of kernels and scenes, and its own row is what a small job takes
more than from full ones. All other rows start from full caches; a tile's and rendering's seconds leave out
imports, scene and the first call.

Takes: 10 minutes on a quiet machine. Arguments: the other checkout, rounds (7), rounds of compiling (3).
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.tools.record import ROOT, Table, UnavailableError, table

_START = """
import json, resource, sys, time
def used():
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in usages)
began = used()
import soundspaces_sim as ss
from pathlib import Path
if not Path(ss.__file__).resolve().is_relative_to(sys.argv[1]):
    raise SystemExit(f"{ss.__file__}: expected the package of {sys.argv[1]}")
"""
_SCRIPTS = {
    "import": """
found = {"import soundspaces_sim": used() - began}
ss.simulate, ss.build_dataset, ss.open_dataset, ss.binaural_rir
found["… and what simulating, reading and rendering need"] = used() - began
""",
    "job": """
import tempfile
config = ss.JobConfig(grid=ss.GridConfig(spacing=2.0, rays=100),
                      simulation=ss.SimulationConfig(walks=16, connections={'subpaths': 8}, duration=0.2))
with tempfile.TemporaryDirectory() as folder:
    result = ss.build_dataset(ss.load_scene("demo"), folder, config)
    with ss.open_dataset(result.folder) as ds:
        ds.binaural(0, 1)
found = {"job": used() - began}
""",
    "tile": """
scene, config = ss.load_scene("demo"), ss.SimulationConfig(walks=1000, duration=0.6)
points = ss.make_grid(scene, 1.0).points[:24]
ss.simulate(scene, points[:2], points[:2], config)
began = used()
ss.simulate(scene, points, points, config)
found = {"a tile of the demo, 24 × 24 points, 1,000 subpaths": used() - began}
""",
    "rendering": """
scene = ss.load_scene("demo")
config = ss.SimulationConfig(walks=100, duration=1.0)
echogram = ss.simulate(scene, [[2.4, 2.7, 1.5]], [[5.0, 6.5, 1.5]], config)[0, 0]
def render(seed):
    return ss.binaural_rir(ss.ambisonic_rir(echogram, 44100, seed), 44100, 10.0 * seed)
render(0)
began = used()
for seed in range(200):
    render(seed)
found = {"200 binaural responses of 1 s, 44.1 kHz": used() - began}
""",
}
_END = """
print(json.dumps([found, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3]))
"""


def ratio(pairs: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Geometric mean of first over second, and the factor of its standard error.

    Raises `ValueError` for fewer than two pairs, and where one is not above 0.
    """
    if len(pairs) < 2 or not all(a > 0.0 and b > 0.0 for a, b in pairs):
        raise ValueError(f"expected at least two pairs above 0, got {list(pairs)}")
    logs = [math.log(a / b) for a, b in pairs]
    mean = math.fsum(logs) / len(logs)
    variance = math.fsum((x - mean) ** 2 for x in logs) / (len(logs) - 1)
    return math.exp(mean), math.exp(math.sqrt(variance / len(logs)))


def measure(what: str, checkout: Path, caches: Path) -> tuple[dict[str, float], float]:
    """Processor seconds by quantity, and MB at most, of one process with the package of a checkout.

    Raises `RuntimeError` with the last line of what the process said where it fails.
    """
    environment = {
        **os.environ,
        "PYTHONPATH": str(checkout),
        "NUMBA_CACHE_DIR": str(caches / "kernels"),
        "SOUNDSPACES_SIM_CACHE": str(caches / "scenes"),
    }
    done = subprocess.run(
        [sys.executable, "-c", _START + _SCRIPTS[what] + _END, str(checkout)],
        cwd=caches, env=environment, capture_output=True, text=True,
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(
            f"{checkout}: {what}: {(done.stderr.strip().splitlines() or ['no output'])[-1]}"
        )
    found, memory = json.loads(done.stdout.splitlines()[-1])
    return found, memory


def _in_turn(
    what: str, checkouts: Sequence[Path], caches: Sequence[Path], first: int
) -> list[tuple[dict[str, float], float]]:
    """`measure` of both, the one of number `first` before the other; in the order of `checkouts`."""
    found = {k: measure(what, checkouts[k], caches[k]) for k in (first, 1 - first)}
    return [found[0], found[1]]


def _empty_caches(folder: Path) -> list[Path]:
    caches = [folder / "this", folder / "other"]
    for each in caches:
        (each / "scenes").mkdir(parents=True, mode=0o700)
    return caches


def _row(name: str, unit: str, pairs: Sequence[tuple[float, float]]) -> tuple[object, ...]:
    mean, factor = ratio(pairs)
    ours, theirs = (sorted(column)[len(pairs) // 2] for column in zip(*pairs, strict=True))
    return name, unit, ours, theirs, mean, factor, len(pairs)


def run(other: str = "", rounds: str = "7", compiling: str = "3") -> list[Table]:
    """The ratios."""
    if not other:
        raise UnavailableError(
            "it needs the path of another checkout, as in run speed.baseline -- ../before"
        )
    checkouts = [ROOT, Path(other).resolve()]
    if not (checkouts[1] / "soundspaces_sim" / "__init__.py").is_file():
        raise ValueError(f"{checkouts[1]}: expected a checkout of soundspaces_sim")
    pairs: dict[tuple[str, str], list[tuple[float, float]]] = {}

    def note(name: str, unit: str, a: float, b: float) -> None:
        pairs.setdefault((name, unit), []).append((a, b))

    for k in range(int(compiling)):
        with tempfile.TemporaryDirectory() as folder:
            caches = _empty_caches(Path(folder))
            cold = _in_turn("job", checkouts, caches, k % 2)
            warm = _in_turn("job", checkouts, caches, k % 2)
        note("compiling: a small job from empty caches, less from full ones", "s",
             *(c[0]["job"] - w[0]["job"] for c, w in zip(cold, warm, strict=True)))  # fmt: skip
        note("a small job of the demo from full caches", "s", *(w[0]["job"] for w in warm))
    with tempfile.TemporaryDirectory() as folder:
        caches = _empty_caches(Path(folder))
        for what in ("import", "tile", "rendering"):
            _in_turn(what, checkouts, caches, 0)  # fills caches
            for k in range(int(rounds)):
                (ours, mb), (theirs, their_mb) = _in_turn(what, checkouts, caches, k % 2)
                for name in ours:
                    note(name, "s", ours[name], theirs[name])
                note(f"largest resident set: {what}", "MB", mb, their_mb)
    heads = ["", "unit", "this, median", "other, median", "this / other", "×/÷ standard error", "rounds"]
    rows = [_row(name, unit, found) for (name, unit), found in pairs.items()]
    return [
        table(f"This checkout and {describe(checkouts[1])}, processor seconds and memory", heads, rows)
    ]


def describe(checkout: Path) -> str:
    """Tag or commit of a checkout."""
    done = subprocess.run(
        ["git", "describe", "--tags", "--always", "--dirty"],
        cwd=checkout,
        capture_output=True,
        text=True,
    )
    return done.stdout.strip() or checkout.name
