"""A simulation method of CHORAS on this engine: its JSON in, responses and parameters in the same JSON.

    python -m soundspaces_choras                 # in a container of CHORAS: JSON_PATH says which file
    python -m soundspaces_choras room.json       # the same file, without sending it back
    python -m soundspaces_choras --settings      # for example_settings/ of CHORAS

The interface is that of CHORAS' template for simulation methods. README.md says what the numbers are.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from soundspaces_parameters import room_parameters

from soundspaces_sim import (
    MaterialTable,
    Scene,
    SimulationConfig,
    SoundSpacesSimError,
    ambisonic_rir,
    load_scene,
    simulate,
)
from soundspaces_sim.parts import check_rate, pair_seed, publish_file as publish, read_json


class ChorasError(SoundSpacesSimError, RuntimeError):
    """A file of CHORAS that cannot be carried out."""


class Setting(NamedTuple):
    """A field of the method's form in CHORAS."""

    name: str
    about: str
    kind: str
    least: float
    most: float
    default: float
    step: float
    unit: str = ""


SETTINGS: Mapping[str, Setting] = {
    "sampling_rate": Setting("Sampling rate", "Of the impulse responses.", "int", 8000, 48000, 16000, 1000, "Hz"),
    "subpaths": Setting("Subpaths", "Per point; errors fall with their root.", "int", 100, 32000, 3000, 100),
    "scattering": Setting("Scattering coefficient", "Of all surfaces, in all bands.", "float", 0.0, 1.0, 0.1, 0.05),
    "seed": Setting("Seed", "Of paths and noise: the same seed gives the same result.", "int", 0, 2**31 - 1, 0, 1),
}  # fmt: skip
#: Names of CHORAS, ours, and what ours are multiplied by.
_PARAMETERS = {
    "edt": ("edt", 1.0), "t20": ("t20", 1.0), "t30": ("t30", 1.0), "c80": ("c80", 1.0), "d50": ("d50", 100.0),
    "ts": ("ts", 1000.0),
}  # fmt: skip
_RESPONSE_GAIN = math.sqrt(4.0 * math.pi)  # so that direct sound is 1 / r
_LEVEL_OVER_G = (
    20.0 * math.log10(1.0 / 20e-6) - 20.0
)  # dB: a source of 1 Pa at 1 m, whose level at 10 m is G's


def settings_json() -> str:
    """The method's form, as CHORAS reads it."""
    options = [
        {
            "name": s.name, "description": s.about, "id": key, "type": s.kind, "display": "text", "min": s.least,
            "max": s.most, "default": s.default, "step": s.step, "endAdornment": s.unit,
        }
        for key, s in SETTINGS.items()
    ]  # fmt: skip
    return json.dumps({"type": "SimulationSettings", "options": options}, indent=4) + "\n"


def run(json_path: str | Path) -> None:
    """Simulate what a file of CHORAS asks for and write responses, parameters and progress into it. Raises
    `SoundSpacesSimError` for what is wrong with it, with the field."""
    path = Path(json_path)
    whole = read_json(path, ChorasError, "input of CHORAS")
    given = _Given(path, whole)
    results = given.field(whole, "results", list)
    for n, result in enumerate(results):
        where = f"results[{n}]"
        source = given.place(result, ("sourceX", "sourceY", "sourceZ"), where)
        responses = given.field(result, "responses", list, where)
        if not responses:
            raise ChorasError(f"{path}: {where}.responses: expected a receiver or more")
        receivers = [
            given.place(r, ("x", "y", "z"), f"{where}.responses[{i}]") for i, r in enumerate(responses)
        ]
        octaves = given.octaves(result, where)
        scene = given.scene(whole, octaves)
        edges = np.sqrt(octaves[1:] * octaves[:-1])
        edges = [octaves[0] / math.sqrt(2.0), *edges, octaves[-1] * math.sqrt(2.0)]
        bands = tuple(float(f) for f in edges)
        config = SimulationConfig(bands=bands, walks=int(given.setting("subpaths")))
        seed, rate = int(given.setting("seed")), check_rate(given.setting("sampling_rate"))
        echoes = simulate(scene, source[None], np.array(receivers), config, seed)
        result["percentage"] = 80
        _write(path, whole)
        names = [*(own for own, _ in _PARAMETERS.values()), "g"]
        table = room_parameters(echoes, names, "stored")
        for i, response in enumerate(responses):
            signal = _RESPONSE_GAIN * ambisonic_rir(echoes[0, i], rate, pair_seed(seed, n, i))[0]
            response["receiverResults"] = [float(v) for v in signal]
            found = {key: scale * table[own][i] for key, (own, scale) in _PARAMETERS.items()}
            found["spl_t0_freq"] = table["g"][i] + _LEVEL_OVER_G
            response["parameters"] = {key: _plain(values) for key, values in found.items()}
        result["percentage"] = 100
        _write(path, whole)


class _Given:
    """What a file says, field by field; errors name the field."""

    def __init__(self, path: Path, whole: Any) -> None:
        self.path = path
        self.settings = (
            self.field(whole, "simulationSettings", dict) if "simulationSettings" in whole else {}
        )

    def field(self, where_in: Any, name: str, kind: type, where: str = "") -> Any:
        found = where_in.get(name) if isinstance(where_in, dict) else None
        if not isinstance(found, kind):
            label = {"list": "a list", "dict": "an object", "str": "a text"}[kind.__name__]
            raise ChorasError(
                f"{self.path}: {'.'.join(filter(None, (where, name)))}: expected {label}, got {found!r:.40}"
            )
        return found

    def place(self, of: Any, names: Sequence[str], where: str) -> np.ndarray:
        """(3,) m."""
        values = [of.get(name) if isinstance(of, dict) else None for name in names]
        if not all(_is_number(v) for v in values):
            raise ChorasError(
                f"{self.path}: {where}: expected finite {', '.join(names)}, in m, got {values!r}"
            )
        return np.array(values, float)

    def setting(self, key: str) -> float:
        """A setting of the form, or its default."""
        form, value = SETTINGS[key], self.settings.get(key, SETTINGS[key].default)
        if not (_is_number(value) and form.least <= value <= form.most):
            raise ChorasError(
                f"{self.path}: simulationSettings.{key}: expected {form.least:g} to {form.most:g} {form.unit}, got "
                f"{value!r}"
            )
        return float(value)

    def octaves(self, result: Any, where: str) -> np.ndarray:
        """(k,) midband frequencies, Hz."""
        values = self.field(result, "frequencies", list, where)
        if values and all(_is_number(v) and v > 0.0 for v in values):
            found = np.array(values, float)
            if (np.abs(np.log2(found[1:] / found[:-1]) - 1.0) < 0.05).all():
                return found
        raise ChorasError(
            f"{self.path}: {where}.frequencies: expected octaves, rising, in Hz, got {values!r:.80}"
        )

    def scene(self, whole: Any, octaves: np.ndarray) -> Scene:
        """The room with its absorption: that of the physical surfaces of the .geo file."""
        file = self.path.parent / self.field(whole, "geo_path", str)
        names, rows = [], []
        for name, given in self.field(whole, "absorption_coefficients", dict).items():
            words = given.split(",") if isinstance(given, str) else given
            try:
                row = np.array([float(w) for w in words])
            except (TypeError, ValueError):
                row = np.empty(0)
            if row.shape != octaves.shape:
                raise ChorasError(
                    f"{self.path}: absorption_coefficients.{name}: expected {len(octaves)} numbers, one for each "
                    f"of the frequencies, got {given!r:.80}"
                )
            names.append(name)
            rows.append(row)
        if not names:
            raise ChorasError(
                f"{self.path}: absorption_coefficients: expected those of a surface or more"
            )
        own = tuple(f"{name} of {self.path.name}" for name in names)
        scattering = np.full((len(rows), len(octaves)), self.setting("scattering"))
        table = MaterialTable(own, octaves, np.array(rows), scattering, np.zeros_like(scattering))
        scene = load_scene(
            file, materials=table, labels=dict(zip(names, own, strict=True)), ceiling=False
        )
        lost = sorted(set(scene.labels) - set(names))
        if lost or (scene.face_label < 0).any():
            what = f"surface {lost[0]!r}" if lost else "surfaces without a physical name"
            raise ChorasError(
                f"{file}: {what}: there are no absorption_coefficients for it in {self.path.name}"
            )
        return scene


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _plain(values: np.ndarray) -> list[float]:
    """Numbers for JSON; 0 where there is none, as CHORAS' other methods have it: its page takes no NaN."""
    return [float(v) if math.isfinite(v) else 0.0 for v in values]


def _write(path: Path, whole: Any) -> None:
    publish(path, json.dumps(whole, indent=4, allow_nan=False).encode(), durable=False)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the method as CHORAS does; what is wrong goes into the file, under ``error``, and gives exit code 1."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given == ["--settings"]:
        print(settings_json(), end="")
        return 0
    path = given[0] if given else os.environ.get("JSON_PATH", "")
    if len(given) > 1 or not Path(path).is_file():
        print(
            f"no file {path!r}; usage: python -m soundspaces_choras [FILE | --settings]",
            file=sys.stderr,
        )
        return 2
    try:
        run(path)
    except Exception as error:  # whatever it is, the page of CHORAS is to show it
        print(error, file=sys.stderr)
        _tell(Path(path), error)
        return 1
    if not given:
        _send(path)
    return 0


def _tell(path: Path, error: Exception) -> None:
    """Put an error into the file, unless it is that the file is no JSON."""
    try:
        whole = json.loads(path.read_text())
    except (OSError, ValueError):
        return
    if isinstance(whole, dict):
        _write(path, whole | {"error": {"type": type(error).__name__, "message": str(error)}})


def _send(path: str) -> None:
    """Give the file back to CHORAS, by its own package, which its containers have."""
    from choras_simulation_core.base import SimulationMethod

    class Method(SimulationMethod):  # type: ignore[misc]
        def run_simulation(self) -> None:
            """Has been done."""

    Method(path).save_results()
