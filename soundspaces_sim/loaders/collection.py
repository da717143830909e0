"""Folders of scenes: which scenes lie in them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from soundspaces_sim.base.errors import SceneError
from soundspaces_sim.loaders.formats import accepted, find_format


def find_scenes(sources: Iterable[str]) -> list[str]:
    """The scenes that names and paths stand for: each itself, or, of a folder that is none, those in it by name.

    Raises `SceneError` for a folder in which there is none. What is no folder is left to `load_scene` to refuse.
    """
    found: list[str] = []
    for source in sources:
        path = Path(source)
        if find_format(source) is not None or not path.is_dir():
            found.append(source)
            continue
        inside = [str(p) for p in sorted(path.iterdir()) if find_format(str(p)) is not None]
        if not inside:
            raise SceneError(
                f"{path}: neither a scene nor a folder of scenes; what can be read: {accepted()}"
            )
        found += inside
    return found
