"""The hierarchy of rays compiles for GPUs: to PTX, which needs no GPU."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("numba_cuda", reason="numba-cuda is not installed")

from numba import cuda as gpu, types

from soundspaces_sim.scene.rays import hierarchy

cuda: Any = gpu
CC = (8, 0)


def _walk(box, link, corners, face, o, d, out):  # type: ignore[no-untyped-def]
    i = cuda.grid(1)
    if i < len(o):
        tree = hierarchy.Hierarchy(box, link, corners, face)
        origin, direction = (o[i, 0], o[i, 1], o[i, 2]), (d[i, 0], d[i, 1], d[i, 2])
        t, triangle = hierarchy.intersect(tree, origin, direction, np.inf)
        hit = hierarchy.occluded(tree, origin, direction, np.inf)
        out[i, 0], out[i, 1], out[i, 2] = t, triangle, 1.0 if hit else 0.0


@pytest.fixture(autouse=True)
def compilers() -> None:
    """Skip where CUDA's compilers are not installed, which numba-cuda[cu13] brings."""
    pathfinder: Any = pytest.importorskip("cuda.pathfinder", reason="numba-cuda is not installed")
    for library in ("nvvm", "nvrtc"):
        try:
            pathfinder.load_nvidia_dynamic_lib(library)
        except pathfinder.DynamicLibNotFoundError:
            pytest.skip(f"{library} of CUDA is not installed")


def test_rays_compile_to_ptx(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is left to a library, and nothing lies on a stack."""
    device = SimpleNamespace(
        compute_capability=CC
    )  # numba-cuda asks a GPU for it, for functions within kernels
    monkeypatch.setattr("numba.cuda.dispatcher.get_current_device", lambda: device)
    single, double, whole = types.float32[:, ::1], types.float64[:, ::1], types.int32
    arrays = (single, whole[:, ::1], double, whole[::1], double, double, double)
    ptx, _ = cuda.compile_ptx(_walk, types.void(*arrays), cc=CC)
    assert ".visible .entry" in ptx and ".target sm_80" in ptx
    assert not re.findall(r"^\s*\.extern", ptx, re.MULTILINE)
    assert ".local" not in ptx and "call" not in ptx
