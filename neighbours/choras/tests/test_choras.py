"""The method of CHORAS: its JSON in and out, on a room of Gmsh whose answers are known."""

import json
import math
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import soundspaces_choras as choras

from neighbours.room_programs.tests.test_room_programs import SIZE, gmsh
from soundspaces_sim.scene.build import WALLS

OCTAVES = [125, 250, 500, 1000]


def task(folder: Path, absorption: float = 0.3, settings: dict[str, object] | None = None) -> Path:
    """What CHORAS writes for a method, with one source and two receivers."""
    gmsh(folder / "room.geo")
    response = {"parameters": {"t30": []}, "receiverResults": [], "responseId": 7}
    places = [{"x": 5.0, "y": 2.0, "z": 1.2}, {"x": 2.0, "y": 4.0, "z": 1.0}]
    whole = {
        "geo_path": "room.geo",
        "msh_path": "room.msh",
        "absorption_coefficients": {
            wall: ", ".join([str(absorption)] * 4) if i else [absorption] * 4 for i, wall in enumerate(WALLS)
        },
        "simulationSettings": {"sampling_rate": 8000, "subpaths": 200, "scattering": 1.0, **(settings or {})},
        "results": [
            {
                "sourceX": 1.0, "sourceY": 2.0, "sourceZ": 1.2, "resultType": "IR", "percentage": 0,
                "frequencies": OCTAVES, "responses": [response | place for place in places],
            }
        ],
    }  # fmt: skip
    path = folder / "task.json"
    path.write_text(json.dumps(whole))
    return path


def test_responses_and_parameters_are_those_of_the_room(tmp_path: Path) -> None:
    """Direct sound of 1 / r after r / c; T30 of a diffuse room (Eyring, whose mean free paths of equal length
    Kuttruff's correction makes some 5 % longer); D50, centre time and level follow from one exponential."""
    path = task(tmp_path, 0.2)
    choras.run(path)
    whole = json.loads(path.read_text())
    (result,) = whole["results"]
    assert result["percentage"] == 100 and "error" not in whole
    assert result["responses"][0]["responseId"] == 7  # what is CHORAS' own stays
    signal = np.array(result["responses"][0]["receiverResults"])
    at = 4.0 / 343.0 * 8000
    assert abs(int(np.abs(signal[: round(at) + 20]).argmax()) - at) <= 1.5
    volume, area = math.prod(SIZE), 2 * (7 * 5 + 7 * 3 + 5 * 3)
    eyring = 24 * math.log(10) / 343.0 * volume / (-area * math.log1p(-0.2))
    for response, distance in zip(result["responses"], (4.0, math.sqrt(5.04)), strict=True):
        found = {name: np.array(values) for name, values in response["parameters"].items()}
        assert set(found) == {"edt", "t20", "t30", "c80", "d50", "ts", "spl_t0_freq"}
        assert all(values.shape == (4,) and np.isfinite(values).all() for values in found.values())
        assert np.abs(found["t30"] / eyring - 1.03).max() < 0.15
        # direct sound and a diffuse field, Barron and Lee (1988): energies re the direct sound at 10 m
        direct, late = (
            100.0 / distance**2,
            31200.0 * eyring / volume * math.exp(-0.04 * distance / eyring),
        )
        expected = 10.0 * math.log10(direct + late) + 20.0 * math.log10(50_000.0) - 20.0
        assert np.abs(found["spl_t0_freq"] - expected).max() < 2.0
        early = (direct + late * (1.0 - math.exp(-0.69 / eyring))) / (direct + late)
        assert np.abs(found["d50"] - 100.0 * early).max() < 12.0
        assert (found["ts"] > 10.0).all() and (found["ts"] < 80.0).all()


def test_the_same_seed_gives_the_same_file(tmp_path: Path) -> None:
    made = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        path = task(tmp_path / name)
        assert choras.main([str(path)]) == 0
        made.append(path.read_bytes())
    assert made[0] == made[1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda w: w.pop("geo_path"), "geo_path: expected a text"),
        (lambda w: w["absorption_coefficients"].pop("floor"), "surface 'floor'"),
        (lambda w: w["absorption_coefficients"].update(floor="0.1, 0.2"), "floor: expected 4 numbers"),
        (
            lambda w: w["absorption_coefficients"].update(floor="0.1, 0.2, 0.3, nan"),
            "nan|finite|0 to 1|range",
        ),
        (lambda w: w["simulationSettings"].update(subpaths=0), "subpaths: expected 100"),
        (lambda w: w["simulationSettings"].update(sampling_rate=5000), "sampling_rate: expected 8000"),
        (
            lambda w: w["results"][0].update(frequencies=[125, 250, 800, 1000]),
            "frequencies: expected octaves",
        ),
        (lambda w: w["results"][0].update(sourceX="1"), r"results\[0\]: expected finite sourceX"),
        (lambda w: w["results"][0].update(sourceX=99.0), "source"),
        (lambda w: w["results"][0].update(sourceX=10**400), "a whole number has 401 digits"),
        (lambda w: w["simulationSettings"].update(seed=10**400), "a whole number has 401 digits"),
        (lambda w: w["results"][0].update(sourceX=10**299), "source"),
        (lambda w: w["results"][0].update(responses=[]), "a receiver or more"),
    ],
)
def test_what_is_wrong_is_told_in_the_file(
    tmp_path: Path, change: object, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = task(tmp_path)
    whole = json.loads(path.read_text())
    change(whole)  # type: ignore[operator]
    path.write_text(json.dumps(whole))
    assert choras.main([str(path)]) == 1
    told = json.loads(path.read_text())["error"]
    assert told["message"] in capsys.readouterr().err
    assert re.search(message, told["message"], re.IGNORECASE), told


def test_in_a_container_the_file_is_sent_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a stand-in for CHORAS' own package: its base class gets the path, and sends."""
    sent = []

    class SimulationMethod:
        def __init__(self, input_json_path: str) -> None:
            self.path = input_json_path

        def save_results(self) -> None:
            sent.append(json.loads(Path(self.path).read_text())["results"][0]["percentage"])

    module = ModuleType("choras_simulation_core.base")
    module.SimulationMethod = SimulationMethod  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "choras_simulation_core", ModuleType("choras_simulation_core"))
    monkeypatch.setitem(sys.modules, "choras_simulation_core.base", module)
    monkeypatch.setenv("JSON_PATH", str(task(tmp_path)))
    assert choras.main([]) == 0
    assert sent == [100]


def test_the_form_holds_the_defaults(capsys: pytest.CaptureFixture[str]) -> None:
    assert choras.main(["--settings"]) == 0
    form = json.loads(capsys.readouterr().out)
    assert form["type"] == "SimulationSettings"
    for option in form["options"]:
        assert option["min"] <= option["default"] <= option["max"]
        assert option["default"] == choras.SETTINGS[option["id"]].default
    assert choras.main(["nothing.json"]) == 2
