"""Names of habitat-sim and Magnum that clients import and that mean nothing here: pictures by a renderer, physics.

Each can be imported, named in an annotation and subclassed. To call one, or to take anything from it, is an
`RlrError` that says why.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import ModuleType
from typing import Any, NoReturn

from soundspaces_rlr.errors import RlrError

_PHYSICS = "there is no physics here: nothing moves but agents and their sensors"
_PICTURES = "there is no renderer here: cameras are pinholes with a ray for each pixel"
NO_FILES = "files of objects and robots are not read here: all is one scene"
_DOWNLOADS = "data sets are not downloaded here; bring the scene's files"

#: Why, and the names, by module of habitat-sim.
NAMES: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "physics": (
        _PHYSICS,
        (
            "ArticulatedObjectManager", "CollisionGroupHelper", "CollisionGroups", "JointMotorSettings",
            "ManagedArticulatedObject", "ManagedBulletArticulatedObject", "ManagedBulletRigidObject",
            "ManagedRigidObject", "RaycastResults", "RigidConstraintSettings", "RigidObjectManager",
        ),
    ),
    "sensor": (_PICTURES, ("EquirectangularSensorSpec", "FisheyeSensorDoubleSphereSpec", "FisheyeSensorSpec")),
    "gfx": (_PICTURES, ("DebugLineRender", "LightInfo", "LightPositionModel")),
    "geo": (_PHYSICS, ("Ray", "get_transformed_bb")),
    "scene": (_PICTURES, ("SceneNode", "SemanticRegion")),
    "attributes": (NO_FILES, ("ObjectAttributes", "StageAttributes")),
    "metadata": (NO_FILES, ("MetadataMediator",)),
    "robots": (NO_FILES, ("FetchRobot", "FetchRobotNoWheels")),
    "utils.datasets_download": (_DOWNLOADS, ("main", "download_and_place", "initialize_test_data_sources")),
    "utils.viz_utils": (_PICTURES, ("make_video", "observation_to_image", "display_video", "save_video")),
    "utils.settings": (_PICTURES, ("default_sim_settings", "make_cfg")),
    "": (_PICTURES, ("PyRobotNoisyActuationSpec", "ReplayRenderer", "ReplayRendererConfiguration")),
}  # fmt: skip
#: The same of Magnum, its modules among the names.
MAGNUM = (
    "MeshPrimitive", "MutableImageView1D", "MutableImageView2D", "MutableImageView3D", "PixelFormat",
    "PixelStorage", "gl", "meshtools", "platform", "scenegraph", "scenetools", "shaders", "text",
)  # fmt: skip

CORRADE = ("containers", "pluginmanager")  # of the package that Magnum is built on


class _Refused(type):
    """A class that cannot be used, of which `_why` says why."""

    _why: str

    def __call__(cls, *_: Any, **__: Any) -> NoReturn:
        raise RlrError(f"{cls.__qualname__}: {cls._why}")

    def __getattr__(cls, name: str) -> NoReturn:
        if name.startswith("__"):  # what Python itself asks of a class
            raise AttributeError(name)
        raise RlrError(f"{cls.__qualname__}.{name}: {cls._why}")


def refused(name: str, why: str) -> Any:
    """A class of this full name that can be imported and not used."""
    return _Refused(name.rpartition(".")[2], (), {"_why": why, "__qualname__": name})


class RefusedObject:
    """What a simulator would answer: to use anything of it is an `RlrError`."""

    def __init__(self, name: str, why: str = _PHYSICS) -> None:
        self._name, self._why = name, why

    def __getattr__(self, name: str) -> NoReturn:
        if name.startswith("__"):
            raise AttributeError(name)
        raise RlrError(f"{self._name}.{name}: {self._why}")


def refused_names(package: str) -> dict[str, dict[str, Any]]:
    """The classes by module, under the name of the package that they stand in."""
    return {
        module: {name: refused(".".join(filter(None, (package, module, name))), why) for name in names}
        for module, (why, names) in NAMES.items()
    }


def refuse_in(module: ModuleType, package: str, names: tuple[str, ...]) -> None:
    """Give a module in a package's place these names of it."""
    for name in names:
        setattr(module, name, refused(f"{package}.{name}", _PICTURES))
