"""The Python on the neighbours' pages runs as printed."""

import importlib.util
import sys
from pathlib import Path

import pytest
import trimesh

import soundspaces_sim as ss
from neighbours.rlr_audio_propagation.tests import habitat_stand_in
from tests.marks import ci_slow
from tests.test_readme import (
    PLAIN,
    blocks_of,
    demo as demo,
    few_walks as few_walks,
    quick,
    run_block,
    run_notebook,
    walls as walls,
)

HERE = Path(__file__).resolve().parent
#: Every block of Python of the pages: page and number.
BLOCKS = [
    (page.relative_to(HERE).as_posix(), k)
    for page in sorted(HERE.rglob("*.md"))
    for k in range(len(blocks_of(page)))
]


@pytest.fixture(scope="module")
def waves(demo: Path) -> Path:
    """The folder of `demo` with out/waves/demo in it, of waves below 90 Hz."""
    low = ss.LowConfig(method="waves", edge=90.0)
    config = ss.JobConfig(simulation=quick(duration=0.2, low=low, **PLAIN))
    scene = ss.load_scene("demo")
    ss.build_dataset(scene, demo / "out" / "waves", config, points=ss.make_grid(scene, 1.0).points[:4])
    return demo


@pytest.mark.parametrize(("page", "number"), BLOCKS)
def test_a_page_runs(
    page: str, number: int, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = blocks_of(HERE / page)[number]
    wanted = next((name for name in ("waves", "walls") if f"out/{name}" in code), "demo")
    monkeypatch.chdir(request.getfixturevalue(wanted))
    if page.startswith("rlr_"):  # an example is for users of habitat-sim
        trimesh.creation.box(bounds=[[-1.0, 0.0, -5.0], [6.0, 2.7, 1.0]]).export("apartment.glb")
        if importlib.util.find_spec("habitat_sim") is None:
            monkeypatch.setitem(sys.modules, "habitat_sim", habitat_stand_in)
    run_block(code)


@pytest.mark.filterwarnings("ignore:.*non-interactive.*:UserWarning")
@pytest.mark.parametrize("notebook", sorted(HERE.rglob("*.ipynb")), ids=lambda p: p.stem)
@ci_slow
def test_a_notebook_runs(notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_notebook(notebook, tmp_path, monkeypatch)
