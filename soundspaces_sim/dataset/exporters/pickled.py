"""Graphs out of pickles, without unpickling; see `opcodes`."""

from __future__ import annotations

from typing import Any

import networkx
import numpy as np

from soundspaces_sim.dataset.exporters.opcodes import (
    MOST_BYTES,
    MOST_NUMBERS,
    ArrayRecord,
    GraphRecord,
    PickleError,
    kind_of,
    run_pickle,
    text_of,
)

__all__ = ["MOST_BYTES", "PickleError", "graph_of_pickle"]


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
