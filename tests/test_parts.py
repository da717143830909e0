"""Neighbours are built on public names, which are there and say what they are."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path

import pytest

import soundspaces_sim as ss
from soundspaces_sim import echogram, nav, parts, rendering

ROOT = Path(__file__).resolve().parents[1]
SOURCES = sorted(ROOT.glob("neighbours/*/src/**/*.py"))
#: What a neighbour may import of the core, and the names there.
PUBLIC = {
    module.__name__: set(module.__all__) | {"__version__"}
    for module in (ss, echogram, nav, parts, rendering)
}


def _imported(file: Path) -> list[tuple[str, str]]:
    """(module, name) of all that a file imports of the core; the name is empty for a module as a whole."""
    found = []
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found += [(alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found += [(node.module or "", alias.name) for alias in node.names]
    return [(m, n) for m, n in found if m.partition(".")[0] == "soundspaces_sim"]


@pytest.mark.parametrize("file", SOURCES, ids=lambda f: str(f.relative_to(ROOT / "neighbours")))
def test_a_neighbour_imports_public_names_alone(file: Path) -> None:
    packages = {f"soundspaces_sim.{name.rpartition('.')[2]}" for name in PUBLIC} & set(PUBLIC)
    for module, name in _imported(file):
        assert module in PUBLIC, (
            f"{file.name}: {module} is not public; soundspaces_sim.parts may offer it"
        )
        whole = f"{module}.{name}" in packages
        assert not name or name in PUBLIC[module] or whole, f"{file.name}: {module} has no public {name}"


def test_every_part_is_there_is_documented_and_serves_a_neighbour() -> None:
    assert parts.__all__ == sorted(parts.__all__) and len(parts.__all__) > 50
    for name in parts.__all__:
        thing = getattr(parts, name)
        if inspect.isfunction(thing) or inspect.isclass(thing) or hasattr(thing, "py_func"):
            assert inspect.getdoc(thing), f"parts.{name} has no docstring"
    used = {name for file in SOURCES for module, name in _imported(file) if module == parts.__name__}
    assert used == set(parts.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        parts.nothing  # type: ignore[attr-defined]  # noqa: B018


def test_dir_shows_the_parts() -> None:
    assert dir(parts) == parts.__all__
