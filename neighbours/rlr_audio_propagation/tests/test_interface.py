"""The module looks as rlr_audio_propagation 0.0.1 does; expected values were read off that wheel."""

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from soundspaces_rlr import api
from soundspaces_rlr.api import (
    BoxMaterialCategories,
    ChannelLayout,
    ChannelLayoutType,
    Config,
    Context,
    Ray,
    RlrError,
)
from soundspaces_rlr.propagation import simulation_config

from neighbours.rlr_audio_propagation.tests.rooms import BINAURAL, MONO, SIZE, foa, quick, response, room

DEFAULTS = {
    "diffraction": 1, "direct": 1, "direct_ray_count": 500, "direct_sh_order": 3, "frequency_bands": 4,
    "global_volume": 1.0, "hrtf_back": [0.0, 0.0, 1.0], "hrtf_right": [1.0, 0.0, 0.0],
    "hrtf_up": [0.0, 1.0, 0.0], "indirect": 1, "indirect_ray_count": 5000, "indirect_ray_depth": 200,
    "indirect_sh_order": 1, "max_diffraction_order": 10, "max_ir_length": 4.0, "mesh_simplification": 0,
    "sample_rate": 44100.0, "size": 146, "source_ray_count": 200, "source_ray_depth": 10,
    "temporal_coherence": 0, "thread_count": 1, "transmission": 1, "unit_scale": 1.0,
}  # fmt: skip


def test_config_has_the_originals_defaults_and_nothing_else() -> None:
    config = Config()
    public = {
        name: getattr(config, name)
        for name in dir(config)
        if not name.startswith("__") and not callable(getattr(config, name))
    }
    assert public == DEFAULTS
    assert json.loads(json.dumps(public)) == DEFAULTS
    assert {type(v) for v in public.values()} == {int, float, list}


def test_config_fields_take_their_type_and_unknown_ones_are_refused() -> None:
    config = Config()
    given: dict[str, object] = {"direct": False, "sample_rate": 16000, "hrtf_up": (0, 0, 1)}
    for name, value in given.items():
        setattr(config, name, value)
    assert repr(config.direct) == "0"
    assert repr(config.sample_rate) == "16000.0"
    assert config.hrtf_up == [0.0, 0.0, 1.0]
    with pytest.raises(AttributeError):
        config.no_such_field = 1
    wrong: dict[str, object] = {"thread_count": 1.5, "max_ir_length": "long", "hrtf_up": [0, 1]}
    for name, value in wrong.items():
        with pytest.raises(TypeError, match=name):
            setattr(config, name, value)
    for name, value in DEFAULTS.items():  # a client restores a config from its own JSON
        setattr(config, name, value)
    assert config == Config()


def test_names_and_enumeration() -> None:
    assert api.AMBISONICS_XYZ_INDEX == [3, 1, 2]
    assert {t.name: t.value for t in ChannelLayoutType} == {
        "Unknown": 0, "Mono": 1, "Binaural": 3, "Ambisonics": 7,
    }  # fmt: skip
    layout = ChannelLayout(ChannelLayoutType.Ambisonics, 4)
    assert (layout.type, layout.channel_count) == (ChannelLayoutType.Ambisonics, 4)
    methods = """add_listener add_mesh_indices add_mesh_vertices add_object add_source clear_listeners
        clear_objects clear_sources finalize_object_mesh get_audio get_channel_counts
        get_indirect_ray_efficiency get_ir_channel get_ir_channel_count get_ir_count get_ir_sample_count
        get_listener_audio get_listener_count get_listener_source_audio get_listener_source_channel_audio
        get_object_count get_source_audio get_source_count reset set_listener_hrtf
        set_listener_orientation_quaternion set_listener_position set_listener_radius
        set_material_database_json set_object_box set_object_mesh_obj set_object_mesh_ply
        set_object_orientation_quaternion set_object_position set_source_position set_source_radius simulate
        trace_ray_any_hit trace_ray_first_hit write_ir_metrics write_ir_wave write_scene_mesh_obj"""
    assert [m for m in methods.split() if not callable(getattr(Context, m, None))] == []


def test_install_in_a_fresh_process() -> None:
    code = (
        "import soundspaces_rlr; soundspaces_rlr.install(); soundspaces_rlr.install()\n"
        "import rlr_audio_propagation as r\n"
        "from rlr_audio_propagation import Config, Context, ChannelLayout, ChannelLayoutType, Ray\n"
        "from soundspaces_rlr.api import Context as ours\n"
        "assert r.Context is ours"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    late = (
        "import sys, types; m = types.ModuleType('rlr_audio_propagation'); m.Context = object\n"
        "sys.modules['rlr_audio_propagation'] = m\n"
        "import soundspaces_rlr\n"
        "try: soundspaces_rlr.install()\n"
        "except RuntimeError as e: assert 'before the first import' in str(e)\n"
        "else: raise SystemExit('no error')"
    )
    subprocess.run([sys.executable, "-c", late], check=True)


@pytest.mark.parametrize("genuine", [False, True])
def test_install_says_who_answers(tmp_path: Path, genuine: bool) -> None:
    """The metadata of the process name this engine. A genuine distribution is not hidden unless that is asked for."""
    if genuine:
        info = tmp_path / "rlr_audio_propagation-0.0.1.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            "Metadata-Version: 2.1\nName: rlr_audio_propagation\nVersion: 0.0.1\n"
        )
    code = f"""
import importlib.metadata, sys
import soundspaces_rlr
assert "rlr_audio_propagation" not in sys.modules
try: soundspaces_rlr.install()
except RuntimeError as error: assert "0.0.1 is installed and would be hidden" in str(error), error
else: assert not {genuine}
soundspaces_rlr.install(shadow={genuine})
soundspaces_rlr.install()
import rlr_audio_propagation
from soundspaces_rlr.api import Context
assert rlr_audio_propagation.Context is Context
assert importlib.metadata.version("rlr-audio-propagation") == "0.0.1+soundspaces"
assert importlib.metadata.version("numpy")
"""
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{os.environ['PYTHONPATH']}"}, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert ("in this process 0.0.1+soundspaces answers" in done.stderr) == genuine


def test_counts_and_reset() -> None:
    context = room(quick(indirect=0), [(1, 1, 1), (2, 2, 1)], [((4, 3, 1.5), MONO)])
    assert (context.get_source_count(), context.get_listener_count(), context.get_object_count()) == (
        2,
        1,
        1,
    )
    assert context.get_ir_count() == 0
    assert context.get_ir_channel_count(0, 0) == 0
    context.simulate()
    assert context.get_ir_count() == 2
    context.get_audio = list  # type: ignore  # clients bind methods on the instance
    other = quick(sample_rate=48000.0)
    context.reset(other)
    assert context.config is other
    assert context.sr == 48000.0
    assert (context.get_source_count(), context.get_listener_count(), context.get_object_count()) == (
        0,
        0,
        0,
    )
    assert context.get_ir_count() == 0
    context.simulate()  # nothing to do


def test_shapes_and_padding() -> None:
    context = room(
        quick(), [(1, 1, 1), (2, 2, 1), (5, 1, 2)], [((4, 3, 1.5), foa()), ((2, 4, 1.5), foa())]
    )
    context.simulate()
    assert context.get_channel_counts() == [[4] * 3] * 2
    n = max(context.get_ir_sample_count(l, s) for l in range(2) for s in range(3))
    assert context.get_audio().shape == (2, 3, 4, n)
    assert context.get_listener_audio(1).shape[:2] == (3, 4)
    assert context.get_source_audio(2).shape[:2] == (2, 4)
    one = context.get_listener_source_channel_audio(1, 2, 3)
    assert (one.dtype.name, one.ndim) == ("float64", 1)
    padded = context.get_audio()[1, 2, 3]
    assert np.array_equal(padded[: len(one)], one)
    assert not padded[len(one) :].any()
    one[:] = 0.0  # what a client does to an array does not reach the context
    assert context.get_ir_channel(1, 2, 3).any()


def test_before_a_simulation_arrays_are_empty_as_the_originals() -> None:
    """The original stacks as many responses as there are: none, for each listener and source."""
    context = room(
        quick(), [(1, 1, 1), (2, 2, 1), (5, 1, 2)], [((4, 3, 1.5), foa()), ((2, 4, 1.5), foa())]
    )
    assert context.get_audio().shape == (2, 3, 0)
    assert context.get_listener_audio(1).shape == (3, 0)
    assert context.get_source_audio(2).shape == (2, 0)
    assert context.get_listener_source_audio(1, 2).shape == (0,)
    assert context.get_ir_channel_count(1, 2) == 0


def test_layouts_of_different_channels_fit_in_no_array() -> None:
    context = room(quick(indirect=0), [(1, 1, 1)], [((4, 3, 1.5), foa()), ((2, 4, 1.5), BINAURAL)])
    context.simulate()
    assert context.get_channel_counts() == [[4], [2]]
    with pytest.raises(RuntimeError, match="2 and 4 channels"):
        context.get_audio()
    assert context.get_listener_audio(1).shape[:2] == (1, 2)


def test_wrong_calls_are_runtime_errors_that_say_what_is_wrong(tmp_path: Path) -> None:
    context = room(quick(indirect=0), [(1, 1, 1)], [((4, 3, 1.5), MONO)])
    (tmp_path / "broken.json").write_text("{")
    (tmp_path / "odd.json").write_text('{"materials": [{"name": "a", "absorption": [1.0]}]}')
    calls: list[tuple[Callable[..., object], tuple[object, ...], str]] = [
        (context.get_ir_channel, (0, 0, 0), r"call simulate\(\)"),
        (context.get_listener_audio, (3,), r"call simulate\(\)"),
        (context.set_source_position, (5, [0, 0, 0]), "source 5 is not among the 1"),
        (context.set_listener_position, (1, [0, 0, 0]), "listener 1 is not among the 1"),
        (context.set_object_position, (-1, [0, 0, 0]), "object -1 is not among the 1"),
        (context.set_source_position, (0, [0, 0, np.nan]), "finite"),
        (context.set_listener_orientation_quaternion, (0, [0, 0, 0, 0]), "quaternion"),
        (context.set_listener_hrtf, (0, str(tmp_path / "no.sofa")), "no.sofa"),
        (context.set_material_database_json, (str(tmp_path / "no.json"),), "no.json"),
        (context.set_material_database_json, (str(tmp_path / "broken.json"),), "not valid JSON"),
        (context.set_material_database_json, (str(tmp_path / "odd.json"),), "absorption needs pairs"),
        (context.set_object_mesh_obj, (0, str(tmp_path / "no.obj"), "wall"), "no.obj"),
        (context.set_object_mesh_ply, (0, str(tmp_path / "odd.json"), "wall"), "PLY"),
        (context.add_mesh_vertices, ([0.0, 1.0],), "x, y, z"),
        (context.add_mesh_indices, ([0, 1, 2, 3], 3, "wall"), "vertices_per_face"),
        (context.write_scene_mesh_obj, (str(tmp_path / "no" / "x.obj"),), "x.obj"),
        (context.add_listener, (ChannelLayout(ChannelLayoutType.Unknown, 1),), "Unknown"),
    ]
    for call, arguments, message in calls:
        with pytest.raises(RuntimeError, match=message) as caught:
            call(*arguments)
        assert isinstance(caught.value, RlrError)
    wrong: list[tuple[Callable[..., object], tuple[object, ...]]] = [
        (context.set_source_position, (0, [1, 2])),
        (context.set_source_position, (0.5, [1, 2, 3])),
        (context.add_listener, (1,)),
        (Context, (None,)),
        (context.add_mesh_indices, ([0.5, 1.0, 2.0], 3, "wall")),
    ]
    for call, arguments in wrong:
        with pytest.raises(TypeError):
            call(*arguments)
    context.add_object()
    with pytest.raises(RuntimeError, match="add_mesh_vertices"):
        context.finalize_object_mesh(1)
    context.add_mesh_vertices([0, 0, 0, 1, 0, 0, 0, 1, 0])
    context.add_mesh_indices([0, 1, 7], 3, "wall")
    with pytest.raises(RuntimeError, match=r"reach 0\.\.7"):
        context.finalize_object_mesh(1)
    for name, value in (("sample_rate", 1000.0), ("frequency_bands", 0), ("max_ir_length", 0.0)):
        odd = room(quick(**{name: value}), [(1, 1, 1)], [((4, 3, 1.5), MONO)])
        with pytest.raises(RlrError, match=name):
            odd.simulate()
    context.simulate()
    with pytest.raises(RuntimeError, match="channel 3"):
        context.get_ir_channel(0, 0, 3)


def test_rays_meet_the_box() -> None:
    context = room(quick(), [], [])
    ray = Ray(origin=[3.0, 2.0, 1.0], direction=[2.0, 0.0, 0.0], t_max=100.0)
    context.trace_ray_first_hit(ray)
    assert ray.hit
    assert ray.t_max == pytest.approx(1.5)
    assert ray.normal == pytest.approx([-1.0, 0.0, 0.0])
    for far, hit in ((1.4, False), (1.6, True)):
        ray = Ray(origin=[3.0, 2.0, 1.0], direction=[2.0, 0.0, 0.0], t_max=far)
        context.trace_ray_any_hit(ray)
        assert ray.hit is hit
        assert ray.t_max == far
    with pytest.raises(RuntimeError, match="length"):
        context.trace_ray_any_hit(Ray(origin=[1, 1, 1], direction=[0, 0, 0], t_max=1.0))


def test_polygons_files_and_boxes_make_the_same_room(tmp_path: Path) -> None:
    """A box, its six quadrilaterals, and the OBJ that the context writes sound the same."""
    sides = BoxMaterialCategories(*["default"] * 6)
    corners = np.array(list(np.ndindex(2, 2, 2)), float) * SIZE
    quads = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
    contexts = [Context(quick()) for _ in range(3)]
    for context in contexts:
        context.add_object()
    contexts[0].set_object_box(0, [0, 0, 0], SIZE, sides)
    contexts[1].add_mesh_vertices(corners.ravel().tolist())
    contexts[1].add_mesh_indices(quads, 4, "default")
    contexts[1].finalize_object_mesh(0)
    contexts[0].write_scene_mesh_obj(str(tmp_path / "box.obj"))
    contexts[2].set_object_mesh_obj(0, str(tmp_path / "box.obj"), "default")
    heard = []
    for context in contexts:
        context.add_source()
        context.set_source_position(0, [1.5, 1.0, 1.2])
        context.add_listener(MONO)
        context.set_listener_position(0, [4.0, 3.0, 1.5])
        context.simulate()
        assert context.get_indirect_ray_efficiency() > 0.99
        heard.append(response(context))
    energy = [(h**2).sum() for h in heard]
    assert np.array_equal(heard[0], heard[1])
    assert energy[2] == pytest.approx(energy[0], rel=0.3)  # trimesh may put vertices in another order


def test_wave_and_metrics_files(tmp_path: Path) -> None:
    import soundfile

    context = room(quick(), [(1.5, 1.0, 1.2)], [((4.0, 3.0, 1.5), foa())])
    context.simulate()
    context.write_ir_wave(0, 0, str(tmp_path / "ir.wav"))
    written, rate = soundfile.read(tmp_path / "ir.wav")
    assert rate == 16000
    np.testing.assert_allclose(written.T, response(context), atol=1e-7)
    context.write_ir_metrics(0, 0, str(tmp_path / "ir"))
    tables = sorted(p.name for p in tmp_path.glob("ir ch*"))
    assert tables == [f"ir ch{c} etc.txt" for c in range(4)]
    rows = (tmp_path / "ir ch0 etc.txt").read_text().splitlines()
    assert [float(v) for v in rows[0].split("\t")[1:]] == pytest.approx(
        [83.9, 369.3, 1625.4, 8257.1], rel=1e-3
    )
    table = np.array([[float(v) for v in row.split("\t")] for row in rows[1:]])
    np.testing.assert_allclose(np.diff(table[:, 0]), 0.005, atol=1e-6)
    assert (table[:10, 1:].max(axis=0) > table[-3:, 1:].max(axis=0) + 8.0).all()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("global_volume", math.nan), ("global_volume", math.inf), ("frequency_bands", 0), ("frequency_bands", 10**9),
        ("indirect_ray_count", 10**15), ("indirect_ray_depth", 10**15), ("max_ir_length", 1e9),
        ("max_ir_length", math.nan), ("unit_scale", 0.0), ("unit_scale", math.nan), ("unit_scale", 1e300),
        ("sample_rate", math.nan), ("sample_rate", 1e12), ("indirect_ray_count", -1),
    ],
)  # fmt: skip
def test_settings_that_cannot_be(name: str, value: float) -> None:
    """Before anything is simulated."""
    context = room(quick(), [[1, 1, 1]], [([2, 2, 1], MONO)])
    setattr(context.config, name, value)
    with pytest.raises(RlrError, match=rf"Config\.{name}: expected .* to .*, got"):
        context.simulate()


def test_places_and_layouts_that_cannot_be(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RlrError, match="1 to 1024 channels, got Ambisonics and 1000000000"):
        Context(Config()).add_listener(ChannelLayout(ChannelLayoutType.Ambisonics, 10**9))
    context = room(quick(), [[1, 1, 1]], [([2, 2, 1], MONO)])
    context.set_source_position(0, [1e300, 0.0, 0.0])
    with pytest.raises(RlrError, match=r"source 0 is at .* m, where 1e\+06 m is the farthest"):
        context.simulate()
    context = room(quick(), [[1, 1, 1]], [([2, 2, 1], MONO)])
    monkeypatch.setattr("soundspaces_rlr.arguments.free_memory", lambda: 1e3)
    with pytest.raises(RlrError, match=r"the responses take .* GB of memory, and 0\.0 GB are free"):
        context.simulate()


@pytest.mark.parametrize("kind", ["obj", "ply"])
def test_a_mesh_that_is_a_fifo(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"x.{kind}"
    os.mkfifo(path)
    context = Context(Config())
    context.add_object()
    load = getattr(context, f"set_object_mesh_{kind}")
    with pytest.raises(RlrError, match="not a regular file"):
        load(0, str(path), "default")


def test_a_far_source_is_told() -> None:
    context = Context(quick())
    context.add_source()
    context.add_listener(MONO)
    context.set_source_position(0, [5e5, 0.0, 0.0])
    context.set_listener_position(0, [0.0, 0.0, 0.0])
    with pytest.raises(RuntimeError, match="sound goes 500,000 m between two points"):
        context.simulate()


def test_bins_are_kept_raw_as_in_the_original() -> None:
    assert simulation_config(Config()).denoise is False
