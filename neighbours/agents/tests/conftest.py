"""Fixtures of tests/nav."""

from tests.nav.conftest import (
    data as data,
    graphs as graphs,
    seen_data as seen_data,
    two_nodes as two_nodes,
)
