"""Graphs out of pickles, without unpickling: a file of a stranger is data."""

from __future__ import annotations

import math
import pickletools
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import networkx
import numpy as np

from soundspaces_sim import PointError
from soundspaces_sim.parts import read_bytes

# Pickles read without unpickling: the opcodes of a few known shapes, of which nothing is called.
#
# A pickle is a program. Even an unpickler that looks up a short list of names lets a file choose the arguments
# and the state of objects; numpy's `dtype` alone is enough to crash a process. Here names are only compared: a
# networkx Graph becomes a `GraphRecord`, NumPy's scalars and arrays become numbers and arrays by value, cached
# views are skipped, and any other name or opcode is an error. Costs are bounded by the file's size.

MOST_BYTES = 32 * 2**20
MOST_OPCODES = 3_000_000  # a node with four edges takes about 30
MOST_NUMBERS = 16  # of an array
_LONGEST_KEY = 100

_MARK = object()


class PickleError(ValueError):
    """What a pickle holds is not a graph as it is published."""


@dataclass(frozen=True)
class _Name:
    """A global that the file mentions."""

    text: str


@dataclass
class GraphRecord:
    """A networkx graph: its attributes as the file has them."""

    state: dict[Any, Any] = field(default_factory=dict)


@dataclass
class _Dtype:
    code: str
    order: str = "<"


@dataclass
class ArrayRecord:
    """A NumPy array, by value once it is there."""

    value: np.ndarray | None = None


class _Skipped:
    """A cached view: it says nothing that the graph does not say."""


_GRAPH = {"networkx.classes.graph Graph"}
_VIEWS = {
    f"networkx.classes.{module} {name}"
    for module, names in {
        "reportviews": "NodeView EdgeView DegreeView",
        "coreviews": "AdjacencyView AtlasView",
    }.items()
    for name in names.split()
}
_CONTAINERS = {
    "builtins dict": dict,
    "builtins list": list,
    "builtins tuple": tuple,
    "collections OrderedDict": dict,
    "__builtin__ dict": dict,
    "__builtin__ list": list,
    "__builtin__ tuple": tuple,
}
_CORE = ("numpy.core", "numpy._core")
_SCALAR = {f"{core}.multiarray scalar" for core in _CORE}
_RECONSTRUCT = {f"{core}.multiarray _reconstruct" for core in _CORE}
_FROM_BUFFER = {f"{core}.numeric _frombuffer" for core in _CORE}
_NAMES = (
    _GRAPH
    | _VIEWS
    | set(_CONTAINERS)
    | _SCALAR
    | _RECONSTRUCT
    | _FROM_BUFFER
    | {
        "numpy ndarray",
        "numpy dtype",
        "copyreg _reconstructor",
        "copy_reg _reconstructor",
        "builtins object",
        "__builtin__ object",
        "builtins bytearray",
        "_codecs encode",
    }
)
_CODES = {
    f"{kind}{size}" for kind, sizes in {"f": "248", "i": "1248", "u": "1248"}.items() for size in sizes
}


def kind_of(value: object) -> str:
    """What a value is, for messages."""
    return {"GraphRecord": "a graph", "_Name": "a name"}.get(type(value).__name__, type(value).__name__)


def text_of(key: Any) -> str:
    """A name of an attribute. Raises `PickleError`."""
    if type(key) is not str:
        raise PickleError(f"names of attributes need to be text, got {kind_of(key)}")
    return key


def run_pickle(data: bytes) -> Any:
    """What the program leaves at its end: numbers, text, containers, `GraphRecord`s. Raises `PickleError`."""
    if len(data) > MOST_BYTES:
        raise PickleError(f"it has {len(data):,} bytes; graphs of up to {MOST_BYTES:,} are read")
    return _Machine().run(data)


class _Machine:
    """The pickle machine for data: a stack and a memo, as in Python's pickle.py."""

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}

    def run(self, data: bytes) -> Any:
        """What the program leaves at its STOP."""
        try:
            for count, (opcode, argument, _) in enumerate(pickletools.genops(data)):
                if count > MOST_OPCODES:
                    raise PickleError(f"it has more than {MOST_OPCODES:,} opcodes")
                if opcode.name == "STOP":
                    return self.stack.pop()
                do = _OPCODES.get(opcode.name)
                if do is None:
                    raise PickleError(f"opcode {opcode.name}, which no graph needs")
                do(self, argument)
        except PickleError:
            raise
        except (ValueError, IndexError, KeyError, TypeError, OverflowError, UnicodeError) as error:
            raise PickleError(f"damaged: {type(error).__name__} {error}") from error
        raise PickleError("it ends before its end")

    def push(self, value: Any) -> None:
        self.stack.append(value)

    def push_value(self, value: Any) -> None:
        if type(value) is int and value.bit_length() > 63:  # sums and products of such are slow
            raise PickleError("an integer of more than 64 bits")
        self.stack.append(value)

    def pop(self) -> Any:
        value = self.stack.pop()
        if value is _MARK:
            raise PickleError("damaged: a mark where a value belongs")
        return value

    def since_mark(self) -> list[Any]:
        at = len(self.stack) - 1
        while self.stack[at] is not _MARK:
            at -= 1
            if at < 0:
                raise PickleError("damaged: no mark")
        values = self.stack[at + 1 :]
        del self.stack[at:]
        return values

    def tuple_of(self, count: int) -> None:
        self.push(tuple([self.pop() for _ in range(count)][::-1]))

    def extend(self, values: list[Any]) -> None:
        into = self.stack[-1]
        if type(into) is not list:
            raise PickleError(f"elements of {kind_of(into)}")
        into.extend(values)

    def update(self, values: list[Any]) -> None:
        into = self.stack[-1]
        if type(into) is not dict or len(values) % 2:
            raise PickleError(f"items of {kind_of(into)}")
        for key, value in zip(values[::2], values[1::2], strict=True):
            # Bounded, because a dictionary is slow where many keys compare slowly or have one hash.
            if not (
                (type(key) is int and abs(key) < 2**31)
                or (type(key) is str and len(key) <= _LONGEST_KEY)
            ):
                raise PickleError(
                    f"keys need to be integers below 2^31 or short text, got {kind_of(key)}"
                )
            into[key] = value

    def dict_of(self, values: list[Any]) -> None:
        self.push({})
        self.update(values)

    def name(self, text: str) -> None:
        if text not in _NAMES:
            raise PickleError(f"it refers to {text.replace(' ', '.', 1)[:80]}, which no graph needs")
        self.push(_Name(text))

    def named_on_stack(self) -> None:
        name, module = self.pop(), self.pop()
        self.name(f"{text_of(module)} {text_of(name)}")

    def call(self) -> None:
        arguments, what = self.pop(), self.pop()
        if type(arguments) is not tuple or not isinstance(what, _Name):
            raise PickleError(f"a call of {kind_of(what)}")
        self.push(_called(what.text, arguments))

    def build(self) -> None:
        state, what = self.pop(), self.pop()
        if isinstance(what, GraphRecord):
            if type(state) is not dict or what.state:
                raise PickleError(f"the state of the graph is {kind_of(state)}, expected one dict")
            what.state = state
        elif isinstance(what, _Dtype):
            if (
                type(state) is not tuple
                or not 2 <= len(state) <= 9
                or state[1] not in ("<", ">", "|", "=")
            ):
                raise PickleError("a data type that is no plain number")
            if any(x not in (None, -1, 0) for x in state[2:]):
                raise PickleError("a data type that is no plain number")
            what.order = "<" if state[1] in "|=" else state[1]
        elif isinstance(what, ArrayRecord):
            _, shape, dtype, fortran, content = state
            what.value = _array(content, dtype, shape, "F" if fortran else "C")
        elif not isinstance(what, _Skipped):
            raise PickleError(f"a state of {kind_of(what)}")
        self.push(what)

    def remember(self, index: int | None) -> None:
        self.memo[len(self.memo) if index is None else index] = self.stack[-1]


def _called(name: str, arguments: tuple[Any, ...]) -> Any:
    """What a call of a known name stands for; nothing is called."""
    if name.endswith("_reconstructor"):  # protocols 0 and 1: (class, object, None)
        name, arguments = arguments[0].text if isinstance(arguments[0], _Name) else "", ()
    if name in _GRAPH:
        return GraphRecord()
    if name in _VIEWS:
        return _Skipped()
    if name in _CONTAINERS and not arguments:
        return _CONTAINERS[name]()
    if name == "numpy dtype":
        if type(arguments[0]) is not str or arguments[0] not in _CODES:
            raise PickleError("a data type that is no plain number")
        return _Dtype(arguments[0])
    if name in _SCALAR:
        dtype, content = arguments
        return _array(content, dtype, (1,), "C").item()
    if name in _RECONSTRUCT:
        return ArrayRecord()
    if name in _FROM_BUFFER:
        return ArrayRecord(_array(*arguments))
    if name == "_codecs encode" and _is_shorttext_of(arguments):  # bytes in protocols 0 to 2
        return arguments[0].encode("latin-1")
    if name == "builtins bytearray" and len(arguments) == 1 and type(arguments[0]) is bytes:
        return arguments[0]
    raise PickleError(f"a call of {name.replace(' ', '.', 1) or 'a value'}, which no graph needs")


def _is_shorttext_of(arguments: tuple[Any, ...]) -> bool:
    text, *rest = arguments
    return rest == ["latin1"] and type(text) is str and len(text) <= 8 * MOST_NUMBERS


def _array(content: Any, dtype: Any, shape: Any, order: Any) -> np.ndarray:
    """Numbers by value; the file's bytes are all there is."""
    if not isinstance(content, (str, bytes, bytearray)) or len(content) > 8 * MOST_NUMBERS:
        raise PickleError(f"an array that is not up to {MOST_NUMBERS} numbers by value")
    if isinstance(content, str):  # Python 2, and protocols below 3
        content = content.encode("latin-1")
    if not isinstance(dtype, _Dtype) or order not in ("C", "F"):
        raise PickleError("an array that is not given by value")
    if type(shape) is not tuple or not all(type(n) is int and n >= 0 for n in shape):
        raise PickleError("an array without a shape")
    kind = np.dtype(dtype.order + dtype.code)
    if len(shape) > 4 or math.prod(shape) * kind.itemsize != len(content):
        raise PickleError(f"an array of shape {shape} in {len(content)} bytes")
    return np.frombuffer(content, kind).reshape(shape, order=order)


_Do = Callable[[_Machine, Any], Any]
_OPCODES: dict[str, _Do] = {
    **dict.fromkeys(("PROTO", "FRAME"), lambda _m, _: None),
    **dict.fromkeys(
        (
            "INT BININT BININT1 BININT2 LONG LONG1 LONG4 FLOAT BINFLOAT "
            "STRING BINSTRING SHORT_BINSTRING UNICODE SHORT_BINUNICODE BINUNICODE BINUNICODE8 "
            "BINBYTES SHORT_BINBYTES BINBYTES8 BYTEARRAY8"
        ).split(),
        _Machine.push_value,
    ),
    "NONE": lambda m, _: m.push(None),
    "NEWTRUE": lambda m, _: m.push(True),
    "NEWFALSE": lambda m, _: m.push(False),
    "MARK": lambda m, _: m.push(_MARK),
    "EMPTY_DICT": lambda m, _: m.push({}),
    "EMPTY_LIST": lambda m, _: m.push([]),
    "EMPTY_TUPLE": lambda m, _: m.push(()),
    "TUPLE1": lambda m, _: m.tuple_of(1),
    "TUPLE2": lambda m, _: m.tuple_of(2),
    "TUPLE3": lambda m, _: m.tuple_of(3),
    "TUPLE": lambda m, _: m.push(tuple(m.since_mark())),
    "LIST": lambda m, _: m.push(m.since_mark()),
    "DICT": lambda m, _: m.dict_of(m.since_mark()),
    "APPEND": lambda m, _: m.extend([m.pop()]),
    "APPENDS": lambda m, _: m.extend(m.since_mark()),
    "SETITEM": lambda m, _: m.update([m.pop(), m.pop()][::-1]),
    "SETITEMS": lambda m, _: m.update(m.since_mark()),
    **dict.fromkeys(("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"), _Machine.remember),
    **dict.fromkeys(("GET", "BINGET", "LONG_BINGET"), lambda m, index: m.push(m.memo[index])),
    "GLOBAL": _Machine.name,
    "STACK_GLOBAL": lambda m, _: m.named_on_stack(),
    **dict.fromkeys(("REDUCE", "NEWOBJ"), lambda m, _: m.call()),
    "BUILD": lambda m, _: m.build(),
}


def graph_of_pickle(data: bytes) -> networkx.Graph:
    """The undirected graph that a pickle describes: integer nodes, attributes that are numbers, short lists of
    numbers, or text. Raises `PickleError`.

    Of edges their ends are kept.
    """
    found = run_pickle(data)
    if not isinstance(found, GraphRecord):
        raise PickleError(f"expected a networkx graph, got {kind_of(found)}")
    nodes = found.state.get("_node", found.state.get("node"))
    near = found.state.get("_adj", found.state.get("adj"))
    if not isinstance(nodes, dict) or not isinstance(near, dict):
        raise PickleError("the graph has no nodes and neighbours as networkx keeps them (_node, _adj)")
    seen: set[int] = set()
    out = networkx.Graph()
    for node, attributes in nodes.items():
        own = _own(attributes, f"node {_node(node)}: attributes", seen)
        out.add_node(_node(node))
        out.nodes[_node(node)].update({text_of(k): _attribute(v) for k, v in own.items()})
    for node, others in near.items():
        for other in _own(others, f"node {_node(node)}: neighbours", seen):
            if _node(node) not in out or _node(other) not in out:
                raise PickleError(f"edge {_node(node)}-{_node(other)} leads to a node that is not there")
            out.add_edge(node, other)
    return out


def _own(value: Any, what: str, seen: set[int]) -> dict[Any, Any]:
    """A dictionary that no other node has too: in a short file many nodes could name one that is long."""
    if not isinstance(value, dict):
        raise PickleError(f"{what} are {kind_of(value)}, expected a dict")
    if id(value) in seen:
        raise PickleError(f"{what} are those of another node, too")
    seen.add(id(value))
    return value


def _node(node: Any) -> int:
    if type(node) is not int:
        raise PickleError(f"nodes need to be integers, got {kind_of(node)}")
    return node


def _attribute(value: Any) -> Any:
    if isinstance(value, ArrayRecord):
        value = value.value
    if isinstance(value, np.ndarray):
        value = tuple(value.ravel().tolist()) if value.size <= MOST_NUMBERS else value
    if isinstance(value, (list, tuple)) and len(value) <= MOST_NUMBERS:
        if all(type(x) in (int, float) for x in value):
            return tuple(value)
    elif value is None or type(value) in (bool, int, float, str):
        return value
    raise PickleError(
        f"attributes need to be numbers, up to {MOST_NUMBERS} numbers, or text; one is {kind_of(value)}"
    )


def read_graph(path: str | Path) -> networkx.Graph:
    """The graph of a `graph.pkl`. Raises `PointError` for anything that is not a plain networkx graph."""
    data = read_bytes(path, PointError, "graph", MOST_BYTES)
    try:
        return graph_of_pickle(data)
    except PickleError as error:
        raise PointError(f"{path}: not a pickled networkx graph ({error})") from error


def graph_points(path: str | Path) -> np.ndarray:
    """(N, 3) m of the nodes of a `graph.pkl`, turned from Habitat's axes to Z up. Raises `PointError`."""
    graph = read_graph(path)
    points = [graph.nodes[n].get("point") for n in sorted(graph.nodes)]
    try:
        return np.array([(x, -z, y) for x, y, z in points], float).reshape(-1, 3)
    except (TypeError, ValueError, OverflowError) as error:
        raise PointError(
            f"{path}: nodes need an attribute `point` of three numbers ({error})"
        ) from error
