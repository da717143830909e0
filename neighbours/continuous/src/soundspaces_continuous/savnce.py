"""Configurations of SAVN-CE (Zeng et al., Semantic Audio-Visual Navigation in Continuous Environments, CVPR 2026)
as options of ours: what a task file of its `configs/savnce`, parsed from YAML, asks of space, time, sound and
measures.

What needs habitat-sim's pictures is left to it: colour (RGB) and semantics are not drawn; its sensors that an
agent's network or its goal descriptor fill are the agent's own. Everything else that is asked for and is not
offered is an error, not passed over.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from soundspaces_continuous.episodes import Rules
from soundspaces_sim import ConfigError
from soundspaces_sim.parts import POINTGOAL, nearest_name as nearest

#: Sensors of its files, and ours; None: what `savnce_own_sensors` names.
SENSORS: Mapping[str, str | None] = {
    "BINAURAL_FEATURE_EXTRACTOR": "interaural",
    "AUDIOGOAL_SENSOR": "audiogoal",
    "SPECTROGRAM_SENSOR": "spectrogram",
    "POSE_SENSOR": "pose",
    "COLLISION": "collision",
    "POINTGOAL_WITH_GPS_COMPASS_SENSOR": POINTGOAL,
    "CATEGORY": None,
    "CATEGORY_BELIEF": None,
    "LOCATION_BELIEF": None,
    "GOAL_DESCRIPTOR_SENSOR": None,
    "ORACLE_CATEGORY_SENSOR": None,
    "ORACLE_ACCDDOA_SENSOR": None,
    "ORACLE_POSITION_SENSOR": None,
}
MEASUREMENTS = frozenset(
    "DISTANCE_TO_GOAL NORMALIZED_DISTANCE_TO_GOAL SUCCESS SPL SOFT_SPL NUM_ACTION SUCCESS_WEIGHTED_BY_NUM_ACTION "
    "SUCCESS_WHEN_SILENT DISTRACTOR_SUCCESS TOP_DOWN_MAP".split()
)
NOISE_DB = 20.0  # of its simulator


def savnce_options(config: Mapping[str, Any], depth: bool = True) -> dict[str, Any]:
    """Options of `ContinuousNavEnv` for a parsed task file. `depth`: its agents see depth. Of a noisy one, `noises`
    are
    the caller's to name. Raises `ConfigError` for what it asks and we do not offer."""
    simulator, task = _table(config, "SIMULATOR"), _table(config, "TASK")
    audio = _table(simulator, "AUDIO")
    if audio.get("MIC_TYPE", "binaural") != "binaural":
        raise ConfigError(f"SIMULATOR.AUDIO.MIC_TYPE: expected binaural, got {audio['MIC_TYPE']!r}")
    for name in task.get("MEASUREMENTS", ()):
        if name not in MEASUREMENTS:
            raise ConfigError(
                f"TASK.MEASUREMENTS: no measure '{name}'{nearest(str(name), MEASUREMENTS)}"
            )
    sensors = ["depth"] if depth else []
    for name in task.get("SENSORS", ()):
        if name not in SENSORS:
            raise ConfigError(f"TASK.SENSORS: no sensor '{name}'{nearest(str(name), SENSORS)}")
        ours = SENSORS[name]
        if ours is not None and ours not in sensors:
            sensors.append(ours)
    picture = _table(simulator, "DEPTH_SENSOR")
    if picture.get("WIDTH", 128) != picture.get("HEIGHT", 128):
        raise ConfigError(
            f"SIMULATOR.DEPTH_SENSOR: expected a square, got {picture['WIDTH']} by {picture['HEIGHT']}"
        )
    options: dict[str, Any] = {
        "max_steps": int(_table(config, "ENVIRONMENT").get("MAX_EPISODE_STEPS", 500)),
        "step_time": float(simulator.get("STEP_TIME", 0.25)),
        "forward": float(simulator.get("FORWARD_STEP_SIZE", 0.25)),
        "turn_deg": float(simulator.get("TURN_ANGLE", 15)),
        "success_distance": float(_table(task, "SUCCESS").get("SUCCESS_DISTANCE", 1.0)),
        "sensors": tuple(sensors),
        "depth_size": int(picture.get("WIDTH", 128)),
        "rules": _rules(audio),
    }
    if audio.get("HAS_NOISE_SOUND"):
        options["noise_db"] = NOISE_DB
    return options


def savnce_own_sensors(config: Mapping[str, Any]) -> tuple[str, ...]:
    """Sensors of a parsed task file that no observation of ours fills, in its order: the goal's category, which
    stands in `SoundSource.category` of the episode; beliefs and descriptors, which the agent's own networks make of
    what it hears; and oracles, which training takes from `env.state`. Raises `ConfigError` for a sensor that is
    not SAVN-CE's."""
    names = [str(name) for name in _table(config, "TASK").get("SENSORS", ())]
    for name in names:
        if name not in SENSORS:
            raise ConfigError(f"TASK.SENSORS: no sensor '{name}'{nearest(name, SENSORS)}")
    return tuple(name for name in names if SENSORS[name] is None)


def _rules(audio: Mapping[str, Any]) -> Rules:
    """Its episodes state onset and offset; drawn ones take whole seconds' bounds of their kind."""
    distractors = int(bool(audio.get("HAS_DISTRACTOR_SOUND")))
    if audio.get("EVERLASTING"):
        return Rules(distractors=distractors)
    return Rules(distractors=distractors, onset=(0.0, 5.0), duration=(5.0, 15.0))


def _table(config: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = config.get(name, {})
    if not isinstance(found, Mapping):
        raise ConfigError(f"{name}: expected a table, got {found!r}")
    return found
