"""Pictures of a glTF file's base colours: PNG and JPEG by Pillow, of stated size, as they are stored."""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.core.extras import install_hint
from soundspaces_sim.scene.formats.gltf import Buffers, Tree, base_color, read_uri, view_of
from soundspaces_sim.scene.formats.limits import MOST_BYTES

MOST_PIXELS = 2**26  # of one picture, which is held while it is read
MOST_IN_ALL = 2**28  # of all pictures, or so many for each byte of the file if that is more:
_A_BYTE = 32
_MOST_SCANS = 100  # of a JPEG: each is a pass over the whole picture
_KINDS = ("PNG", "JPEG")
_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA")


@dataclass(frozen=True)
class Pictures:
    """`of_material`: number of the picture of each material's base colour, None where there is none."""

    path: Path
    tree: Tree
    buffers: Buffers
    of_material: tuple[int | None, ...]

    def read(self, number: int) -> np.ndarray:
        """(H, W, 3) bytes of a picture: red, green, blue, from the first row down. Raises `SceneError`."""
        with self._opened(number) as picture:
            if picture.mode not in _MODES:
                raise ValueError(f"picture {number} is {picture.mode}, expected eight bits for a colour")
            return np.asarray(picture.convert("RGB"))

    def pixels(self, number: int) -> int:
        """How many a picture declares. Raises `SceneError`."""
        with self._opened(number) as picture:
            return int(picture.width * picture.height)

    def _opened(self, number: int) -> Any:
        """A picture, of which only the head has been read."""
        try:
            from PIL import Image, UnidentifiedImageError
        except ImportError:
            raise SceneError(
                f"{self.path}: labels are in pictures, which need the pillow package: {install_hint('hm3d')}"
            ) from None
        data = self._bytes(number)
        large = f"{self.path}: picture {number} has more than {MOST_PIXELS:,} pixels, which is the limit"
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # our limit is below Pillow's
                picture = Image.open(io.BytesIO(data), formats=_KINDS)
        except Image.DecompressionBombError:
            raise SceneError(large) from None
        except UnidentifiedImageError:
            raise SceneError(
                f"{self.path}: picture {number} is neither PNG nor JPEG, or it is damaged"
            ) from None
        if picture.width * picture.height > MOST_PIXELS:
            raise SceneError(large)
        if picture.format == "JPEG" and data.count(b"\xff\xda") > _MOST_SCANS:
            raise SceneError(f"{self.path}: picture {number} has more than {_MOST_SCANS} scans")
        return picture

    def _bytes(self, number: int) -> bytes:
        image = self.tree["images"][number]
        if "bufferView" in image:
            return view_of(self.tree, self.buffers, image["bufferView"])
        if not isinstance(image.get("uri"), str):
            raise ValueError(f"picture {number} is nowhere")
        return read_uri(self.path, image["uri"], "picture", MOST_BYTES)


def pictures_of(path: Path, tree: Tree, buffers: Buffers, size: int) -> Pictures:
    """The pictures of a file of `size` bytes that its materials' base colours use. Raises `SceneError`."""
    found = Pictures(
        path, tree, buffers, tuple(_number(path, tree, m) for m in tree.get("materials", []))
    )
    total = sum(found.pixels(n) for n in {n for n in found.of_material if n is not None})
    if total > max(MOST_IN_ALL, _A_BYTE * size):
        raise SceneError(
            f"{path}: {size:,} bytes hold pictures of {total:,} pixels in all, {MOST_IN_ALL:,} is the limit"
        )
    return found


def _number(path: Path, tree: Tree, material: Tree) -> int | None:
    """Of the picture of a material's base colour."""
    color = base_color(material)
    if color is None:
        return None
    texture = tree["textures"][color["index"]]
    if "KHR_texture_transform" in color.get("extensions", {}):
        raise SceneError(
            f"{path}: its texture coordinates are transformed (KHR_texture_transform), which is not read"
        )
    source = texture.get("source")
    if source is None and texture.get("extensions"):
        raise SceneError(
            f"{path}: its pictures are no PNG or JPEG, but {', '.join(sorted(texture['extensions']))}"
        )
    if type(source) is not int or source < 0:
        raise ValueError(f"a texture's picture is {source!r:.40}, expected a number")
    return source
