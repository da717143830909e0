"""The distribution that bears the name of the original."""

import tomllib
from pathlib import Path

from packaging.specifiers import SpecifierSet
from soundspaces_rlr.identity import VERSION

HERE = Path(__file__).resolve().parents[1]
ROOT = HERE.parents[1]


def test_clients_that_pin_the_original_accept_it_and_pypi_does_not() -> None:
    project = tomllib.loads((HERE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["name"] == "rlr_audio_propagation"
    assert project["version"] in SpecifierSet("==0.0.1")  # AudibleLight's pin
    assert project["version"] != "0.0.1"
    assert project["version"] == VERSION
    assert "Private :: Do Not Upload" in project["classifiers"]
    ours = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["name"]
    assert project["dependencies"] == [ours]
