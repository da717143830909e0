"""Counts of the code's structure, held against its aims: `python -m tests.architecture [ROOM]`.

Rooms are the packages at the top (`core`, `scene`, …, with `benchmarks` and `pipelines`); a room's floor is one
above the highest that it imports; an arrow is a pair of rooms of which one imports the other, at module level
or within a function. A module that a function names in a string (`load("package.module:name")`,
`import_module`) counts as one that it imports; entries of registries, which users choose by name, do not.
Kernels are functions under `@kernel`, `@part` or Numba's own decorators.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import networkx as nx

ROOT = Path(__file__).resolve().parents[1]
_TOPS = ("soundspaces_sim", "benchmarks", "pipelines")
_IMPORTERS = {"importlib": "import_module", "soundspaces_sim.core.registry": "load"}
_COMPILED = {"kernel", "part", "njit", "jit", "intrinsic"}
_BY_NAME = ("soundspaces_sim.core.registry",)  # where entries of registries are imported
MOST_ARGUMENTS, MOST_LINES, MOST_FUNCTION_LINES = 8, 350, 60


@dataclass(frozen=True)
class Import:
    """`module` imports `target`; `deferred`: within a function; `typing`: for type checkers alone."""

    module: str
    target: str
    deferred: bool
    typing: bool


@dataclass(frozen=True)
class Kernel:
    where: str
    arguments: int
    bare: int  # arguments without an annotation


@dataclass
class Counts:
    imports: list[Import] = field(default_factory=list)
    kernels: list[Kernel] = field(default_factory=list)
    skips: list[str] = field(default_factory=list)
    long_files: list[str] = field(default_factory=list)
    long_functions: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Row:
    """One count: its aim (at most), its value, and where it comes from."""

    what: str
    aim: int
    value: int
    found: list[str]


@cache
def modules() -> dict[str, Path]:
    """Every module of the project by its dotted name."""
    found = {}
    for top in _TOPS:
        for path in sorted((ROOT / top).rglob("*.py")):
            if "distribution" in path.parts:
                continue  # a distribution of its own
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def _targets(node: ast.Import | ast.ImportFrom) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (name.name for name in node.names if name.name in modules())
    elif node.level == 0 and node.module:
        for name in node.names:
            full = f"{node.module}.{name.name}"
            if full in modules():
                yield full
            elif node.module in modules():
                yield node.module


def importers_of(tree: ast.AST) -> set[str]:
    """What functions that import by name are called in a module."""
    found = {"__import__", "import_module"}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            own = _IMPORTERS.get(node.module or "")
            found |= {name.asname or name.name for name in node.names if name.name == own}
    return found


def named(node: ast.Call) -> Iterator[str]:
    """The module that such a call imports; ``?`` if its name is put together elsewhere."""
    first = node.args[0] if node.args else None
    whole = isinstance(first, ast.Constant) and isinstance(first.value, str)
    target = first.value.partition(":")[0] if whole else "?"  # type: ignore[union-attr]
    if target == "?" or target in modules():
        yield target


def _within(tree: ast.AST, kinds: type | tuple[type, ...]) -> set[int]:
    """Identities of the nodes that lie within nodes of a kind."""
    return {id(n) for outer in ast.walk(tree) if isinstance(outer, kinds) for n in ast.walk(outer)}


def _name(decorator: ast.expr) -> str:
    if isinstance(decorator, ast.Call):
        decorator = decorator.func
    return decorator.attr if isinstance(decorator, ast.Attribute) else getattr(decorator, "id", "")


def _count_functions(tree: ast.AST, where: str, counts: Counts) -> None:
    for node in ast.walk(tree):
        if not isinstance(node, ast.FunctionDef):
            continue
        length = (node.end_lineno or node.lineno) - node.lineno + 1
        if length > MOST_FUNCTION_LINES:
            counts.long_functions.append(f"{where}:{node.lineno} {node.name} {length}")
        if {_name(d) for d in node.decorator_list} & _COMPILED:
            arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            bare = sum(a.annotation is None for a in arguments)
            counts.kernels.append(Kernel(f"{where}:{node.lineno} {node.name}", len(arguments), bare))


@cache
def count() -> Counts:
    """Everything that the table needs, from the sources alone."""
    counts = Counts()
    for module, path in modules().items():
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        where = path.relative_to(ROOT).as_posix()
        typing = {
            id(n)
            for test in ast.walk(tree)
            if isinstance(test, ast.If) and "TYPE_CHECKING" in ast.unparse(test.test)
            for n in ast.walk(test)
        }
        deferred = _within(tree, (ast.FunctionDef, ast.AsyncFunctionDef))
        importers = set() if module in _BY_NAME else importers_of(tree)
        for node in ast.walk(tree):
            if isinstance(node, ast.Import | ast.ImportFrom):
                counts.imports += [
                    Import(module, target, id(node) in deferred, id(node) in typing)
                    for target in _targets(node)
                ]
            elif id(node) in deferred and isinstance(node, ast.Call) and _name(node) in importers:
                counts.imports += [Import(module, target, True, False) for target in named(node)]
        if not where.startswith("soundspaces_sim"):
            continue
        lines = text.splitlines()
        counts.skips += [f"{where}:{k}" for k, line in enumerate(lines, 1) if "# fmt: skip" in line]
        if len(lines) > MOST_LINES:
            counts.long_files.append(f"{where} {len(lines)}")
        _count_functions(tree, where, counts)
    return counts


def _room(module: str) -> str:
    parts = module.split(".")
    return parts[0] if parts[0] != "soundspaces_sim" else parts[1] if len(parts) > 1 else ""


def rooms() -> nx.DiGraph:
    """Which room imports which; imports for type checkers left out."""
    graph = nx.DiGraph()
    for i in count().imports:
        a, b = _room(i.module), _room(i.target)
        if i.target != "?" and a and b and a != b and not i.typing:
            graph.add_edge(a, b)
    return graph


def floors(graph: nx.DiGraph) -> int:
    """Number of floors: rooms on the longest way down."""
    return int(nx.dag_longest_path_length(graph)) + 1


def circles() -> list[str]:
    """Modules that import one another in a loop, imports within functions counted."""
    graph = nx.DiGraph((i.module, i.target) for i in count().imports if not i.typing and i.target != "?")
    faces = {m for m, path in modules().items() if path.name == "__init__.py"}
    graph.remove_nodes_from(faces)  # a face hands names on; its own imports are those of its modules
    loops = [sorted(c) for c in nx.strongly_connected_components(graph) if len(c) > 1]
    return [" <-> ".join(c) for c in loops]


def table(room: str = "") -> list[Row]:
    """The counts with their aims; of `room` alone if it is named (as in ``transport/paths``)."""
    counts, graph = count(), rooms()
    inside = f"soundspaces_sim/{room}"

    def own(found: list[str]) -> list[str]:
        return [line for line in found if line.startswith(inside)]

    deferred = [f"{i.module} -> {i.target}" for i in counts.imports if i.deferred and not i.typing]
    of_package = [line for line in deferred if line.startswith("soundspaces_sim.")]
    elsewhere = [line for line in of_package if not line.startswith("soundspaces_sim.cli")]
    wide = [f"{k.where} {k.arguments}" for k in counts.kernels if k.arguments > MOST_ARGUMENTS]
    bare = [f"{k.where} {k.bare}" for k in counts.kernels if k.bare]
    rows = [
        (f"kernels with more than {MOST_ARGUMENTS} arguments", 0, own(wide)),
        ("kernels with arguments that are not annotated", 0, own(bare)),
        ("`# fmt: skip`", 20, own(counts.skips)),
        (f"files of more than {MOST_LINES} lines", 0, own(counts.long_files)),
        (f"functions of more than {MOST_FUNCTION_LINES} lines", 0, own(counts.long_functions)),
    ]
    result = [Row(what, aim, len(found), found) for what, aim, found in rows]
    if room:
        return result
    loops = circles()
    arrows = [f"{a} -> {b}" for a, b in sorted(graph.edges)]
    return [
        Row("rooms at the top", 14, graph.number_of_nodes(), sorted(graph)),
        Row("floors", 8, floors(graph), []),
        Row("import arrows between rooms", 60, len(arrows), arrows),
        Row("circles of modules", 0, len(loops), loops),
        Row("deferred imports", 40, len(of_package), of_package),
        Row("deferred imports outside cli", 0, len(elsewhere), elsewhere),
        *result,
    ]


if __name__ == "__main__":
    for row in table(*sys.argv[1:2]):
        print(f"{row.what:48} {row.value:5}  aim {row.aim}{'' if row.value <= row.aim else '  MISSED'}")
        if len(sys.argv) > 1 or row.value <= 12:
            print(*(f"    {line}" for line in row.found), sep="\n")
