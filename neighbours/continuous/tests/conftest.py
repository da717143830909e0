"""Fixtures of tests/nav."""

from tests.nav.conftest import data as data
from tests.nav.conftest import graphs as graphs
from tests.nav.conftest import seen_data as seen_data
