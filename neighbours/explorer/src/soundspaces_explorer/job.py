"""A dataset of a scene that was explored: its settings and materials as files, the command, its forecast."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_explorer.absorption import chosen_table, materials_file, with_absorption
from soundspaces_explorer.live import Chosen
from soundspaces_sim import ConfigError, MaterialTable, Scene
from soundspaces_sim.parts import make_folder, publish_file

LEAST_SPACING, MOST_SPACING = 0.1, 10.0  # m
_TIME_S = 300.0


class JobMaker:
    """Writes jobs of a scene to the folder `out`. `scene_name` and `options`: as the command line has them."""

    def __init__(
        self,
        scene: Scene,
        scene_name: str,
        options: Mapping[str, Any],
        out: Path,
        bands: tuple[float, ...],
    ) -> None:
        self._scene, self._name, self._options = scene, scene_name, dict(options)
        self._out, self._bands = out, bands
        self._forecast: dict[str, Any] = {"state": "none"}
        self._asked = 0
        self._lock = threading.Lock()

    def write(self, spacing: float, chosen: Chosen) -> dict[str, Any]:
        """Write the files and begin to measure; files and command. Raises `ConfigError`, `MaterialError`."""
        if not LEAST_SPACING <= spacing <= MOST_SPACING:
            raise ConfigError(
                f"spacing: expected {LEAST_SPACING:g} to {MOST_SPACING:g} m, got {spacing:g}"
            )
        make_folder(self._out)
        name = re.sub(r"[^\w-]+", "_", self._scene.name) or "scene"
        settings = f"[grid]\nspacing = {spacing:g}\n\n[simulation.materials]\nenabled = true\n"
        files = [_publish(self._out, name, settings)]
        options = dict(self._options)
        if chosen:
            files.append(_publish(self._out, f"{name}_materials", self._materials(chosen)))
            options["materials"] = files[-1]
        rest = [self._name, "--config", str(files[0]), *_flags(options)]
        command = ["soundspaces-sim", "rirs", *rest, "--out", str(self._out)]
        self._start(rest)
        return {"files": [str(f) for f in files], "command": shlex.join(command)}

    def _materials(self, chosen: Chosen) -> str:
        absorption = {name: np.array(a) for name, a in chosen}
        if self._options.get("materials") is None:
            return materials_file(chosen_table(self._scene.materials, absorption, self._bands))
        table = with_absorption(self._scene, absorption, self._bands).materials
        return materials_file(_of_rows(table, np.flatnonzero(~table.free_hanging)))

    def _start(self, rest: list[str]) -> None:
        with self._lock:
            self._asked += 1
            number, self._forecast = self._asked, {"state": "measuring"}
        threading.Thread(target=self._measure, args=(number, rest), daemon=True).start()

    def _measure(self, number: int, rest: list[str]) -> None:
        command = [sys.executable, "-P", "-m", "soundspaces_sim.cli", "plan", *rest, "--json"]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_TIME_S, check=False)
            if done.returncode:
                found = {"state": "failed", "why": done.stderr.strip().splitlines()[-1:] or [""]}
            else:
                told = json.loads(done.stdout.strip().splitlines()[-1])
                names = "points", "pairs", "duration", "bytes", "core_hours", "least_core_hours"
                found = {"state": "known", **{name: told[name] for name in names}}
        except (subprocess.TimeoutExpired, ValueError, LookupError, OSError) as error:
            found = {"state": "failed", "why": [str(error)]}
        with self._lock:
            if number == self._asked:
                self._forecast = found

    def forecast(self) -> dict[str, Any]:
        """`state`: none, measuring, known or failed; of a known one what `soundspaces-sim plan` tells."""
        with self._lock:
            return self._forecast


def _of_rows(table: MaterialTable, rows: np.ndarray) -> MaterialTable:
    return MaterialTable(
        tuple(table.names[r] for r in rows),
        table.frequency_hz,
        *(getattr(table, c)[rows] for c in ("absorption", "scattering", "transmission", "sheet")),
        reflection=tuple(table.reflection[r] for r in rows),
        mounting=tuple(table.mounting[r] for r in rows),
    )


def _publish(folder: Path, name: str, text: str) -> Path:
    """Write a file of that name, or of the name with the next number where another one is."""
    number = 1
    while True:
        path = folder / (f"{name}.toml" if number == 1 else f"{name}_{number}.toml")
        if not path.exists():
            publish_file(path, text.encode())
            return path
        if path.read_bytes() == text.encode():
            return path
        number += 1


def _flags(options: Mapping[str, Any]) -> list[str]:
    out: list[str] = []
    for name, value in options.items():
        flag = name.replace("_", "-")
        if value is True:
            out.append(f"--{flag}")
        elif value is False and name == "ceiling":
            out.append("--no-ceiling")
        elif value not in (None, False):
            out += [f"--{flag}", str(value)]
    return out
