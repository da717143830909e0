"""What a mesh file may cost, looked at before a parser of others reads it: docs/formats.md has the limits.

A file can declare more than it holds, or place one part so often that it is more than memory can hold.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO
from xml.etree import ElementTree

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.core.io.untrusted import open_regular, size_of

MOST_BYTES = 4 * 2**30
# Of faces, when all parts stand where they belong; more in files of more bytes.
MOST_CORNERS = 30_000_000
DEEPEST = 256  # of nodes in nodes
_MOST_UNPACKED, _SMALL = 200, 2**20  # times the size of an archive; bytes that are not counted
_MOST_ELEMENTS = 2**19  # of XML in an archive, each of which takes many times its bytes
_HEADER = 2**16  # bytes of a PLY's header
PLY_HEADER = re.compile(rb"(?<=[\r\n])end_header[ \t]*(?:\r\n|\n|\r|\Z)")  # its last line
_ELEMENT = re.compile(rb"^[ \t]*element[ \t]+\S+[ \t]+(\d+)", re.MULTILINE)


@contextmanager
def open_mesh(path: Path) -> Iterator[BinaryIO]:
    """A mesh file, open for reading. Raises `SceneError`."""
    with open_regular(path, SceneError, "file") as file:
        if size_of(file) > MOST_BYTES:
            raise SceneError(f"{path}: this file has more than {MOST_BYTES:,} bytes, which is the limit")
        yield file


def ply_header(path: Path) -> bytes:
    """The header of a PLY file, or what there is instead of it. Raises `SceneError`."""
    with open_mesh(path) as file:
        return PLY_HEADER.split(file.read(_HEADER))[0]


def check_ply(path: Path, file: BinaryIO) -> None:
    """Raise `SceneError` if a PLY's header is very long, or declares more elements than the file has bytes."""
    head = file.read(_HEADER)
    file.seek(0)
    if PLY_HEADER.search(head) is None:
        raise SceneError(
            f"{path}: cannot be read as a PLY mesh (no end_header in its first {_HEADER:,} bytes); "
            "is the file complete?"
        )
    declared = sum(int(n[:20]) for n in _ELEMENT.findall(PLY_HEADER.split(head)[0]))
    if declared > size_of(file):
        raise SceneError(
            f"{path}: cannot be read as a PLY mesh (it declares {declared:,} elements in {size_of(file):,} bytes); "
            "is the file complete?"
        )


def check_corners(path: Path, corners: int, size: int) -> None:
    """Raise `SceneError` if the parts of a file of `size` bytes have more corners than are read."""
    if corners > max(MOST_CORNERS, size):
        raise SceneError(
            f"{path}: {size:,} bytes place parts with {corners:,} corners of faces in all, {MOST_CORNERS:,} is the "
            "limit"
        )


def total_in_place(
    path: Path,
    children: Mapping[str, Sequence[str]],
    weight: Mapping[str, int],
    roots: Sequence[str],
) -> int:
    """The sum of `weight` over nodes, counted once for each way that leads there from `roots`.

    Raises `SceneError` if nodes contain themselves or lie too deep.
    """
    known: dict[str, int] = {}

    def total(node: str, depth: int) -> int:
        if depth > DEEPEST:
            raise SceneError(
                f"{path}: nodes lie more than {DEEPEST} deep in each other, or in themselves"
            )
        if node not in known:
            known[node] = weight.get(node, 0) + sum(
                total(child, depth + 1) for child in children.get(node, ())
            )
        return known[node]

    return sum(total(root, 0) for root in roots)


def check_3mf(path: Path, file: BinaryIO) -> None:
    """Raise `SceneError` if a 3MF file unpacks to very much more, or places its parts too often."""
    files = unpacked(path, file, lambda _: True)
    file.seek(0)
    models = [parse_xml(path, files[n], "a 3MF file") for n in files if n.endswith(".model")]
    objects = [o for model in models for o in xml_elements(model, "object")]
    children = {
        str(o.get("id")): [str(c.get("objectid")) for c in xml_elements(o, "component")] for o in objects
    }
    weight = {str(o.get("id")): 1 + 3 * sum(1 for _ in xml_elements(o, "triangle")) for o in objects}
    roots = [str(item.get("objectid")) for model in models for item in xml_elements(model, "item")]
    check_corners(path, total_in_place(path, children, weight, roots), size_of(file))


def unpacked(path: Path, file: BinaryIO, wanted: Callable[[str], bool]) -> dict[str, bytes]:
    """The files of an archive whose names are wanted. Raises `SceneError`.

    Deflate is what writers of meshes use, and grows at most a thousandfold; Python unpacks the other methods of ZIP
    whole, however much the archive says they hold.
    """
    size = size_of(file)
    try:
        with zipfile.ZipFile(file) as archive:
            entries = [e for e in archive.infolist() if wanted(e.filename)]
            if any(e.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for e in entries):
                raise SceneError(f"{path}: expected files packed by deflate, got another method of ZIP")
            total = sum(e.file_size for e in entries)
            if total > _MOST_UNPACKED * size + _SMALL:
                raise SceneError(f"{path}: {size:,} bytes unpack to {total:,}")
            return {e.filename: archive.read(e) for e in entries}
    except SceneError:
        raise
    except Exception as error:  # zipfile raises whatever it met
        raise SceneError(f"{path}: its archive is damaged ({error})") from error


def parse_xml(path: Path, content: bytes, what: str, most: int = _MOST_ELEMENTS) -> ElementTree.Element:
    """The root of a document without entities of its own, of up to `most` elements. Raises `SceneError`."""
    if b"\0" in content or b"<!DOCTYPE" in content or content.count(b"<") > 2 * most:
        raise SceneError(
            f"{path}: cannot be read as {what}: expected XML in UTF-8, without a DOCTYPE, of up to {most:,} "
            "elements"
        )
    try:
        return ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise SceneError(f"{path}: cannot be read as {what}: its XML is damaged ({error})") from error


def xml_elements(root: ElementTree.Element, name: str) -> list[ElementTree.Element]:
    """Elements of a name, in any namespace."""
    return [element for element in root.iter() if element.tag.rpartition("}")[2] == name]
