"""Compiling ahead compiles what jobs run."""

import subprocess
import sys

from soundspaces_sim.jobs import warm_up
from soundspaces_sim.transport.techniques import TECHNIQUES

# Kernels of the techniques that nothing has called when all shares have been run
_LEFT = """
from soundspaces_sim.jobs import warm_up
from soundspaces_sim.transport import techniques

for share in warm_up._SHARES:
    warm_up.compile_share(share)
for name, module in vars(techniques).items():
    for function in vars(module).values() if getattr(module, "__name__", "").startswith(techniques.__name__) else ():
        if hasattr(function, "signatures") and not function.targetoptions.get("no_cpython_wrapper"):
            print("called" if function.signatures else "left", name, function.py_func.__name__)
"""


def test_every_technique_has_a_share() -> None:
    names = [name for share in warm_up._SHARES for name in share]
    assert sorted(names) == sorted(t.name for t in TECHNIQUES)


def test_no_kernel_of_a_technique_is_left() -> None:
    """In a process of its own, where no other test has called one."""
    done = subprocess.run([sys.executable, "-c", _LEFT], capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    assert sum(line.startswith("called") for line in lines) > 10
    assert [line for line in lines if line.startswith("left")] == []
