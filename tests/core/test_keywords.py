"""Settings that do not exist, or are no numbers, end in errors of ours that say what was meant."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.core.numerics.axes import check_degrees, head_matrix

_RIR = np.zeros((9, 8), np.float32)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ss.SimulationConfig(walk=3), "SimulationConfig: there is no setting 'walk'; did you mean walks"),  # type: ignore[call-arg]
        (lambda: ss.SimulationConfig(walks="many"), "simulation.walks: expected `int`, got `str` \\('many'\\)"),  # type: ignore[arg-type]
        (lambda: ss.GridConfig(zzz=1), "GridConfig: there is no setting 'zzz'; there are: spacing, height"),  # type: ignore[call-arg]
        (lambda: ss.Talker(heading=3.0), "Talker: there is no setting 'heading'; did you mean heading_deg"),  # type: ignore[call-arg]
        (lambda: ss.Source((0.0, 0.0, 0.0), heading=3.0), "Source: there is no setting 'heading'"),  # type: ignore[call-arg]
        (lambda: ss.Cardioid(p="x"), "Cardioid: expected p from 0"),  # type: ignore[arg-type]
        (lambda: head_matrix(float("nan")), "heading, pitch and roll: expected finite angles"),
        (lambda: ss.binaural_rir(_RIR, 44100, "north"), "expected finite angles in degrees"),  # type: ignore[arg-type]
        (lambda: ss.binaural_rir(_RIR, 44100, float("nan")), "expected finite angles in degrees"),
        (lambda: check_degrees([0.0, np.inf], "headings_deg"), "headings_deg: expected finite angles"),
    ],
)  # fmt: skip
def test_what_is_no_setting(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ss.ConfigError, match=message):
        call()


def test_configs_are_copied_and_pickled_as_before() -> None:
    config = ss.SimulationConfig(walks=5)
    assert pickle.loads(pickle.dumps(config)) == copy.copy(config) == config


def test_headings_of_a_dataset(dataset_folder: Path) -> None:
    with ss.open_dataset(dataset_folder) as ds:
        for heading in ("north", float("nan"), None):
            with pytest.raises(ss.ConfigError, match="expected finite angles in degrees"):
                ds.binaural(0, 1, heading)  # type: ignore[arg-type]
            with pytest.raises(ss.ConfigError, match="expected finite angles in degrees"):
                ds.get_batch([(0, 1)], headings_deg=heading)  # type: ignore[arg-type]
            with pytest.raises(ss.ConfigError, match="expected finite angles in degrees"):
                ds.render(np.ones(8), 0, 1, heading_deg=heading)  # type: ignore[arg-type]
    with pytest.raises(ss.DatasetError, match=r"1 of its folders are datasets.*open_datasets"):
        ss.open_dataset(dataset_folder.parent)
