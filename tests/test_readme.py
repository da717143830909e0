"""The Python of the README and of the documentation runs as printed."""

import gc
import json
import re
import shlex
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
import trimesh
import yaml
from msgspec import structs
from typer.testing import CliRunner

import soundspaces_sim as ss
from soundspaces_sim.build import job_file, prepare
from soundspaces_sim.cli.app import app
from soundspaces_sim.transport import simulate
from soundspaces_sim.transport.model import Model
from tests.conftest import energy
from tests.marks import CI_SLOW, ci_slow

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"


def blocks_of(page: Path, language: str = "python") -> list[str]:
    """Code of a page in a language."""
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


#: Every block of Python of the documentation: page and number.
BLOCKS = [
    (p.relative_to(DOCS).as_posix(), k)
    for p in sorted(DOCS.rglob("*.md"))
    for k in range(len(blocks_of(p)))
]
#: Pages of the site's menu under "Use", and the README.
USE = [
    ROOT / "README.md",
    *(
        DOCS / page
        for group in yaml.safe_load((ROOT / "mkdocs.yml").read_text("utf-8"))["nav"]
        for page in group.get("Use", ())
        if isinstance(page, str)
    ),
]


_FEW = 400  # subpaths; texts that ask for more have 64
PLAIN: dict[str, Any] = {
    "radiance_transfer": ss.RadianceTransferConfig(enabled=False),
    "diffraction": ss.DiffractionConfig(enabled=False),
}


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
                walks=config.walks if config.walks and config.walks <= _FEW else 64,
                connections=ss.ConnectionsConfig(subpaths=8),
                **PLAIN,
                target_error=None if config.target_error is None else 1.0,
            )
            return make_model(scene, points, few, seed)

        monkeypatch.setattr(module, "make_model", quicker)


def quick(walks: int = 64, duration: float = 0.3, **more: Any) -> ss.SimulationConfig:
    connections = ss.ConnectionsConfig(subpaths=8)
    return ss.SimulationConfig(walks=walks, duration=duration, connections=connections, **more)


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with out/demo in it, of few points and subpaths."""
    folder = tmp_path_factory.mktemp("docs")
    config = ss.JobConfig(
        grid=ss.GridConfig(spacing=1.0, rays=200),
        simulation=quick(walks=_FEW, **PLAIN),  # enough to tell which ear is louder
    )
    scene = ss.load_scene("demo")
    points = ss.make_grid(scene, 1.0).points[:13]  # the texts speak of these
    ss.build_dataset(scene, folder / "out", config, points=points)
    return folder


def run_page(page: Path) -> int:
    """Run a page's blocks of Python, each on its own; how many there are."""
    blocks = blocks_of(page)
    for block in blocks:
        run_block(block)
    return len(blocks)


def run_block(code: str) -> None:
    """Run a block, or skip the test where it wants PyTorch and there is none."""
    if re.search(r"^(?:import|from) \S*torch", code, re.MULTILINE):
        pytest.importorskip("torch", reason="the extra `torch` is not installed")
    exec(code, {"__name__": "example"})
    gc.collect()  # datasets that it left open: HDF5 opens no file a second time with other locking


@pytest.mark.parametrize(("page", "number"), BLOCKS)
def test_documentation_runs(
    page: str, number: int, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = blocks_of(DOCS / page)[number]
    monkeypatch.chdir(request.getfixturevalue("walls"))
    run_block(code)


_TOML = [
    (p.relative_to(DOCS).as_posix(), k)
    for p in sorted(DOCS.rglob("*.md"))
    for k in range(len(blocks_of(p, "toml")))
]


@pytest.mark.parametrize(("page", "number"), _TOML)
def test_toml_of_a_page_is_read(page: str, number: int, tmp_path: Path) -> None:
    """As settings of a job or, where it has materials, by both options that take such a file."""
    text = blocks_of(DOCS / page, "toml")[number]
    file = tmp_path / "mine.toml"
    file.write_text(text, "utf-8")
    if "[materials." not in text:
        assert ss.load_config(file) != ss.JobConfig()
        return
    trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [4.0, 3.0, 2.5]]).export(tmp_path / "room.obj")
    scene = ss.load_scene(tmp_path / "room.obj", materials=file, labels=file)
    (name,) = re.findall(r"\[materials\.(.*)\]", text)
    assert name in scene.materials.names


@pytest.mark.parametrize("page", USE, ids=lambda p: p.stem)
def test_code_is_in_blocks_that_are_run(page: Path) -> None:
    """None of it is merely indented, which nothing runs."""
    text = re.sub(r"```.*?```", "", page.read_text("utf-8"), flags=re.DOTALL)
    indented = re.findall(r"\n\n    (\S.*)", text)
    assert [
        line for line in indented if re.search(r"^(?:import|from|\w+ = |ds\.|ss\.|soundspaces)", line)
    ] == []


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
    (shown,) = re.findall(r"([\d.]+) MB in out/demo", text)
    size = sum(e.bytes for e in ds.manifest.shards) / 1e6
    assert float(shown) == pytest.approx(size, rel=0.1)
    stated = re.search(
        r"energy up to 80 ms is ([\d.]+) % in the median and ([\d.]+) % at the 85th percentile \(unknown for "
        r"([\d.]+) % of the pairs\), that of later energy ([\d.]+) % in the median and ([\d.]+) % at the 85th",
        " ".join(text.split()),
    )
    assert stated is not None
    early, late = (np.stack([table[f"{w}_error_{b}"] for b in range(4)]) for w in ("early", "late"))
    assert not np.isnan(early).any() and not np.isnan(late).any()
    found = [
        np.quantile(early, 0.5, axis=1, method="higher").max(),
        np.quantile(early, 0.85, axis=1, method="higher").max(),
        np.isinf(early).mean(axis=1).max(),
        np.quantile(late, 0.5, axis=1, method="higher").max(),
        np.quantile(late, 0.85, axis=1, method="higher").max(),
    ]
    print([f"{100.0 * x:.3g}" for x in found])
    for figure, worst in zip(stated.groups(), found, strict=True):
        assert float(figure) == pytest.approx(100.0 * worst, rel=0.2)


def test_the_readme_runs_prints_what_it_shows_and_left_is_left(
    demo: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(demo)
    assert run_page(ROOT / "README.md") == 1
    (shown,) = re.findall(r"  # (0°: .*)", (ROOT / "README.md").read_text("utf-8"))
    printed = capsys.readouterr().out.strip().splitlines()
    assert re.sub(r"\d+ dB", "# dB", ", ".join(printed)) == re.sub(r"\d+ dB", "# dB", shown)
    ds = ss.open_dataset("out/demo")
    offset = ds.points[3] - ds.points[0]
    np.testing.assert_allclose(offset, [0.0, 3.0, 0.0], atol=1e-6)
    assert ds.echogram(3, 0).visible
    for heading, louder in ((0, 0), (180, 1)):
        ears, rate = soundfile.read(demo / f"heading_{heading}.wav")
        assert rate == 44100 and ears.shape[1] == 2
        assert energy(ears.T)[louder] > 1.1 * energy(ears.T)[1 - louder]


def _rows(page: str) -> list[str]:
    """The code of each row of a page's table of wishes."""
    table = (ROOT / page).read_text("utf-8").split("## I want to …")[1]
    return [row.split("|")[2].strip() for row in re.findall(r"^\| .* \|$", table, re.MULTILINE)[1:]]


def _cells(rows: list[str]) -> list[str]:
    return [cell for row in rows for cell in re.findall(r"`([^`]+)`", row)]


#: The page has all of them, the README those that people come for.
_ROWS = _rows("docs/index.md")
CELLS = _cells(_ROWS)
#: What a row leaves to its reader.
_FILLED = {
    "ss.Talker(…)": "ss.Talker(heading_deg=90.0)",
    'ss.Ears("mine.sofa")': "ss.Ears(mine)",
    "ss.MicrophoneArray(…)": "ss.MicrophoneArray(np.zeros((1, 3)))",
}


def _is(*beginnings: str) -> list[str]:
    return [cell for cell in CELLS if cell.startswith(beginnings)]


@pytest.fixture(scope="module")
def walls(demo: Path) -> Path:
    """The folder of `demo` with out/walls/demo in it, whose materials may change."""
    # of 64 subpaths too little is known of what a wall takes: it is refused
    config = ss.JobConfig(simulation=quick(256, materials=ss.MaterialsConfig(enabled=True)))
    scene = ss.load_scene("demo")
    ss.build_dataset(scene, demo / "out" / "walls", config, points=ss.make_grid(scene, 1.0).points[:6])
    return demo


@pytest.mark.parametrize("cell", _is("ss.", "ds.", "Torch", "gymnasium."))
def test_python_of_a_row_runs(cell: str, walls: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(walls)
    names: dict[str, object] = {"ss": ss, "np": np, "s": 0, "l": 1}
    if cell.startswith("Torch"):
        pytest.importorskip("torch", reason="the extra `torch` is not installed")
        from soundspaces_torch.dataset import TorchRirDataset

        names["TorchRirDataset"] = TorchRirDataset
    if cell.startswith("gymnasium"):
        names["gymnasium"] = pytest.importorskip("gymnasium", reason="the extra `nav` is not installed")
        import soundspaces_sim.nav  # noqa: F401 - registers the environments
    if "scene" in cell or "sources" in cell:
        names |= {
            "scene": ss.load_scene("demo"),
            "sources": [[2.0, 2.0, 1.5]],
            "listeners": [[3.0, 2.0, 1.5]],
        }
    names["mine"] = ROOT / "soundspaces_sim" / "rendering" / "hrtf_data" / "mit_kemar.sofa"
    with ss.open_dataset("out/demo") as ds:
        made = eval(_FILLED.get(cell, cell), {**names, "ds": ds})
        assert made is not None
    if "materials=" in cell:  # what is opened can be read throughout
        assert len(made.table()) == 30 and np.isfinite(made.binaural(0, 1)).all()


def _shell_lines() -> list[str]:
    """Of pages on use, without comments; a line that goes on is one."""
    blocks = [block for page in USE for block in blocks_of(page, "sh")]
    lines = [
        line.partition(" #")[0].strip()
        for block in blocks
        for line in block.replace("\\\n", " ").splitlines()
    ]
    return sorted({" ".join(line.removeprefix(".venv/bin/").split()) for line in lines if line})


#: Beginnings of lines that no test runs, and why. Options of all are looked up in `test_site.py`.
_LEFT = {
    "python -m pip install -e": "installs: `make` does, on every submission",
    "soundspaces-sim plan": "measures time for half a minute: tests/build/test_estimate.py",
    "soundspaces-sim rirs scans/": "a folder of scans: tests/cli and tests/build/test_engines.py",
    "soundspaces-sim rirs /data/scans": "a cluster: tests/build/test_engines.py, test_cluster_faults.py",
    "soundspaces-sim rirs demo --engine": "a cluster: the same",
    "soundspaces-sim finish": "ends a job of several machines: tests/build/test_engines.py",
    "dask ": "a cluster",
    "i=0; for host": "machines of the reader's", "ssh ": "the same", "done; wait": "the same",
}  # fmt: skip
#: Commands of neighbours, whose own tests are quick too.
_BESIDE = tuple(f"soundspaces-sim {name} " for name in ("cite", "parameters", "plot", "report"))
_SHELL = _shell_lines()
_RUN = sorted(
    {
        line.replace("path/to/scene", "room.obj")
        for line in (*_SHELL, *_is("soundspaces-sim "))
        if not line.startswith((*_LEFT, "make "))
    }
)


def test_every_shell_line_is_run_or_left_for_a_reason() -> None:
    assert len(_RUN) > 12
    assert all(line.startswith("soundspaces-sim ") for line in _RUN)
    assert [beginning for beginning in _LEFT if not any(x.startswith(beginning) for x in _SHELL)] == []


@pytest.mark.usefixtures("neighbours_installed")
@pytest.mark.parametrize(
    "line", [pytest.param(x, marks=CI_SLOW if x.startswith(_BESIDE) else ()) for x in _RUN]
)
def test_a_shell_line_runs(line: str, demo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(demo)
    trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [4.0, 3.0, 2.5]]).export("room.obj")
    words = shlex.split(line)[1:]
    if words[0] in ("plot", "table", "report"):
        words.append("--replace")
    if words[:2] == ["rirs", "demo"]:
        words += ["--spacing", "4", "--out", f"small_{_RUN.index(line)}"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, (done.output, done.exception)
    assert done.output.strip()


@pytest.mark.parametrize("line", [line for line in _SHELL if line.startswith("make ")])
def test_a_line_of_make_has_its_target(line: str) -> None:
    done = subprocess.run(
        ["make", "-n", *shlex.split(line)[1:]], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("cell", _is("make ", ".venv/bin/pip "))
def test_what_a_row_makes_or_installs_is_there(cell: str) -> None:
    words = shlex.split(cell)
    if words[0] == "make":
        done = subprocess.run(["make", "-n", *words[1:]], cwd=ROOT, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return
    folders = [ROOT / word for word in words if word.startswith("./")]
    assert folders and all((folder / "pyproject.toml").is_file() for folder in folders)


def test_the_readme_has_rows_of_the_page() -> None:
    assert len(_rows("README.md")) > 4 and set(_cells(_rows("README.md"))) < set(CELLS)


def test_every_code_of_the_rows_is_tried() -> None:
    tried = _is("ss.", "ds.", "Torch", "gymnasium.", "soundspaces-sim ", "make ", ".venv/bin/pip ")
    assert len(tried) > 25
    assert set(CELLS) - set(tried) == {
        "soundspaces-calibrate room.obj --measured parameters.csv",
        "soundspaces-tasks out/collection",
        "soundspaces_rlr.habitat.attach(sim, spec)",
    }  # of neighbours: their tests run them
