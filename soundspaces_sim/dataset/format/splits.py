"""Splits of a folder of datasets: `splits.toml` names the scenes of each, ``train = ["home-0", "home-1"]``; no
scene is in two."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from soundspaces_sim.core.errors import ConfigError
from soundspaces_sim.core.io.files import publish
from soundspaces_sim.core.io.untrusted import read_toml
from soundspaces_sim.core.keywords import nearest

SPLITS = "splits.toml"


def write_splits(root: Path, splits: Mapping[str, tuple[str, ...]]) -> None:
    """Publish `splits.toml`."""
    lines = [f"{name} = [{', '.join(repr(s) for s in scenes)}]" for name, scenes in splits.items()]
    publish(root / SPLITS, ("\n".join(lines).replace("'", '"') + "\n").encode())


def read_splits(path: Path, found: list[str]) -> dict[str, tuple[str, ...]]:
    """Scenes of each split, of those that were `found`; without a file all are ``train``. Raises `ConfigError`."""
    if not path.exists():
        return {"train": tuple(found)}
    raw = read_toml(path, ConfigError, "table of splits")
    owner: dict[str, str] = {}
    for split, scenes in raw.items():
        if not isinstance(scenes, list) or not scenes or not all(isinstance(s, str) for s in scenes):
            raise ConfigError(
                f'{path}: {split}: expected a list of scenes such as ["home-0"], got {scenes!r}'
            )
        for scene in scenes:
            if scene not in found:
                raise ConfigError(
                    f"{path}: {split}: '{scene}' has no dataset in {path.parent}{nearest(scene, found)}"
                )
            if scene in owner:
                raise ConfigError(
                    f"{path}: '{scene}' is in the splits '{owner[scene]}' and '{split}'; an agent is tested in "
                    "scenes that it has not seen: keep it in one"
                )
            owner[scene] = split
    if not raw:
        raise ConfigError(f'{path}: expected at least one split, such as train = ["home-0"]')
    return {split: tuple(scenes) for split, scenes in raw.items()}


def scenes_of_split(root: Path, splits: Mapping[str, tuple[str, ...]], split: str) -> tuple[str, ...]:
    """Names of the scenes of one split of a folder. Raises `ConfigError` for an unknown split."""
    if split not in splits:
        raise ConfigError(
            f"split '{split}' is not in {root / SPLITS}: there are {', '.join(splits)}{nearest(split, splits)}"
        )
    return splits[split]
