"""Folders of scenes: which scenes lie in them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.scene.formats import accepted, find_format

_MESHES = {".obj", ".ply", ".glb", ".gltf", ".stl", ".off", ".dae", ".3mf", ".ifc"}
_SEMANTIC = "_semantic.ply"


def _is_scene(path: Path) -> bool:
    """Whether what lies in a folder is a scene; of files those that are meshes by their names."""
    if (
        path.name.endswith(_SEMANTIC)
        and path.with_name(f"{path.name.removesuffix(_SEMANTIC)}.glb").is_file()
    ):
        return False  # Gibson's folder: the .glb stands for the scene
    return (path.is_dir() or path.suffix.lower() in _MESHES) and find_format(str(path)) is not None


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
        inside = [str(p) for p in sorted(path.iterdir()) if _is_scene(p)]
        if not inside:
            raise SceneError(
                f"{path}: neither a scene nor a folder of scenes; what can be read: {accepted()}"
            )
        found += inside
    return found
