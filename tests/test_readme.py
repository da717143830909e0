"""The Python of the README and of the documentation runs as printed."""

import gc
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import soundfile
from msgspec import structs

import soundspaces_sim as ss
from soundspaces_sim.build import job_file, prepare
from soundspaces_sim.transport import simulate
from soundspaces_sim.transport.model import Model
from tests.conftest import energy
from tests.marks import ci_slow

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(
    p.relative_to(ROOT / "docs").as_posix()
    for p in (ROOT / "docs").rglob("*.md")
    if "```python" in p.read_text("utf-8")
)


@pytest.fixture(autouse=True)
def few_walks(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Whatever a text asks for: it is what it calls that is tested, not what it hears."""
    if "slow" in request.keywords:
        return
    for module in (simulate, prepare, job_file):
        make_model = module.make_model

        def quicker(
            scene: ss.Scene, points: np.ndarray, config: ss.SimulationConfig | None = None, seed: int = 0,
            make_model: Callable[..., Model] = make_model,
        ) -> Model:  # fmt: skip
            config = config or ss.SimulationConfig()
            few = structs.replace(
                config,
                walks=min(config.walks, 64),
                connections=ss.ConnectionsConfig(subpaths=8),
                radiance_transfer=ss.RadianceTransferConfig(enabled=False),
                diffraction=ss.DiffractionConfig(enabled=False),
                target_error=None if config.target_error is None else 1.0,
            )
            return make_model(scene, points, few, seed)

        monkeypatch.setattr(module, "make_model", quicker)


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with out/demo in it, of few points and subpaths."""
    folder = tmp_path_factory.mktemp("docs")
    config = ss.JobConfig(
        grid=ss.GridConfig(spacing=1.0, rays=200),
        simulation=ss.SimulationConfig(
            walks=64,
            connections=ss.ConnectionsConfig(subpaths=8),
            duration=0.3,
            radiance_transfer=ss.RadianceTransferConfig(enabled=False),
            diffraction=ss.DiffractionConfig(enabled=False),
        ),
    )
    scene = ss.load_scene("demo")
    points = ss.make_grid(scene, 1.0).points[:20]  # the texts speak of these
    ss.build_dataset(scene, folder / "out", config, points=points)
    return folder


def run_page(page: Path) -> int:
    """Run a page's blocks of Python, each on its own; how many there are."""
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    for block in blocks:
        exec(block, {"__name__": "example"})
        gc.collect()  # datasets that it left open: HDF5 opens no file a second time with other locking
    return len(blocks)


@pytest.mark.parametrize("page", PAGES)
def test_documentation_runs(page: str, demo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(demo)
    assert run_page(ROOT / "docs" / page) > 0


@pytest.mark.filterwarnings("ignore:.*non-interactive.*:UserWarning")
@pytest.mark.parametrize(
    "notebook", sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")), ids=lambda p: p.stem
)
@ci_slow
def test_notebooks_run(notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_notebook(notebook, tmp_path, monkeypatch)


def run_notebook(notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All cells in order, in one namespace; what they print is not compared."""
    import matplotlib.pyplot as plt

    monkeypatch.chdir(tmp_path)
    plt.switch_backend("Agg")
    cells = json.loads(notebook.read_text("utf-8"))["cells"]
    scope: dict[str, object] = {"__name__": "notebook"}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), scope)
            assert cell["execution_count"], "the notebook is committed with its output"
    plt.close("all")


@pytest.mark.slow
def test_the_readmes_numbers_are_those_of_the_demo(tmp_path: Path) -> None:
    """Made as README says: errors within a fifth of those it states, size within a tenth."""
    text = (ROOT / "README.md").read_text("utf-8")
    config = structs.replace(ss.JobConfig(), grid=ss.GridConfig(spacing=1.0))
    folder = ss.build_dataset("demo", tmp_path, config).folder
    with ss.open_dataset(folder) as ds:
        table = ds.table()
        assert f"{len(ds):,} responses" in text
    (shown,) = re.findall(r"44,100 Hz, ([\d.]+) MB", text)
    size = sum(e.bytes for e in ds.manifest.shards) / 1e6
    assert float(shown) == pytest.approx(size, rel=0.1)
    stated = re.search(
        r"energy up to 80 ms is\s+([\d.]+) % in the median and ([\d.]+) % at the 95th percentile; of later energy, "
        r"([\d.]+) % and ([\d.]+) %",
        text,
    )
    assert stated is not None
    for window, figures in (("early", stated.groups()[:2]), ("late", stated.groups()[2:])):
        errors = np.stack([table[f"{window}_error_{b}"] for b in range(4)])
        for share, figure in zip((0.5, 0.95), figures, strict=True):
            worst = 100.0 * np.nanquantile(errors, share, axis=1).max()
            assert float(figure) == pytest.approx(worst, rel=0.2)


def _without_numbers(text: str) -> list[str]:
    return re.sub(r"\d[\d.,]*", "#", text).strip().splitlines()


def test_the_readme_runs_prints_what_it_shows_and_left_is_left(
    demo: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(demo)
    assert run_page(ROOT / "README.md") == 1
    (shown,) = re.findall(r"```text\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL)
    assert _without_numbers(capsys.readouterr().out) == _without_numbers(shown)
    ds = ss.open_dataset("out/demo")
    offset = ds.points[3] - ds.points[0]
    np.testing.assert_allclose(offset, [0.0, 3.0, 0.0], atol=1e-6)
    assert ds.echogram(3, 0).visible
    for heading, louder in ((0, 0), (180, 1)):
        ears, rate = soundfile.read(demo / f"heading_{heading}.wav")
        assert rate == 44100 and ears.shape[1] == 2
        assert energy(ears.T)[louder] > 1.1 * energy(ears.T)[1 - louder]
