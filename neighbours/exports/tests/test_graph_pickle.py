"""graph.pkl of strangers: published shapes are read, nothing is called, costs are bounded."""

from __future__ import annotations

import pickle
import struct
import subprocess
import sys
from pathlib import Path

import networkx
import numpy as np
import pytest
from soundspaces_exports.pickled import MOST_BYTES, read_graph

import soundspaces_sim as ss
from tests.marks import ci_slow

ROOT = Path(__file__).resolve().parents[3]


def _graph(kind: str = "float") -> networkx.Graph:
    rng = np.random.default_rng(0)
    out = networkx.Graph()
    for n in range(12):
        place = rng.uniform(-3.0, 3.0, 3)
        values = {
            "float": tuple(place.tolist()), "list": place.tolist(), "scalar": tuple(place),
            "float32": tuple(place.astype(np.float32)), "array": place, "fortran": np.asfortranarray(place),
        }  # fmt: skip
        out.add_node(n, point=values[kind])
    out.add_edges_from((n, (n * 5 + 1) % 12) for n in range(12))
    return out


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
@pytest.mark.parametrize("kind", ["float", "list", "scalar", "float32", "array", "fortran"])
def test_graphs_as_networkx_pickles_them(tmp_path: Path, kind: str, protocol: int) -> None:
    graph = _graph(kind)
    for touch in (False, True):  # networkx keeps views that were asked for once, and pickles them
        if touch:
            assert graph.nodes and graph.edges and graph.adj and graph.degree
        path = tmp_path / "graph.pkl"
        path.write_bytes(pickle.dumps(graph, protocol))
        read = read_graph(path)
        assert list(read.nodes) == list(graph.nodes)
        assert {frozenset(e) for e in read.edges} == {frozenset(e) for e in graph.edges}
        for n in graph.nodes:
            np.testing.assert_array_equal(read.nodes[n]["point"], graph.nodes[n]["point"])


def test_older_networkx(tmp_path: Path) -> None:
    """networkx 1 keeps `node`, `adj` and `edge`; Python 2 writes its own names."""
    graph = _graph()
    text = pickle.dumps(graph, 2)
    renamed = text.replace(b"_node", b"node").replace(b"X\x05\0\0\0node", b"X\x04\0\0\0node")
    renamed = renamed.replace(b"_adj", b"adj").replace(b"X\x04\0\0\0adj", b"X\x03\0\0\0adj")
    (tmp_path / "graph.pkl").write_bytes(renamed)
    assert list(read_graph(tmp_path / "graph.pkl").nodes) == list(range(12))


def _name(module: str, name: str) -> bytes:
    return b"c" + module.encode() + b"\n" + name.encode() + b"\n"


_DTYPE = _name("numpy", "dtype") + b"(X\x02\0\0\0f8\x89\x88tR"


def _shared(what: str) -> bytes:
    """A graph of 10^4 nodes, all of which have the same dictionary of 10^4 attributes or neighbours."""
    numbers = [b"J" + struct.pack("<i", k) for k in range(10**4)]
    texts = [b"X\x05\0\0\0%05d" % k for k in range(10**4)]
    keys = texts if what == "_node" else numbers
    long = b"}(" + b"".join(k + b"N" for k in keys) + b"uq\0"
    values = {
        "_node": [b"}"] * len(numbers), "_adj": [b"}"] * len(numbers), what: [long] + [b"h\0"] * (len(numbers) - 1),
    }  # fmt: skip
    state = b"".join(
        b"X" + struct.pack("<I", len(name)) + name.encode()
        + b"}(" + b"".join(k + v for k, v in zip(numbers, values[name], strict=True)) + b"u"
        for name in ("_node", "_adj")
    )  # fmt: skip
    return b"\x80\x02" + _name("networkx.classes.graph", "Graph") + b")R}(" + state + b"ub."


EVIL = {
    "system": _name("os", "system") + b"(X\x04\0\0\0truet\x85R.",
    "dtype with a state of its own": b"\x80\x02" + _DTYPE + b"(K\x03X\x01\0\0\0|NNNJ\x10\0\0\0K\x01K\x3ft" + b"b.",
    "object dtype": b"\x80\x02" + _name("numpy", "dtype") + b"(X\x02\0\0\0O8\x89\x88tR.",
    "dtype with fields": b"\x80\x02" + _DTYPE + b"(K\x03X\x01\0\0\0|NX\x01\0\0\0a\x85}X\x01\0\0\0aK\x01sK\x08K\x01K\0tb.",
    "array of 2^29 by list": _name("builtins", "list") + _name("numpy", "ndarray") + b"J\0\0\0\x20\x85R\x85R.",
    "ndarray": b"\x80\x02" + _name("numpy", "ndarray") + b"J\0\0\0\x20\x85R.",
    "range by tuple": _name("builtins", "tuple") + b"I9\n\x85R.",
    "memo index 2^28": b"\x80\x02Nr\0\0\0\x10.",
    "nested tuples": b"\x80\x02N" + b"\x85" * 10**6 + b".",
    "doubled tuples": b"\x80\x02Nq\0" + b"".join(b"h\0h\0\x86q\0" for _ in range(60)) + b".",
    "one dict many times": b"\x80\x02}(" + b"".join(b"K\x01N" for _ in range(9)) + b"uq\0" + b"h\0" * 10**6 + b".",
    "bytes of 2^62": b"\x80\x04\x8e" + struct.pack("<Q", 2**62) + b".",
    "colliding keys": b"\x80\x02}(" + b"".join(
        b"\x8a\x0a" + (k * (2**61 - 1)).to_bytes(10, "little", signed=True) + b"N" for k in range(1, 3000)
    ) + b"u.",
    "a persistent id": b"\x80\x02NQ.",
    "an extension": b"\x80\x02\x82\x01.",
    "an instance": b"(ios\nsystem\n.",
    "a digraph": pickle.dumps(networkx.DiGraph([(0, 1)])),
    "no graph": pickle.dumps({"a": 1}),
    "nodes of text": pickle.dumps(networkx.Graph([("a", "b")])),
    "an attribute of its own": pickle.dumps(networkx.Graph()).replace(b"_node\x94}", b"_node\x94]"),
    "one attributes for all": _shared("_node"),
    "one neighbours for all": _shared("_adj"),
    "an integer of a million bits": b"\x80\x02\x8b" + struct.pack("<i", 10**5) + b"\x7f" * 10**5 + b".",
    "a long state again and again": b"\x80\x02(" + b"K\0" * 10**5 + b"tq\0" + _DTYPE + b"q\1" + b"h\1h\0b" * 10**5 + b".",
    "nothing": b"", "garbage": b"garbage", "stop alone": b".", "mark alone": b"(.",
}  # fmt: skip


@pytest.mark.parametrize("name", EVIL)
def test_everything_else_is_one_error(tmp_path: Path, name: str) -> None:
    path = tmp_path / "graph.pkl"
    path.write_bytes(EVIL[name])
    with pytest.raises(ss.PointError, match=r"graph\.pkl: not a pickled networkx graph"):
        read_graph(path)


_LIMITED = """
import resource, sys
from soundspaces_sim import PointError
from soundspaces_exports.pickled import read_graph
held = int(open("/proc/self/statm").read().split()[0]) * 4096
resource.setrlimit(resource.RLIMIT_AS, (held + 2**30, held + 2**30))
resource.setrlimit(resource.RLIMIT_CPU, (30, 30))
for path in sys.argv[1:]:
    try:
        read_graph(path)
    except PointError:
        pass
print("done")
"""


@ci_slow
def test_costs_are_bounded_by_the_size(tmp_path: Path) -> None:
    """All of the above, and files of nothing but containers, in 1 GiB and 30 s."""
    files = {f"{i}": data for i, data in enumerate(EVIL.values())}
    for opcode in (b"}", b"]", b"(", b"J\1\1\1\1", b"}]\x86"):
        files[f"many {opcode!r}"] = b"\x80\x02" + opcode * (MOST_BYTES // 4 // len(opcode)) + b"."
    long = b"X" + struct.pack("<I", 2**20) + b"x" * 2**20
    scalar = _name("numpy.core.multiarray", "scalar")
    files["many calls"] = (
        b"\x80\x02" + long + b"q\0" + scalar + b"q\1" + _DTYPE + b"q\2" + b"h\1h\2h\0\x86R" * 10**5
    )
    for name, data in files.items():
        (tmp_path / name.encode().hex()[:60]).write_bytes(data)
    done = subprocess.run(
        [sys.executable, "-c", _LIMITED, *map(str, tmp_path.iterdir())],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout.strip()) == (0, "done"), done.stderr[-2000:]
