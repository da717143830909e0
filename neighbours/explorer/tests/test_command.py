"""`soundspaces-explorer`."""

from __future__ import annotations

from pathlib import Path

import pytest
from soundspaces_explorer.__main__ import app
from typer.testing import CliRunner

import soundspaces_sim as ss


def test_a_copy_is_written_and_not_over_what_is_there(dataset_folder: Path, tmp_path: Path) -> None:
    arguments = [str(dataset_folder), "--export", str(tmp_path / "out"), "--points", "1"]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0 and (tmp_path / "out" / "index.html").is_file(), done.output
    again = CliRunner().invoke(app, arguments)
    assert isinstance(again.exception, ss.ConfigError)
    with pytest.raises(ss.ConfigError, match="dataset"):
        raise CliRunner().invoke(app, [*arguments[:2], str(dataset_folder)]).exception or AssertionError
