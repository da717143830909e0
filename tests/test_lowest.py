"""`make test-lowest`: which versions it takes, and that it fails where readings differ."""

from __future__ import annotations

import tomllib

from tests import lowest


def test_every_dependency_has_a_lowest_version() -> None:
    project = tomllib.loads((lowest.ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    found = lowest.floors(project, *project["optional-dependencies"])
    assert {"h5py", "msgspec", "trimesh", "sofar", "torch", "gymnasium"} <= found.keys()
    assert set(lowest.floors(project, "test")) > set(lowest.floors(project))


def test_markers_and_extras_of_extras_are_followed() -> None:
    project = {
        "dependencies": ["a>=1", "b>=2; sys_platform == 'none'"],
        "optional-dependencies": {"x": ["c>=3,<4"], "y": ["soundspaces-sim[x]", "d>=5"]},
    }
    assert lowest.floors(project, "y") == {"a": "1", "c": "3", "d": "5"}


def test_other_numbers_are_told() -> None:
    nan = float("nan")
    assert lowest.differences({"a": [1.0, nan]}, {"a": [1.0, nan]}) == []
    assert lowest.differences({"a": [1.0]}, {"a": [nan]}) == ["a"]
    assert lowest.differences({"a": [1.0]}, {}) == ["a"]
