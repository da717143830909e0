"""For what machine code is generated here: the last digits of a job's results depend on it.

Kernels are compiled for the CPU that runs them, with fused multiply-adds and sums as wide as its registers;
Embree and NumPy choose among their own versions by its instructions. So two machines that differ in these give
echograms that differ by some 1e-7, and a dataset made by both would have bytes that none of them makes alone.
"""

from __future__ import annotations

import platform
from functools import cache

import llvmlite.binding
import numba

from soundspaces_sim.core.embree_library import ray_engine

# Instructions that change how sums and products are rounded, or how many are taken at once.
_MATTER = ("sse4.2", "avx", "avx2", "fma", "avx512f", "avx512vl", "neon", "sve", "sve2")


@cache
def code_target() -> str:
    """As ``x86_64 sapphirerapids avx avx2 fma``: architecture, the CPU that Numba compiles for (its
    NUMBA_CPU_NAME, else this one, with NUMBA_CPU_FEATURES), those instructions of this one that matter, and who
    casts rays if it is not Embree.
    """
    host = llvmlite.binding.get_host_cpu_features()
    name = numba.config.CPU_NAME or llvmlite.binding.get_host_cpu_name()  # type: ignore[attr-defined]
    features = numba.config.CPU_FEATURES or ""  # type: ignore[attr-defined]
    rays = () if ray_engine() == "embree" else (f"rays-by-{ray_engine()}",)
    found = [f for f in _MATTER if host.get(f)]
    return " ".join([platform.machine(), name, *found, *features.split(), *rays])
