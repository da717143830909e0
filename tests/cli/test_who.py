"""What a dataset remembers of the command that made it: what was asked for, not who does it."""

from __future__ import annotations

import pytest

from soundspaces_sim.cli.simulation import _command


@pytest.mark.parametrize(
    ("typed", "kept"),
    [
        ("rirs demo --jobs 3 --spacing 1", "rirs demo --spacing 1"),
        ("rirs demo --engine dask --engine-option address=tcp://h:1 --walks 9", "rirs demo --walks 9"),
        ("rirs demo --tiles=3/40 --engine=slurm --out out", "rirs demo --out out"),
        ("rirs a b --jobs=2", "rirs a b"),
        ("rirs --profile a", "rirs a"),
    ],
)
def test_a_command_without_who_does_it(typed: str, kept: str) -> None:
    assert _command(typed.split()) == f"soundspaces-sim {kept}"
