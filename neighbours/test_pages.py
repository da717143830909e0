"""The Python on the neighbours' pages runs as printed."""

import importlib.util
import sys
from pathlib import Path

import pytest
import trimesh

from neighbours.rlr_audio_propagation.tests import habitat_stand_in
from tests.marks import ci_slow
from tests.test_readme import demo as demo
from tests.test_readme import few_walks as few_walks
from tests.test_readme import run_notebook, run_page

HERE = Path(__file__).resolve().parent
PAGES = sorted(
    page.relative_to(HERE).as_posix()
    for page in HERE.rglob("*.md")
    if "```python" in page.read_text("utf-8")
)


@pytest.mark.parametrize("page", PAGES)
def test_a_page_runs(page: str, demo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(demo)
    if page.startswith("rlr_"):  # an example is for users of habitat-sim
        trimesh.creation.box(bounds=[[-1.0, 0.0, -5.0], [6.0, 2.7, 1.0]]).export("apartment.glb")
        if importlib.util.find_spec("habitat_sim") is None:
            monkeypatch.setitem(sys.modules, "habitat_sim", habitat_stand_in)
    assert run_page(HERE / page) > 0


@pytest.mark.filterwarnings("ignore:.*non-interactive.*:UserWarning")
@pytest.mark.parametrize("notebook", sorted(HERE.rglob("*.ipynb")), ids=lambda p: p.stem)
@ci_slow
def test_a_notebook_runs(notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_notebook(notebook, tmp_path, monkeypatch)
