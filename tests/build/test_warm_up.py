"""Compiling ahead compiles what jobs run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from soundspaces_sim.build import warm_up
from soundspaces_sim.transport.techniques import TECHNIQUES
from tests.marks import ci_slow

# Kernels of the tracer that nothing has called when all shares have been run
_LEFT = """
import sys
from soundspaces_sim.build import warm_up

for share in warm_up.shares_for(3):
    warm_up.compile_share(share)
for name, module in sorted(sys.modules.items()):
    for function in vars(module).values() if name.startswith("soundspaces_sim.transport.") else ():
        own = hasattr(function, "signatures") and function.py_func.__module__ == name
        if own and not function.targetoptions.get("no_cpython_wrapper"):
            print("called" if function.signatures else "left", name, function.py_func.__name__)
"""
# What the job's own process compiles meanwhile, for its plan, what only scans need, and what is off by default
_ELSEWHERE = (
    "soundspaces_sim.transport.arrivals.plane_edges ",
    "soundspaces_sim.transport.arrivals.specular_planes _turn",
    "soundspaces_sim.transport.paths.decay ",
    "soundspaces_sim.transport.radiance_transfer.derivative ",
    "soundspaces_sim.transport.reflection_counts.",
)


class _Child:
    """Has ended or not; has no output of its own."""

    stdout = stderr = None
    returncode = 0

    def __init__(self, asked: int) -> None:
        self.asked = asked

    def poll(self) -> int | None:
        self.asked -= 1
        return None if self.asked >= 0 else 0


def test_the_share_of_compiling_that_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """It begins at nothing when the wait begins, and goes by the child that is furthest behind: that one has spent
    .3 of its time at first, then .7, so that 4/7 of the wait are over."""
    half, tenths = warm_up.WarmUp.__new__(warm_up.WarmUp), [*warm_up.TENTHS.values()]
    half._shares = warm_up.shares_for(2)
    half._children = [_Child(10**6), _Child(10**6)]  # type: ignore[list-item]
    half._compiled = [tenths[0][5], tenths[1][3]]
    told: list[tuple[int, int]] = []

    class _EndError(Exception):
        pass

    def wait(_: float) -> None:
        half._compiled = [tenths[0][9], tenths[1][7]]
        if len(told) == 2:
            raise _EndError
        raise subprocess.TimeoutExpired("", 0.0)

    monkeypatch.setattr(_Child, "wait", lambda _self, seconds: wait(seconds), raising=False)
    half._readers = [None, None]  # type: ignore[list-item]
    with pytest.raises(_EndError):
        half.wait(lambda done, total: told.append((done, total)))
    assert told == [(0, 1000), (571, 1000)]
    assert warm_up.share_of_time(10**6, tenths[0]) == 0.99


@pytest.mark.slow
def test_as_many_functions_are_compiled_as_the_progress_takes_for_granted(tmp_path: Path) -> None:
    """Some minutes: all is compiled anew. Beyond a tenth more or fewer, measure `TENTHS` again."""
    for share, tenths in warm_up.TENTHS.items():
        done = subprocess.run(
            [sys.executable, "-m", "soundspaces_sim.build.warm_up", *share],
            capture_output=True, text=True, check=True,
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / '-'.join(share))},
        )  # fmt: skip
        assert len(done.stdout.splitlines()) == pytest.approx(tenths[-1], rel=0.1)


@pytest.mark.parametrize("soon", [False, True])
@pytest.mark.parametrize("cores", [1, 2, 3, 16, 256])
def test_every_technique_has_a_share(cores: int, soon: bool) -> None:
    shares = warm_up.shares_for(cores, soon)
    names = [name for share in shares for name in share]
    assert {*names} - {"then"} == {"duration", "echograms", *(t.name for t in TECHNIQUES)}
    assert soon or len(names) == len({*names})
    assert all(share in warm_up.TENTHS for share in shares)


@pytest.mark.parametrize("cores", [2, 3])
def test_a_first_sound_waits_for_neither_arrivals_nor_radiance_transfer(cores: int) -> None:
    first = {name for share in warm_up.shares_for(cores, True) for name in warm_up._rounds(share)[0]}
    assert {"specular", "receiver_volumes", "connections", "echograms"} <= first
    assert "radiance_transfer" not in first
    waited = [share for share in warm_up.shares_for(cores, True) if share != warm_up._LAST]
    assert all("arrivals" not in warm_up._rounds(share)[0] for share in waited)


def test_children_tell_when_the_first_round_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    """And `wait_for_first` returns though one of them goes on."""
    code = "import sys; print('f'); print('then', flush=True); sys.stdin.read()"

    def child(_: object) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-c", code], text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip

    monkeypatch.setattr(warm_up, "_child", child)
    compiling = warm_up.WarmUp(soon=True)
    compiling.wait_for_first()
    assert all(child.poll() is None for child in compiling._children)
    assert all(n <= 1 for n in compiling._compiled)
    for one in compiling._children:
        assert one.stdin is not None
        one.stdin.close()
    compiling.stop()


@ci_slow  # simulates by all techniques for itself; what is left is compiled later all the same
def test_no_kernel_is_left(tmp_path: Path) -> None:
    """In a process of its own, where no other test has called one, and without what others have prepared."""
    env = {**os.environ, "SOUNDSPACES_SIM_CACHE": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", _LEFT], capture_output=True, text=True, check=True, env=env
    )
    lines = done.stdout.splitlines()
    assert sum(line.startswith("called") for line in lines) >= 20
    left = [line.removeprefix("left ") for line in lines if line.startswith("left ")]
    assert [line for line in left if not line.startswith(_ELSEWHERE)] == []
