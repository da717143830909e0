"""BibTeX of what is used: complete, and neither more nor less than the settings turn on."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from soundspaces_exports.citation import SOURCES, citation, entries, parts_used

import soundspaces_sim as ss

ROOT = Path(__file__).resolve().parents[3]
THEORY = " ".join((ROOT / "docs" / "theory.md").read_text("utf-8").split())


def _keys(text: str) -> list[str]:
    return re.findall(r"^@\w+\{(\w+),$", text, re.MULTILINE)


@pytest.mark.parametrize("key", entries())
def test_an_entry_is_bibtex_of_a_work_in_the_references(key: str) -> None:
    entry = entries()[key]
    assert entry.count("{") == entry.count("}") and entry.count("@") == 1
    fields = dict(re.findall(r"^  (\w+) = \{(.*)\},$", entry, re.MULTILINE))
    assert {"author", "title", "year"} <= set(fields)
    if key != "soundspaces_sim":
        assert fields["year"] in THEORY
        title = fields["title"].replace("--", "–").translate({ord("{"): None, ord("}"): None})
        assert title.lower() in THEORY.lower() or title.partition(":")[0] in THEORY


def test_every_work_belongs_to_a_part_and_every_part_has_its_works() -> None:
    assert {key for keys in SOURCES.values() for key in keys} == set(entries())
    assert set(parts_used(ss.JobConfig())) < set(SOURCES)


def test_settings_decide_what_is_cited() -> None:
    default = _keys(citation())
    assert len(set(default)) == len(default) and default[:2] == [
        "soundspaces_sim",
        "chen2020soundspaces",
    ]
    assert "kouyoumjian1974" in default and "gardner1994" in default and "paris1928" in default
    assert "kouyoumjian1974" not in _keys(
        citation(ss.SimulationConfig(diffraction=ss.DiffractionConfig(enabled=False)))
    )
    assert "bai2015" not in _keys(
        citation(ss.SimulationConfig(radiance_transfer=ss.RadianceTransferConfig(enabled=False)))
    )
    assert "paris1928" not in _keys(citation(ss.SimulationConfig(reflection="random")))
    paper = _keys(citation(ss.load_config(ROOT / "pipelines" / "paper.toml")))
    assert not {"kouyoumjian1974", "christensen2005", "starck1994"} & set(paper)


def test_a_dataset_names_what_its_maker_asks_for_and_other_ears(dataset_folder: Path) -> None:
    with ss.open_dataset(dataset_folder) as ds:
        text = citation(ds)
        assert text == citation(dataset_folder)
        assert text.startswith("% The dataset's maker asks to cite: soundspaces_sim; C. Chen et al.")
    kemar = ROOT / "soundspaces_sim" / "rendering" / "hrtf_data" / "mit_kemar.sofa"
    with ss.open_dataset(dataset_folder, hrtf=ss.Ears(kemar)) as ds:
        own = citation(ds)
    assert "% Heard with the HRTF set mit_kemar.sofa" in own and "gardner1994" not in _keys(own)
    with pytest.raises(ss.ConfigError, match="expected a dataset"):
        citation(3)  # type: ignore[arg-type]


def test_the_command_prints_it(dataset_folder: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "soundspaces_sim.cli", "cite"]
    done = subprocess.run([*command, dataset_folder], capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout == citation(dataset_folder)
    missing = subprocess.run([*command, tmp_path], capture_output=True, text=True)
    assert missing.returncode == 2 and missing.stderr.startswith("DatasetError: no dataset at")
