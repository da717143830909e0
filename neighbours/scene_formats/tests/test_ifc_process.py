"""The process that reads an IFC model has limits of time and memory; a stand-in plays ifcopenshell."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from soundspaces_scene_formats import ifc

import soundspaces_sim as ss
from soundspaces_sim.core.errors import SceneError
from tests.build.test_isolation import check_isolated


@pytest.mark.parametrize(
    ("does", "seconds", "message"),
    [("while True: pass", 2, "in 2 s|signal"), ("bytearray(2**40)", 60, "MemoryError")],
)
def test_it_ends(
    does: str, seconds: int, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ifcopenshell.py").write_text(does)
    (tmp_path / "a.ifc").write_text("ISO-10303-21;")
    monkeypatch.syspath_prepend(tmp_path)
    roots = (Path(ss.__file__).parents[1], Path(ifc.__file__).parents[1], tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(map(str, roots)))
    monkeypatch.setattr(ifc, "_SECONDS", seconds)
    with pytest.raises(SceneError, match=rf"a\.ifc: cannot be read as an IFC model.*({message})"):
        ifc.read_ifc(str(tmp_path / "a.ifc"))


def test_a_stranger_s_module_is_not_run(tmp_path: Path) -> None:
    code = """
import soundspaces_sim as ss
from soundspaces_sim.core.errors import SceneError
from soundspaces_scene_formats.ifc import read_ifc
Path("a.ifc").write_text("ISO-10303-21;")
try:
    read_ifc("a.ifc")
except SceneError as error:
    assert "this ifcopenshell" in str(error), error
"""
    check_isolated(code, tmp_path, Path(ifc.__file__).parents[1])
