"""Compiling what a job needs, once per installation, side by side.

Numba compiles one function at a time in a process, so that a first run would wait a minute and more on one
core. Here child processes compile the tracer's kernels into the cache on disk, while the job places its
points; a mark in the cache tells later runs that nothing is left to do. What is compiled is what is run: each
child simulates a little box with some of the techniques, and after "then" with others. Without names all is
compiled, as a job does it.

    python -m soundspaces_sim.build.warm_up [specular then arrivals]
"""

from __future__ import annotations

import gc
import hashlib
import logging
import os
import platform
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba
import numpy as np

from soundspaces_sim.core.config import SimulationConfig
from soundspaces_sim.core.numerics.kernel import source_digest
from soundspaces_sim.core.numerics.threads import core_count
from soundspaces_sim.core.processes import end_with
from soundspaces_sim.core.simulation_config import (
    ConnectionsConfig,
    DiffractionConfig,
    RadianceTransferConfig,
    SpecularConfig,
)
from soundspaces_sim.scene.materials import MaterialTable
from soundspaces_sim.scene.scene import Scene
from soundspaces_sim.transport.integrator import run_techniques, simulate_tile
from soundspaces_sim.transport.paths import subpath
from soundspaces_sim.transport.preparation import make_model
from soundspaces_sim.transport.techniques import TECHNIQUES

_log = logging.getLogger(__name__)

_MODULE = "soundspaces_sim.build.warm_up"  # not `__name__`: that is another one where this is run itself

_ECHOGRAMS = "echograms"  # in a share: what follows the techniques
_DURATION = "duration"  # in a share: how long responses are, which is measured before them
_THEN = "then"  # in a share, and on a child's stdout: all before it is compiled first
Share = tuple[str, ...]
# What each child compiles, on two cores and on more of them, where the arrivals take longest. A kernel is compiled
# whole, so more children would not end sooner: three quarters of the arrivals are one, `find_arrivals`.
_OF_TWO: tuple[Share, ...] = (
    ("specular", "receiver_volumes", "connections", "radiance_transfer", _ECHOGRAMS),
    ("arrivals", _DURATION),
)
_OF_MORE: tuple[Share, ...] = (
    ("specular", "radiance_transfer"),
    ("receiver_volumes", "connections", _DURATION, _ECHOGRAMS),
    ("arrivals",),
)
# For who listens meanwhile: what gives a first sound comes first, which is all but arrivals and radiance transfer.
# Radiance transfer takes what specular subpaths leave.
_SOON_OF_TWO: tuple[Share, ...] = (
    ("specular", _ECHOGRAMS, _THEN, "specular", "radiance_transfer"),
    ("receiver_volumes", "connections", _THEN, "arrivals", _DURATION),
)
_SOON_OF_MORE: tuple[Share, ...] = (
    ("specular", _THEN, "specular", "radiance_transfer", _DURATION),
    ("receiver_volumes", "connections", _ECHOGRAMS),
    ("arrivals",),
)
_LAST: Share = ("arrivals",)  # of which a first sound needs nothing
#: How many functions each child has compiled after each tenth of its time: small ones come first. Measured. A slow
#: test compares the last numbers.
TENTHS: dict[Share, tuple[int, ...]] = {
    _OF_TWO[0]: (0, 57, 134, 158, 190, 192, 216, 242, 285, 302, 307),
    _OF_TWO[1]: (0, 49, 126, 174, 221, 261, 284, 301, 313, 313, 314),
    _OF_MORE[0]: (0, 24, 63, 101, 133, 158, 158, 160, 178, 191, 195),
    _SOON_OF_TWO[0]: (0, 29, 94, 143, 154, 164, 192, 206, 226, 241, 253),
    _SOON_OF_TWO[1]: (0, 89, 157, 189, 238, 285, 325, 358, 376, 376, 377),
    _SOON_OF_MORE[0]: (0, 26, 98, 141, 158, 165, 185, 211, 228, 238, 250),
    _SOON_OF_MORE[1]: (0, 26, 83, 143, 149, 170, 181, 210, 214, 231, 232),
    _OF_MORE[1]: (0, 23, 81, 118, 158, 160, 191, 220, 225, 245, 250),
    _LAST: (0, 35, 82, 114, 161, 195, 221, 248, 263, 263, 264),
}
_STEPS = 1000
# Done, of how many: shares of the time that was left when one began to wait.
Tell = Callable[[int, int], None]


def shares_for(cores: int, soon: bool = False) -> tuple[Share, ...]:
    """What each child compiles on so many cores; `soon`: for a first sound before the rest."""
    if soon:
        return _SOON_OF_TWO if cores < 3 else _SOON_OF_MORE
    return _OF_TWO if cores < 3 else _OF_MORE


def _rounds(share: Share) -> list[Share]:
    """What a child compiles, one after the other."""
    ends = [k for k, name in enumerate(share) if name == _THEN]
    return [share[i:j] for i, j in zip([0, *(k + 1 for k in ends)], [*ends, len(share)], strict=True)]


def share_of_time(compiled: int, tenths: Sequence[int]) -> float:
    """Share of its time after which a child has compiled so many functions, below 1."""
    # A kernel that takes long is none until it is done.
    steps, first = np.unique(tenths, return_index=True)
    return min(float(np.interp(compiled, steps, first / (len(tenths) - 1))), 0.99)


def mark_path() -> Path:
    """The file beside the compiled kernels that says: all are there, for these sources and this CPU."""
    cpu = numba.config.CPU_NAME or llvmlite.binding.get_host_cpu_name()  # type: ignore[attr-defined]
    parts = source_digest(), numba.__version__, platform.python_version(), cpu
    name = hashlib.sha256(" ".join(parts).encode()).hexdigest()[:16]
    return Path(subpath.trace_subpaths._cache.cache_path) / f"kernels-{name}.compiled"


class WarmUp:
    """Children that compile while this process does other things. `wait` for them before simulating. With `soon`,
    `wait_for_first` returns when subpaths can be simulated without arrivals and radiance transfer."""

    def __init__(self, soon: bool = False) -> None:
        self._shares = shares_for(core_count(), soon)
        self._first = [threading.Event() for _ in self._shares]
        self._children = [_child(share) for share in self._shares]
        self._compiled = [0] * len(self._children)
        self._readers = [
            threading.Thread(target=self._count, args=(k,), daemon=True)
            for k in range(len(self._children))
        ]
        for reader in self._readers:
            reader.start()

    def _count(self, k: int) -> None:
        lines = self._children[k].stdout
        assert lines is not None
        for line in lines:
            if line.strip() == _THEN:
                self._first[k].set()
            else:
                self._compiled[k] += 1
        self._first[k].set()

    def wait_for_first(self) -> None:
        """Until what each child compiles first is there, or the child has ended."""
        for share, event in zip(self._shares, self._first, strict=True):
            if share != _LAST:
                event.wait()

    def _share(self) -> float:
        """Of the time that the slowest child takes; one that has ended does not count."""
        tenths_of = [TENTHS[share] for share in self._shares]
        each = zip(self._compiled, tenths_of, self._children, strict=True)
        return min((share_of_time(n, tenths) for n, tenths, c in each if c.poll() is None), default=1.0)

    def wait(self, tell: Tell | None = None) -> None:
        """Until all is compiled. A child that fails leaves its share to this process, with a warning."""
        whole, before = True, self._share()
        for child, reader in zip(self._children, self._readers, strict=True):
            while child.poll() is None:
                if tell is not None:
                    tell(
                        int(_STEPS * max(self._share() - before, 0.0) / max(1.0 - before, 0.01)), _STEPS
                    )
                try:
                    child.wait(0.5)
                except subprocess.TimeoutExpired:
                    continue
            reader.join()
            message = _close(child)
            if child.returncode:
                whole = False
                last = message.strip().splitlines()[-1:] or ["no message"]
                _log.warning(
                    "compiling ahead failed (%s); kernels are compiled as they are needed", last[0]
                )
        if whole:
            try:
                mark_path().touch()
            except OSError:
                _log.warning(
                    "%s cannot be written: kernels may be compiled again next time", mark_path()
                )
        if tell is not None:
            tell(_STEPS, _STEPS)

    def stop(self) -> None:
        """End the children."""
        for child, reader in zip(self._children, self._readers, strict=True):
            child.kill()
            child.wait()
            reader.join()
            _close(child)


def _close(child: subprocess.Popen[str]) -> str:
    """Close the pipes of a child that has ended; what it wrote to stderr."""
    assert child.stdout is not None and child.stderr is not None
    with child.stdout, child.stderr:
        return child.stderr.read()


def _child(share: Sequence[str]) -> subprocess.Popen[str]:
    command = [sys.executable, "-P", "-m", _MODULE, *share]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def start(soon: bool = False) -> WarmUp | None:
    """Begin to compile, if that has not been done yet on this machine; None if there is nothing to do. `soon`: what
    gives a first sound comes first."""
    if numba.config.DISABLE_JIT or mark_path().exists():  # type: ignore[attr-defined]
        return None
    return WarmUp(soon)


def compile_share(names: Sequence[str]) -> None:
    """Compile the kernels of these techniques by simulating a box with them alone."""
    kept = [
        t if t.name in names else replace(t, trace=None, connect=None, join=None, requires=())
        for t in TECHNIQUES
    ]
    late, whole = "radiance_transfer" in names, _ECHOGRAMS in names
    config = SimulationConfig(
        walks=16,
        connections=ConnectionsConfig(subpaths=2),
        specular=SpecularConfig(ratio=1),
        radiance_transfer=RadianceTransferConfig(enabled=late),
        diffraction=DiffractionConfig(enabled="arrivals" in names),
        scattering="size" if late else "table",
        duration=None if _DURATION in names else 0.1,
        max_duration=0.1,
    )
    points = np.array([[0.8, 1.0, 1.0], [2.2, 2.0, 1.0]])
    model = make_model(_box(), points, config)
    if whole:
        simulate_tile(model, points, None, techniques=kept)
    else:
        run_techniques(model, points, None, techniques=kept)


def _box() -> Scene:
    """A room with a screen in its middle, so that sound bends."""
    corners = np.array([[x, y, z] for x in (0, 3) for y in (0, 3) for z in (0, 2.5)], float)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    corners = np.concatenate([corners, [[1.5, y, z] for y in (0.5, 2.5) for z in (0, 1.8)]])
    sides.append((8, 9, 11, 10))
    faces = np.array([f for a, b, c, d in sides for f in ((a, b, c), (a, c, d))])
    table = MaterialTable(("any",), np.array([1e3]), *np.array([[[0.2]], [[0.3]], [[0.01]]]))
    return Scene(corners, faces, np.zeros(len(faces), int), table)


def _tell_compiled() -> None:
    """A line on stdout for every function that has been compiled."""
    from numba.core import event

    class _Lines(event.Listener):
        def on_start(self, event: Any) -> None:
            pass

        def on_end(self, event: Any) -> None:
            print(event.data["dispatcher"].py_func.__qualname__, flush=True)

    event.register("numba:compile", _Lines())


def main(names: Sequence[str]) -> None:
    if names:
        end_with(os.getppid())
        gc.disable()  # a tenth of the time, for some 200 MB
        _tell_compiled()
        first, *rest = _rounds(tuple(names))
        compile_share(first)
        for later in rest:
            print(_THEN, flush=True)
            compile_share(later)
    elif (children := start()) is not None:
        children.wait()


if __name__ == "__main__":
    main(sys.argv[1:])
