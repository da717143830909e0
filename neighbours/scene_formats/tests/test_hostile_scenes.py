"""Scenes of strangers, in the formats of this distribution: what they declare costs no more than they are large."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

import soundspaces_sim as ss
from neighbours.scene_formats.tests.test_habitat_layouts import PNG, declaring, gibson, hm3d
from tests.attack.test_scenes import said_of, written, zipped


def _every_picture(tree: dict) -> None:  # type: ignore[type-arg]
    """Five pictures of the first one's bytes, each of which is used."""
    tree["images"] = [tree["images"][0]] * 5
    tree["textures"] = [{"source": n} for n in range(5)]
    tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": n}}} for n in range(5)]


_DAE = """<?xml version="1.0"?>{dtd}<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>2020-01-01T00:00:00</created><modified>2020-01-01T00:00:00</modified></asset>
<library_nodes>{nodes}</library_nodes><library_visual_scenes><visual_scene id="s"><node id="r"><instance_node url="#n0"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
_TWICE = "".join(
    f'<node id="n{i}"><instance_node url="#n{i + 1}"/><instance_node url="#n{i + 1}"/></node>' for i in range(30)
) + '<node id="n30"/>'  # fmt: skip
_LAUGHS = '<!DOCTYPE x [<!ENTITY a "ha">' + "".join(
    f'<!ENTITY {chr(98 + i)} "{("&" + chr(97 + i) + ";") * 10}">' for i in range(12)
) + "]>"  # fmt: skip

#: What is made, and what the error says.
HOSTILE: dict[str, tuple[Callable[[Path], Path], str | None]] = {
    "archive as COLLADA": (lambda d: zipped(d / "a.dae", 10**6), "archive"),
    "COLLADA that doubles thirty times": (lambda d: written(d / "a.dae", _DAE.format(dtd="", nodes=_TWICE)), "corners"),
    "COLLADA in itself": (lambda d: written(d / "a.dae", _DAE.format(dtd="", nodes='<node id="n0"><instance_node url="#n0"/></node>')), "in themselves"),
    "COLLADA that laughs": (lambda d: written(d / "a.dae", _DAE.format(dtd=_LAUGHS, nodes="<node id='n0' name='&m;'/>")), "cannot be read"),
    "HM3D with a picture of 10^9": (lambda d: hm3d(d, pictures=[declaring(PNG, 32000)] * 2), "pixels, which is the limit"),
    "HM3D with many pictures of 6*10^7": (lambda d: hm3d(d, change=_every_picture, pictures=[declaring(PNG, 8000)] * 2), "in all"),
    "HM3D with a picture that ends early": (lambda d: hm3d(d, pictures=[declaring(PNG, 8000)] * 2), "cannot be read"),
    "HM3D with a picture elsewhere": (lambda d: hm3d(d, change=lambda t: t.update(images=[{"uri": "/dev/zero"}] * 2)), "not a file beside it"),
    "HM3D's rows of 10^6 quotes": (lambda d: hm3d(d, rows='HM3D Semantic Annotations\n1,FF,' + '" ' * 10**6 + "\n"), "line 2"),
    "Gibson's JSON 10^5 deep": (lambda d: gibson(d, "[" * 10**5), "nested"),
}  # fmt: skip


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str | None]:
    return said_of(HOSTILE, tmp_path_factory.mktemp("hostile"))


@pytest.mark.parametrize("name", HOSTILE)
def test_costs_are_bounded_by_the_size(said: dict[str, str | None], name: str) -> None:
    assert re.search(str(HOSTILE[name][1]), str(said[name])), said[name]


@pytest.mark.parametrize("end", ["dae", "ifc"])
def test_pipes_do_not_hang(tmp_path: Path, end: str) -> None:
    os.mkfifo(tmp_path / f"pipe.{end}")
    with pytest.raises(ss.SceneError, match=r"not a regular file|unknown scene"):
        ss.load_scene(tmp_path / f"pipe.{end}")
