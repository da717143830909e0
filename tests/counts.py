"""What four fixed small jobs count, on any machine: rays, deposits, products, paths, bytes and compiled functions.

    python -m tests.counts            # prints them
    python -m tests.counts --store    # and keeps them in tests/counts.json

Time is noisy, counts are not. Whatever a change adds to them costs time as well. Rays are counted by a function that
stands between kernels and Embree in this process alone; kernels in production count nothing for it.
"""

from __future__ import annotations

import ctypes
import gc
import json
import math
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from numba.core.dispatcher import Dispatcher

import soundspaces_sim as ss
from soundspaces_sim.core.config import DatasetConfig
from soundspaces_sim.core.io import disk_cache
from soundspaces_sim.core.numerics.kernel import _KernelCache, set_thread_count
from soundspaces_sim.core.profile import profiled
from soundspaces_sim.core.simulation_config import MaterialsConfig
from soundspaces_sim.scene.rays import embree
from soundspaces_sim.transport.arrivals.prepared import prepare_planes, prepare_wedges
from tests.rooms import table, two_rooms

STORED = Path(__file__).with_name("counts.json")
_RAYS = """
@{0}_count = global i64 0
define void @{0}(i8* %scene, i8* %ray, i8* %arguments) {{
  %before = load i64, i64* @{0}_count
  %after = add i64 %before, 1
  store i64 %after, i64* @{0}_count
  %real = inttoptr i64 {1} to void (i8*, i8*, i8*)*
  tail call void %real(i8* %scene, i8* %ray, i8* %arguments)
  ret void
}}
"""
_MADE = "empty", "zeros", "ones", "full", "concatenate", "stack", "take", "repeat", "ascontiguousarray"


class _Rays:
    """Calls of Embree's entry points; before any kernel is loaded."""

    def __init__(self) -> None:
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        machine = llvm.Target.from_default_triple().create_target_machine()
        self._engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        self._counts = [
            self._between(symbol, name)
            for symbol, name in (
                (embree._INTERSECT_SYMBOL, "rtcIntersect1"),
                (embree._OCCLUDED_SYMBOL, "rtcOccluded1"),
            )
        ]

    def _between(self, symbol: str, name: str) -> Any:
        real = ctypes.cast(getattr(embree._library(), name), ctypes.c_void_p).value
        self._engine.add_module(llvm.parse_assembly(_RAYS.format(f"counting_{name}", real)))
        self._engine.finalize_object()
        llvm.add_symbol(symbol, self._engine.get_function_address(f"counting_{name}"))
        at = self._engine.get_global_value_address(f"counting_{name}_count")
        return ctypes.c_int64.from_address(at)

    def total(self) -> int:
        return sum(int(count.value) for count in self._counts)


def _count_bytes(made: Counter[str]) -> None:
    """Count the bytes of arrays that NumPy's functions give, of the package's calls and of others."""

    def counting(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **options: Any) -> Any:
            array = function(*args, **options)
            made["bytes of arrays"] += getattr(array, "nbytes", 0)
            return array

        return call

    for name in _MADE:
        setattr(np, name, counting(getattr(np, name)))


def _compiled() -> int:
    """Versions of kernels that are in use, compiled or from the cache."""
    functions = [o for o in gc.get_objects() if issubclass(type(o), Dispatcher)]
    return sum(len(f.overloads) for f in functions if type(f._cache) is _KernelCache)


def _paths(echoes: ss.Echograms) -> dict[str, int]:
    kinds = np.bincount(echoes.early.kind, minlength=1)
    return {"arrivals": len(echoes.early.delay), "bent arrivals": int(kinds[1:].sum())}


def _box() -> dict[str, int]:
    """One source and four listeners by default, as the quickstart has it."""
    room = ss.shoebox((6.0, 5.0, 2.7), absorption=0.2, scattering=0.3)
    listeners = [[1.0, 4.0, 1.2], [3.0, 2.0, 1.5], [4.5, 3.5, 1.2], [5.2, 1.1, 1.6]]
    return _paths(ss.simulate(room, [[1.5, 1.5, 1.2]], listeners))


def _two_rooms() -> dict[str, int]:
    """All pairs of twelve points of two rooms with a door between them."""
    scene = two_rooms(table(0.2, 0.3))
    points = np.random.default_rng(0).uniform([0.5, 0.5, 1.0], [7.5, 3.5, 1.8], (12, 3)).round(2)
    found = _paths(ss.simulate(scene, points, points, ss.SimulationConfig(walks=320, duration=0.5)))
    config = ss.SimulationConfig()
    wedges, planes = prepare_wedges(scene, config)[0], prepare_planes(scene, config)
    return {**found, "wedges": len(wedges[0]), "planes": len(planes[0])}


def _demo() -> dict[str, int]:
    """A dataset of the demo scene, responses included."""
    config = ss.JobConfig(
        grid=ss.GridConfig(spacing=2.5, rays=100),
        simulation=ss.SimulationConfig(walks=64, duration=0.3),
        dataset=DatasetConfig(store="both", headings=(0.0,), rate=8000),
    )
    with tempfile.TemporaryDirectory() as folder:
        made = ss.build_dataset(ss.load_scene("demo"), folder, config, jobs=1)
        sizes = [path.stat().st_size for path in made.folder.rglob("*.h5")]
        return {"points": len(made.manifest.points), "bytes on disk": sum(sizes)}


def _without_patches() -> dict[str, int]:
    """All late sound by receiver volumes, with counts of reflections, in two tables of one way each."""
    config = ss.SimulationConfig(
        walks=160,
        duration=0.4,
        radiance_transfer=ss.RadianceTransferConfig(enabled=False),
        materials=MaterialsConfig(enabled=True),
    )
    scene, points = ss.load_scene("demo"), np.array([[2.4, 2.7, 1.5], [5.0, 6.5, 1.5], [1.2, 6.0, 1.5]])
    return _paths(ss.simulate(scene, points[:1], points[1:], config))


JOBS = {"box": _box, "two rooms": _two_rooms, "demo": _demo, "without patches": _without_patches}


def count_all() -> dict[str, dict[str, int]]:
    """Of each job. A process counts once: kernels are loaded when they are first called."""
    disk_cache._WORTH_S = math.inf  # whether something is kept must not depend on how long it takes
    os.environ["SOUNDSPACES_SIM_CACHE"] = tempfile.mkdtemp()  # where nothing is
    rays, made, found = _Rays(), Counter[str](), {}
    _count_bytes(made)
    set_thread_count(1)
    for name, job in JOBS.items():
        before = rays.total(), made["bytes of arrays"]
        with profiled("job") as profile:
            own = job()
        stage = profile.stage
        found[name] = {
            "rays": rays.total() - before[0],
            **{what: stage.counted(what) for what in ("deposits", "products")},
            "bytes of arrays": made["bytes of arrays"] - before[1],
            **own,
        }
    return {**found, "all": {"compiled kernels": _compiled()}}


if __name__ == "__main__":
    counts = json.dumps(count_all(), indent=2) + "\n"
    print(counts)
    if sys.argv[1:] == ["--store"]:
        STORED.write_text(counts)
