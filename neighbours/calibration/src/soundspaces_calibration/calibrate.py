"""Absorption of a scene's materials that measured room measures ask for (docs/materials.md, "Measured rooms").

A simulation counts reflections, a fit by these counts finds the most probable absorption
(`echogram.fit_materials`), and the scene is simulated anew with it: until a further fit changes it by less than its
spread, so that how far counts reach limits a step and not the result.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from soundspaces_calibration.fit_materials import MaterialFit, fit_materials
from soundspaces_calibration.interference import interference_spread
from soundspaces_calibration.material_file import in_octaves, materials_toml
from soundspaces_calibration.measured.calibration import Calibration, Turn
from soundspaces_calibration.measured.reading import read_measured
from soundspaces_calibration.measured.room import MEASURED, MeasuredRoom
from soundspaces_sim import (
    ConfigError,
    DatasetError,
    Echograms,
    MaterialsConfig,
    Scene,
    SimulationConfig,
    load_scene,
    simulate,
)
from soundspaces_sim.parts import MEASURES, echograms_measures

_GROUPS = 12
_UNSTATED = 0.5  # JND: standard error of what was measured, where none is stated
_PINNED = 1e-4  # spread of ln(a / (1 - a)) of what shall stay
_ROWS = [MEASURES.index(name) for name in MEASURED]


def calibrate(
    scene: Scene | str | Path | Any,
    measured: MeasuredRoom | str | Path,
    config: SimulationConfig | None = None,
    *,
    hold_out: Sequence[str] = (),
    seed: int = 0,
    rounds: int = 5,
    progress: Callable[[int, int], None] | None = None,
) -> Calibration:
    """Absorption of the materials that sound meets most often, up to twelve, fitted to a measured room.

    `measured`: a `MeasuredRoom`, or a file of one (`read_measured`). `config`: settings of the simulation, in the
    octaves that were measured whatever bands it has. `hold_out`: pairs that take no part in the fit: names of
    sources or receivers, or ``SOURCE:RECEIVER``. Materials that a measurement tells nothing of keep the table's
    absorption. `rounds`: simulations at most. Raises `DatasetError`, `ConfigError`, `PointError`, and what
    `simulate` does.
    """
    if rounds < 2:
        raise ConfigError(f"rounds: expected at least 2 simulations, got {rounds}")
    room = measured if isinstance(measured, MeasuredRoom) else read_measured(measured)
    held_out = room.pairs_of(hold_out, "hold_out: ")
    if not np.isfinite(room.values[~held_out]).any():
        raise DatasetError(f"hold_out: {', '.join(hold_out)} leave no measured pair to fit to")
    loaded = load_scene(scene)
    task = _Task(
        replace(loaded, materials=in_octaves(loaded.materials)),
        room,
        held_out,
        msgspec.structs.replace(
            config or SimulationConfig(),
            bands=room.edges,
            materials=MaterialsConfig(enabled=True, groups=_GROUPS),
        ),
    )
    return task.run(seed, rounds, progress or (lambda _done, _all: None))


class _Simulated(NamedTuple):
    echoes: Echograms
    values: np.ndarray  # (S, R, measures, K)
    interference: np.ndarray
    error: np.ndarray  # standard errors of measured minus simulated values

    @property
    def absorption(self) -> np.ndarray:
        """(M, K)"""
        assert self.echoes.counts is not None  # asked for
        return self.echoes.counts.groups.absorption


@dataclass(frozen=True)
class _Task:
    scene: Scene
    room: MeasuredRoom
    held_out: np.ndarray
    config: SimulationConfig

    def run(self, seed: int, rounds: int, progress: Callable[[int, int], None]) -> Calibration:
        scene, turns, widened = self.scene, [], 1.0
        first: _Simulated | None = None
        unknown: np.ndarray | None = None
        for number in range(rounds):
            progress(number, rounds)
            now = self._simulate(scene, seed + number)
            first = first or now
            fit, unknown, widened = self._fit(now, first.absorption, unknown)
            change = float((np.abs(fit.absorption - now.absorption) / fit.spread).max())
            turns.append(Turn(self._misfit(now), change, fit.within))
            if number > 0 and fit.within and change <= 1.0:
                break
            if number < rounds - 1:
                scene = self._with(fit)
        progress(rounds, rounds)
        assert first is not None and unknown is not None  # at least two rounds
        fit = replace(fit, absorption=now.absorption, misfit=turns[-1].misfit)
        return Calibration(
            self.scene.name,
            self.room,
            self.held_out,
            fit,
            first.absorption,
            unknown,
            first.values,
            now.values,
            now.interference,
            tuple(turns),
            widened,
            self._file(scene, fit, unknown),
        )

    def _simulate(self, scene: Scene, seed: int) -> _Simulated:
        echoes = simulate(scene, self.room.sources, self.room.receivers, self.config, seed)
        found = echograms_measures(echoes)
        values = np.stack([found[name] for name in MEASURED], axis=2)
        interference = np.array(
            [
                [interference_spread(echoes[s, r], MEASURED) for r in range(echoes.shape[1])]
                for s in range(echoes.shape[0])
            ]
        )
        assert echoes.measure_error is not None  # of all that is traced
        own = np.nan_to_num(echoes.measure_error[:, :, _ROWS].astype(float))
        stated = self.room.error
        of_measurement = np.where(np.isfinite(stated), stated, _UNSTATED * self.room.jnd)
        error = np.sqrt(of_measurement**2 + np.nan_to_num(interference) ** 2 + own**2)
        return _Simulated(echoes, values, interference, error)

    def _known(self, now: _Simulated) -> np.ndarray:
        """(S, R, measures, K) what takes part in a fit: measured, simulated, and not held out."""
        both = np.isfinite(self.room.values) & np.isfinite(now.values)
        return np.asarray(both & ~self.held_out[:, :, None, None])

    def _misfit(self, now: _Simulated) -> float:
        off = ((self.room.values - now.values) / now.error)[self._known(now)]
        return float(np.sqrt(np.mean(off**2)))

    def _fit(
        self, now: _Simulated, about: np.ndarray, unknown: np.ndarray | None
    ) -> tuple[MaterialFit, np.ndarray, float]:
        """The fit about the first table's absorption, and by what errors were multiplied: a misfit above 1 says
        that errors were stated too small, so that they are widened by it, once (Birge's ratio)."""
        known = self._known(now)
        if not known.any():
            raise DatasetError(
                "calibration: the simulation has none of the measured values: decays are too short, or too "
                "uncertain; more walks or a longer max_duration may help"
            )
        chosen = np.argwhere(known.any(axis=(2, 3)))
        pairs = [now.echoes[s, r] for s, r in chosen.tolist()]
        rows = tuple(chosen.T)
        measured = np.where(known, self.room.values, np.nan)[rows]
        error = now.error[rows]
        fit = fit_materials(pairs, measured, error, MEASURED, about=about)
        widened = max(fit.misfit, 1.0)
        if widened > 1.0:
            fit = fit_materials(pairs, measured, widened * error, MEASURED, about=about)
        if unknown is None:
            unknown = fit.undetermined
        if not unknown.any():
            return fit, unknown, widened
        # what nothing tells of keeps the table's value; spreads are those of a fit in which it might differ
        pinned = np.where(unknown, _PINNED, fit.prior_logit)
        again = fit_materials(pairs, measured, widened * error, MEASURED, pinned, about)
        absorption = np.where(unknown, about, again.absorption)
        fit = replace(fit, absorption=absorption, misfit=again.misfit, within=again.within)
        return fit, unknown, widened

    def _with(self, fit: MaterialFit) -> Scene:
        """The scene with fitted absorption in the measured octaves."""
        table = self.scene.materials
        columns = np.searchsorted(table.frequency_hz, self.room.octaves)
        absorption = table.absorption.copy()
        for name, values in zip(fit.names, fit.absorption, strict=True):
            absorption[table.index(name), columns] = values
        return replace(self.scene, materials=replace(table, absorption=absorption))

    def _file(self, scene: Scene, fit: MaterialFit, unknown: np.ndarray) -> str:
        """The material file of what the scene uses."""
        table, further = scene.materials, {}
        for m, name in enumerate(fit.names):
            told = ~unknown[m]
            further[name] = {
                "calibrated_hz": [f for f, t in zip(self.room.octaves, told, strict=True) if t],
                "calibrated_spread": fit.spread[m][told].tolist(),
                "undetermined_hz": [f for f, t in zip(self.room.octaves, told, strict=True) if not t],
            }
        used = set(scene.face_material.tolist()) | set(table.mounted_rows[scene.face_material].tolist())
        head = (
            f"Absorption of {scene.name}, fitted to measured room measures; `soundspaces-sim calibrate`.\n"
            "calibrated_spread: one standard deviation of absorption at calibrated_hz. At undetermined_hz nothing "
            "was told."
        )
        return materials_toml(table, sorted(used - {-1}), head, further)
