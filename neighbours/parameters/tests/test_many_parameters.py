"""Parameters of many pairs: in processes as in this one, with progress."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from soundspaces_parameters import table

import soundspaces_sim as ss
from tests.command_line import run_command


def test_processes_give_what_threads_give(dataset_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with ss.open_dataset(dataset_folder) as ds:
        count = len(ds.points)
        pairs = [(s, l) for s in range(count) for l in range(count) if s != l][:40]
        alone = ds.parameters(pairs=pairs)
        told: list[tuple[int, int]] = []
        monkeypatch.setattr(table, "_MANY", 1)
        together = ds.parameters(pairs=pairs, progress=lambda done, of: told.append((done, of)))
    for name, values in alone.values.items():
        np.testing.assert_array_equal(values, together.values[name], err_msg=name)
    assert told[-1] == (len(pairs), len(pairs)) and told == sorted(told)


def test_the_command_says_what_it_is_at(
    dataset_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ended = run_command("parameters", str(dataset_folder), "--source", "0", cwd=tmp_path)
    assert ended.returncode == 0
    assert "Parameters of" in ended.stderr + capsys.readouterr().err
