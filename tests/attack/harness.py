"""Mutations of every file that is read, in a child process with limits of memory and time.

A try damages a whole file, reads it, and counts how that ended:

own       an error of ours
same      accepted, with the content of the whole file
other     accepted, with other content: what a damaged file without checksums may do
foreign   another exception, or the end of the process
slow      more than `SLOW` seconds of CPU
silent    accepted with other content, of a file that has checksums

    python -m tests.attack.harness TRIES [VICTIM ...]

tries that often, shared by all victims or by those that are named, and prints the outcomes.
"""

from __future__ import annotations

import faulthandler
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
_PATH = [
    str(ROOT),
    *(str(ROOT / "neighbours" / name / "src") for name in ("room_programs", "exports")),
]
OUTCOMES = ("own", "same", "other", "foreign", "slow", "silent")
SLOW = 5.0  # s of CPU, of one try
_HANGS = 30.0  # s, after which the child is ended
_MEMORY = 3 * 2**30  # bytes that a child may take more than it has when it begins
_NUMBERS = (
    b"0",
    b"-1",
    b"1e38",
    b"nan",
    b"99999999999",
    b"1e-320",
    b"2147483647",
    b"0.5",
    b"inf",
    b"255",
)
_FIELDS = tuple(
    n.to_bytes(8, "little", signed=n < 0)
    for n in (0, 1, -1, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 255, 0x7F800000, 0x7FC00000, 0x7E967699)
)  # fmt: skip


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """One to three damages: flipped bytes, fields of extreme numbers, pieces cut, doubled or moved, digits replaced."""
    out = bytearray(data)
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        kind, at = int(rng.integers(9)), int(rng.integers(len(out) + 1))
        size = int(2 ** rng.uniform(0.0, 8.0))
        if kind == 0:
            for i in rng.integers(0, max(len(out), 1), int(rng.integers(1, 8))):
                out[i : i + 1] = bytes([int(rng.integers(256))])
        elif kind == 1:
            out[at : at + 1] = bytes([(out[at : at + 1] or b"\0")[0] ^ (1 << int(rng.integers(8)))])
        elif kind == 2 and rng.random() < 0.3:
            del out[at:]
        elif kind == 3:
            del out[at : at + size]
        elif kind == 4:
            out[at:at] = out[at : at + size] * int(rng.integers(1, 4))
        elif kind == 5:
            width = int(rng.choice([1, 2, 4, 8]))
            out[at : at + width] = _FIELDS[int(rng.integers(len(_FIELDS)))][:width]
        elif kind == 6:
            other = int(rng.integers(len(out) + 1))
            out[at : at + size] = out[other : other + size]
        else:
            _replace_number(out, at, rng)
    return bytes(out)


def _replace_number(out: bytearray, at: int, rng: np.random.Generator) -> None:
    """Put another number in the place of the next one that is written in digits."""
    digits, near = b"0123456789.-+e", out[at : at + 200]
    first = next((i for i, c in enumerate(near) if c in digits), None)
    if first is None:
        return
    last = first
    while last < len(near) and near[last] in digits:
        last += 1
    out[at + first : at + last] = _NUMBERS[int(rng.integers(len(_NUMBERS)))]


def run(
    folder: Path, tries: Mapping[str, int], seed: int = 0
) -> tuple[dict[str, dict[str, int]], list[str]]:
    """Outcomes by victim, and a line for each that is foreign, slow or silent; `folder` as `make_whole` left it."""
    names = list(tries)
    path = folder / "counts.npy"
    np.save(path, np.zeros((len(names), len(OUTCOMES) + 1), np.int64))
    (folder / "names.json").write_text(json.dumps([names, list(tries.values()), seed]))
    (folder / "found.txt").touch()
    while True:
        done = subprocess.run(
            [sys.executable, "-m", "tests.attack.harness", "child", str(folder)],
            cwd=ROOT, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": os.pathsep.join(_PATH)},
        )  # fmt: skip
        counts = np.load(path)
        if done.returncode == 0:
            break
        under_way = next((i for i, n in enumerate(names) if counts[i, -1] < tries[n]), None)
        if under_way is None or not (folder / "ready").exists():
            raise RuntimeError(done.stderr[-3000:])
        outcome = "slow" if done.returncode == 1 and "Timeout" in done.stderr else "foreign"
        with open(folder / "found.txt", "a") as log:
            log.write(
                f"{outcome} {names[under_way]} {counts[under_way, -1]}: ended with {done.returncode}\n{done.stderr[-1500:]}\n"
            )
        counts[under_way, OUTCOMES.index(outcome)] += 1
        counts[under_way, -1] += 1
        np.save(path, counts)
    found = {
        n: dict(zip(OUTCOMES, row.tolist(), strict=False)) for n, row in zip(names, counts, strict=True)
    }
    return found, (folder / "found.txt").read_text().splitlines()


def _child(folder: Path) -> None:
    from tests.attack.victims import make_victims

    warnings.simplefilter("ignore")
    names, tries, seed = json.loads((folder / "names.json").read_text())
    shutil.rmtree(folder / "victims", ignore_errors=True)
    (folder / "victims").mkdir()
    victims = make_victims(folder / "victims", folder)
    counts = np.load(folder / "counts.npy", mmap_mode="r+")
    wholes = {}
    for name in names:
        wholes[name] = (
            victims[name].path.read_bytes(),
            victims[name].read(),
        )  # which loads and compiles what is needed
    held = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (held + _MEMORY, held + _MEMORY))
    (folder / "ready").touch()
    for row, (name, count) in enumerate(zip(names, tries, strict=True)):
        victim, (data, expected) = victims[name], wholes[name]
        for k in range(int(counts[row, -1]), count):
            rng = np.random.default_rng([seed, zlib.crc32(name.encode()), k])
            damaged = mutate(data, rng)
            if victim.resign is not None:
                damaged = victim.resign(damaged)
            victim.path.write_bytes(damaged)
            faulthandler.dump_traceback_later(_HANGS, exit=True)
            outcome, why = _one(victim, expected, same=damaged == data)
            faulthandler.cancel_dump_traceback_later()
            if outcome in ("foreign", "slow", "silent"):
                with open(folder / "found.txt", "a") as log:
                    log.write(f"{outcome} {name} {k}: {why}\n")
                (folder / f"{outcome}-{name}-{k}").write_bytes(damaged)
            counts[row, OUTCOMES.index(outcome)] += 1
            counts[row, -1] = k + 1
        victim.path.write_bytes(data)
    counts.flush()


def _one(victim: object, expected: bytes, same: bool) -> tuple[str, str]:
    """The outcome of reading a damaged file, and what there is to say of it."""
    from soundspaces_sim import SoundSpacesSimError

    start = time.process_time()
    why = ""
    try:
        found = victim.read()  # type: ignore[attr-defined]
        outcome = "same" if found == expected else "other"
        if outcome == "other" and victim.sealed:  # type: ignore[attr-defined]
            outcome = "silent"
    except SoundSpacesSimError as error:
        outcome, why = ("foreign", f"whole file refused: {error}") if same else ("own", "")
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        at = [f"{Path(f.filename).name}:{f.lineno}" for f in frames[-4:]]
        outcome, why = "foreign", f"{error!r:.200} at {' '.join(at)}"
    took = time.process_time() - start
    return ("slow", f"{took:.1f} s, {outcome} {why}") if took > SLOW else (outcome, why)


def report(found: Mapping[str, Mapping[str, int]]) -> str:
    """A table of outcomes."""
    rows: list[Sequence[object]] = [("", "tries", *OUTCOMES)]
    rows += [(name, sum(n.values()), *n.values()) for name, n in found.items()]
    total = [sum(n[o] for n in found.values()) for o in OUTCOMES]
    rows.append(("all", sum(total), *total))
    return "\n".join(f"{row[0]:<20}" + "".join(f"{cell:>9}" for cell in row[1:]) for row in rows)


def _main(tries: int, chosen: Sequence[str]) -> None:
    from tests.attack.victims import make_victims, make_whole

    folder = Path(tempfile.mkdtemp(prefix="harness"))
    make_whole(folder)
    (folder / "names").mkdir()
    names = chosen or list(make_victims(folder / "names", folder))
    start = time.monotonic()
    found, lines = run(folder, dict.fromkeys(names, tries // len(names)))
    print(
        report(found),
        *lines[:200],
        f"{time.monotonic() - start:.0f} s; damaged files in {folder}",
        sep="\n",
    )


if __name__ == "__main__":
    if sys.argv[1] == "child":
        _child(Path(sys.argv[2]))
    else:
        _main(int(sys.argv[1]), sys.argv[2:])
