"""The documentation as a site: every page is in its menu, once, and shows what it should without the network."""

from __future__ import annotations

import ast
import builtins
import os
import re
import shlex
import subprocess
import sys
from html import unescape
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import unquote

import pytest
import typer
import yaml

from soundspaces_sim.cli import neighbours
from soundspaces_sim.cli.app import app
from soundspaces_sim.core.registry import installed_by_name

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
CONFIG = yaml.safe_load((ROOT / "mkdocs.yml").read_text("utf-8"))


def _pages(menu: Any) -> list[str]:
    """Files that a part of the menu leads to."""
    if isinstance(menu, str):
        return [menu]
    parts = menu.values() if isinstance(menu, dict) else menu
    return [page for part in parts for page in _pages(part)]


def test_every_page_is_in_the_menu_once() -> None:
    there = {p.relative_to(DOCS).as_posix() for kind in ("md", "ipynb") for p in DOCS.rglob(f"*.{kind}")}
    assert sorted(_pages(CONFIG["nav"])) == sorted(there)


def _commands(page: Path) -> list[list[str]]:
    """Words of each command of the package in a page's shell blocks, comments left out."""
    blocks = re.findall(r"```sh\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
    lines = [line.strip() for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    named = [shlex.split(x.removeprefix(".venv/bin/"), comments=True) for x in lines]
    return [words[1:] for words in named if words[:1] == ["soundspaces-sim"]]


@pytest.mark.usefixtures("neighbours_installed")
@pytest.mark.parametrize(
    "page", [p for p in (ROOT / "README.md", *sorted(DOCS.rglob("*.md"))) if _commands(p)], ids=lambda p: p.stem
)  # fmt: skip
def test_options_of_commands_in_pages_are_there(page: Path) -> None:
    for words in _commands(page):
        command: Any = typer.main.get_command(app)
        known = {option for p in command.params for option in (*p.opts, *p.secondary_opts)}
        for word in words:
            if not word.startswith("-") and hasattr(command, "commands"):
                assert word in command.commands, words
                neighbour = installed_by_name(neighbours.GROUP, word)
                command = (
                    command.commands[word] if neighbour is None else typer.main.get_command(neighbour)
                )
                known |= {option for p in command.params for option in (*p.opts, *p.secondary_opts)}
        assert not hasattr(command, "commands") or "--version" in words, words
        assert {w.partition("=")[0] for w in words if w.startswith("--")} <= known | {"--help"}, words


def test_extras_that_the_page_on_installing_names_are_those_there_are() -> None:
    import tomllib

    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"][
        "optional-dependencies"
    ]
    rows = re.findall(r"^\| (`.+?) \|", (DOCS / "install.md").read_text("utf-8"), re.MULTILINE)
    named = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    assert sorted(named) == sorted(extras)


def _documented() -> set[str]:
    """Dotted names that stand in a directive of the API page, members included."""
    names = set()
    text = (DOCS / "api.md").read_text("utf-8")
    for target, options in re.findall(r"^::: (\S+)\n((?: +.*\n)*)", text, re.MULTILINE):
        members = re.search(r"members: \[(.*)\]", options)
        names |= {f"{target}.{m.strip()}" for m in members[1].split(",")} if members else {target}
    return names


def _public() -> dict[str, str | None]:
    """Where every public name is defined, by the name as users have it; `errors` stands for what is in it."""
    out: dict[str, str | None] = {}
    for package in ("", ".nav"):
        stub = ROOT / "soundspaces_sim" / package.strip(".") / "__init__.pyi"
        for node in ast.parse(stub.read_text("utf-8")).body:
            if isinstance(node, ast.ImportFrom):
                out |= {
                    f"soundspaces_sim{package}.{a.name}": f"soundspaces_sim{package}.{node.module}.{a.name}"
                    for a in node.names
                }
    return out


def test_every_public_name_has_its_place_on_the_api_page() -> None:
    public, documented = _public(), _documented()
    assert len(public) > 80
    missing = [
        name
        for name, place in public.items()
        if (place or name) not in documented
        and not (place or "").startswith("soundspaces_sim.core.errors.")
    ]
    assert not missing, "add a ::: directive to docs/api.md"
    assert "soundspaces_sim.core.errors" in documented
    for name in documented:  # nothing is documented that is not there
        module, _, attribute = name.rpartition(".")
        path = ROOT / (module.replace(".", "/") + ".py")
        path = path if path.is_file() else ROOT / module.replace(".", "/") / "__init__.py"
        assert attribute == "errors" or re.search(rf"\b{attribute}\b", path.read_text("utf-8")), name


@pytest.mark.parametrize("page", sorted(p for p in DOCS.rglob("*.md") if "$$" in p.read_text("utf-8")))
def test_formulas_are_understood_and_numbered_once(page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(DOCS))
    import site_hooks  # type: ignore[import-not-found]

    text = page.read_text("utf-8")
    for latex in re.findall(r"\$\$\n(.*?)\n\$\$", text, re.DOTALL):
        assert "<math" in site_hooks._formula(latex, True)
    if page.name == "theory.md":
        numbers = [int(n) for n in re.findall(r"\\tag\{T(\d+)\}", text)]
        assert numbers == list(range(1, len(numbers) + 1)) and len(numbers) > 40
    with pytest.raises(ValueError, match="not understood"):
        site_hooks._formula(r"\nosuchcommand x", True)


def test_equations_that_are_cited_are_there() -> None:
    there = set(re.findall(r"\\tag\{(T\d+)\}", (DOCS / "theory.md").read_text("utf-8")))
    files = (*DOCS.rglob("*.md"), *(ROOT / "soundspaces_sim").rglob("*.py"))
    cited = {
        (file.name, n) for file in files for n in re.findall(r"\((T\d+)\)", file.read_text("utf-8"))
    }
    assert len(cited) > 20
    assert not {c for c in cited if c[1] not in there}


def test_the_diagram_of_rooms_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(DOCS))
    import site_hooks

    page = SimpleNamespace(file=SimpleNamespace(abs_src_path=str(DOCS / "architecture.md")))
    text = (DOCS / "architecture.md").read_text("utf-8")
    made = site_hooks.on_page_markdown(text, page)
    assert "```mermaid" in text and "mermaid" not in made and "flowchart" not in made
    assert made.count("<svg") == 1 and "\n\n" not in made[made.index("<svg") : made.index("</svg>")]
    assert "[Clusters](clusters.md)" in made  # links within the site stay
    assert "](../" not in made and "data_schema/" in made  # those out of it are text


def _dead_links(site: Path) -> list[tuple[str, str]]:
    """Links within a site that lead to no file, or to no place in it."""
    pages = {html: html.read_text("utf-8") for html in site.rglob("*.html") if html.name != "404.html"}
    places = {html: set(re.findall(r'\b(?:id|name)="([^"]+)"', text)) for html, text in pages.items()}
    dead = []
    for html, text in pages.items():
        for link in re.findall(r'<a\b[^>]*?\bhref="([^"]+)"', text):
            path, _, place = unquote(unescape(link)).partition("#")
            if re.match(r"[a-z]+:|//", path):
                continue
            target = (html.parent / path).resolve() if path else html
            target = target / "index.html" if target.is_dir() else target
            if not target.exists() or (place and place not in places.get(target, {place})):
                dead.append((html.relative_to(site).as_posix(), link))
    return dead


def test_the_site_builds(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="the extra 'docs' is not installed")
    pytest.importorskip("mkdocs_jupyter", reason="the extra 'docs' is not installed")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")],
        cwd=ROOT, capture_output=True, text=True, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    notebook = (tmp_path / "site" / "notebooks" / "1_first_rir" / "index.html").read_text("utf-8")
    assert "Out[1]" in notebook and "data:image/png;base64," in notebook  # with what it printed and drew
    api = (tmp_path / "site" / "api" / "index.html").read_text("utf-8")
    signatures = [
        re.sub(r"<[^>]+>", "", found)
        for found in re.findall(r'<div class="doc-signature highlight">(.*?)</div>', api, re.DOTALL)
    ]
    assert len(signatures) > 30
    assert max(len(line) for text in signatures for line in text.splitlines()) < 100  # none is cut off
    assert any(text.startswith("load_scene(\n    source: ") for text in signatures)
    theory = (tmp_path / "site" / "theory" / "index.html").read_text("utf-8")
    assert theory.count('class="equation" id="T') > 40 and "$$" not in theory
    assert _dead_links(tmp_path / "site") == []
    for html in (tmp_path / "site").rglob("*.html"):
        text = html.read_text("utf-8")
        assert not re.findall(r'<(?:script|img)[^>]+src="(?:https?:)?//', text), html
        assert not re.findall(r'<link[^>]+rel="stylesheet"[^>]+href="(?:https?:)?//', text), html


def _gallery_code(monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    monkeypatch.syspath_prepend(str(DOCS))
    import site_hooks

    page = SimpleNamespace(file=SimpleNamespace(abs_src_path=str(DOCS / "gallery.md")))
    made = site_hooks.on_page_markdown((DOCS / "gallery.md").read_text("utf-8"), page)
    return dict(re.findall(r"figures/gallery/(\w+)\.svg\).*?```python\n(.*?)```", made, re.DOTALL))


def test_code_of_the_gallery_stands_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every name that it uses is bound in it."""
    codes = _gallery_code(monkeypatch)
    assert set(codes) == {f.stem for f in (DOCS / "figures" / "gallery").glob("*.svg")}
    for name, code in codes.items():
        tree = ast.parse(code)
        names = [n for n in ast.walk(tree) if isinstance(n, ast.Name)]
        bound = {n.id for n in names if isinstance(n.ctx, ast.Store)} | set(dir(builtins))
        for node in ast.walk(tree):
            if isinstance(node, ast.Import | ast.ImportFrom):
                bound |= {(a.asname or a.name).partition(".")[0] for a in node.names}
            elif isinstance(node, ast.FunctionDef):
                bound |= {node.name, *(a.arg for a in node.args.args)}
        assert {n.id for n in names} <= bound, (name, {n.id for n in names} - bound)


@pytest.mark.slow
def test_code_of_the_gallery_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    codes = _gallery_code(monkeypatch)
    monkeypatch.chdir(tmp_path)
    for name, code in codes.items():
        exec(compile(code, name, "exec"), {"__name__": name})
        assert (tmp_path / f"{name}.pdf").stat().st_size > 2000


def test_tables_of_the_program_are_made_with_the_site(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages hold a mark where they go; the same file is not kept twice."""
    monkeypatch.syspath_prepend(str(DOCS))
    import site_hooks

    for name, row in (("settings", "| `walks` | not set |"), ("fields", "| `energy` |")):
        path = DOCS / f"{name}.md"
        text = path.read_text("utf-8")
        page = SimpleNamespace(file=SimpleNamespace(abs_src_path=str(path), src_uri=path.name))
        made = site_hooks.on_page_markdown(text, page)
        assert row not in text and row in made and "<!--" not in made


#: What strangers ask, by words of the question, and words of the answer where it is given.
_ASKED = {
    "use my own mesh": ("docs/scenes.md", "any mesh that trimesh reads"),
    "Which materials": ("materials/materials.toml", "[materials.carpet]"),
    "How long will my building take": ("docs/troubleshooting.md", "soundspaces-sim plan room.obj"),
    "How accurate is it": ("docs/validation.md", "## Known issues"),
    "numbers in the HDF5 files": ("docs/fields.md", "h5py.File"),
    "Levels look wrong": ("docs/troubleshooting.md", "## Levels look wrong"),
    "train with PyTorch": ("docs/training.md", "TorchRirDataset(scenes"),
    "use a GPU": ("docs/gpu.md", "It does not simulate rooms"),
    "my own HRTF": ("docs/rendering.md", "hrtf=ss.Ears("),
    "from habitat-sim": ("neighbours/rlr_audio_propagation/README.md", "habitat.attach"),
}


def _clicks(page: Path) -> set[Path]:
    """Files that links of a page lead to."""
    links = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text("utf-8"))
    return {(page.parent / link).resolve() for link in links if not re.match(r"[a-z]+:", link)}


@pytest.mark.parametrize("question", _ASKED)
def test_questions_of_strangers_are_answered_within_two_clicks(question: str) -> None:
    """The first leads from the README to the questions, the second to the answer."""
    name, words = _ASKED[question]
    answers = DOCS / "troubleshooting.md"
    assert answers in _clicks(ROOT / "README.md")
    rows = answers.read_text("utf-8").partition("## Questions")[2].partition("\n## ")[0].splitlines()
    (row,) = [row for row in rows if question in row]
    answer = (ROOT / name).resolve()
    assert answer in _clicks(answers) | {answers}
    assert (f"{Path(name).name}" in row or "(#" in row) and words in answer.read_text("utf-8")
