"""Rooms by pyroomacoustics' names: its levels, delays and shapes, and rooms whose answer is known."""

from pathlib import Path

import numpy as np
import pytest
import soundfile

from soundspaces_sim.core.errors import SceneError
from soundspaces_sim.rlr import pyroom as pra
from soundspaces_sim.rlr.errors import RlrError
from soundspaces_sim.scene.polygons import newell_normal, triangulate

C, FS = 343.0, 16000


def level(h: np.ndarray, at: float, width: int = 12) -> float:
    """The amplitude, between 0.5 and 2 kHz, of what arrives about a sample."""
    first = round(at) - width // 2
    piece = np.zeros(1024)
    piece[:width] = h[first : first + width]
    spectrum = np.abs(np.fft.rfft(piece))
    f = np.fft.rfftfreq(1024, 1 / FS)
    return float(spectrum[(f > 500) & (f < 2000)].mean())


def test_direct_sound_and_first_mirror_are_pyroomacoustics() -> None:
    """1 / r at r / c, 40 samples late, as measured on pyroomacoustics 0.10; a wall takes sqrt(1 - a)."""
    room = pra.ShoeBox([7.0, 6.0, 5.0], fs=FS, materials=pra.Material(0.36), max_order=0)
    room.add_source([2.0, 3.0, 2.5]).add_microphone([4.0, 3.0, 2.5])
    room.compute_rir()
    assert room.rir is not None
    (direct,) = room.rir[0]
    onset = 2.0 / C * FS + pra.LEAD
    assert abs(int(np.abs(direct).argmax()) - onset) <= 1.0
    assert level(direct, onset, 32) == pytest.approx(0.5, rel=0.04)
    walls = dict.fromkeys(("west", "south", "north", "floor", "ceiling"), 0.999) | {"east": 0.36}
    room = pra.ShoeBox([7.0, 6.0, 5.0], fs=FS, materials=pra.make_materials(**walls), max_order=3)
    room.add_source([2.0, 3.0, 2.5]).add_microphone([4.0, 3.0, 2.5])
    room.compute_rir()
    assert room.rir is not None
    path = 5.0 + 3.0  # by the mirror image at x = 12
    # the air takes 0.05 dB at most on 8 m below 2 kHz
    assert level(room.rir[0][0], path / C * FS + pra.LEAD, 32) == pytest.approx(0.8 / path, rel=0.06)


def test_the_decay_is_sabines_in_a_diffuse_room() -> None:
    """Absorption by `inverse_sabine`, walls that scatter all: the measured time, against Eyring's for that absorption,
    which mean free paths of equal length would give; Kuttruff's correction for their spread adds some 5 % (gamma² = 0.4),
    air takes some off."""
    absorption, order = pra.inverse_sabine(0.5, [6.0, 5.0, 4.0])
    assert absorption == pytest.approx(0.161 * 120.0 / (148.0 * 0.5), rel=2e-3)
    assert order == int(np.ceil(C * 0.5 / (4 * 5 / np.hypot(4, 5)) - 1))
    room = pra.ShoeBox(
        [6.0, 5.0, 4.0], fs=8000, materials=pra.Material(absorption, 1.0), max_order=order
    )
    room.add_source([1.0, 1.0, 1.0]).add_microphone(np.array([[4.0, 2.0], [3.0, 4.0], [1.5, 2.5]]))
    times = room.measure_rt60(decay_db=30)
    assert times.shape == (2, 1)
    assert room.rt60_theory() == pytest.approx(0.5, rel=1e-3)
    eyring = room.rt60_theory("eyring")
    assert np.abs(times / eyring - 1.03).max() < 0.12
    with pytest.raises(ValueError, match="cannot have"):
        pra.inverse_sabine(0.01, [6.0, 5.0, 4.0])


def test_rt60_of_an_exponential_is_its_own() -> None:
    t = np.arange(16000) / FS
    for seconds in (0.2, 0.6):
        h = 10.0 ** (-3.0 * t / seconds)
        assert pra.measure_rt60(h, FS, 30) == pytest.approx(seconds, rel=1e-3)
    assert np.isnan(pra.measure_rt60(np.zeros(10), FS))


def test_a_share_of_the_energy_leaves_the_tail_out() -> None:
    """An exponential with noise of -50 dB after it: the whole energy bends up, 99.9 % of it does not."""
    t = np.arange(2 * FS) / FS
    h = 10.0 ** (-3.0 * t / 0.5)
    noisy = np.sqrt(h**2 + 1e-5 * (h @ h) / len(h))
    assert pra.measure_rt60(noisy, FS, 50) > 0.6
    # Schroeder's integral less a constant k bends down by 10 lg(1 - k 10^(L/10)): 0.5 dB at L = -20 dB for k = 0.1 %
    assert pra.measure_rt60(noisy, FS, 15, energy_thres=0.999) == pytest.approx(0.5, rel=0.05)


def test_materials_of_the_same_numbers_at_other_frequencies_are_two() -> None:
    """Sabine's time at 1 kHz of walls of two materials, told apart by frequencies alone."""
    low, high = (
        pra.Material({"coeffs": [0.1, 0.5], "center_freqs": at}) for at in ([125, 1000], [1000, 8000])
    )
    walls = dict.fromkeys(("west", "east", "south", "north"), low) | {"floor": high, "ceiling": high}
    room = pra.ShoeBox([5.0, 4.0, 3.0], materials=walls)
    absorbed = 0.5 * 2 * (5 * 3 + 4 * 3) + 0.1 * 2 * 20
    assert room.rt60_theory() == pytest.approx(24 * np.log(10) / C * 60 / absorbed, rel=1e-9)
    assert pra.ShoeBox([5.0, 4.0, 3.0]).rt60_theory() == np.inf
    assert pra.ShoeBox([5.0, 4.0, 3.0], materials=pra.Material(1.0)).rt60_theory("eyring") == 0.0


def test_signals_are_convolved_delayed_and_summed(tmp_path: Path) -> None:
    room = pra.ShoeBox([5.0, 4.0, 3.0], fs=FS, materials=pra.Material(0.4), max_order=0)
    draw = np.random.default_rng(1)
    signals = draw.standard_normal((2, 400))
    room.add_source([1.0, 1.0, 1.0], signal=signals[0])
    room.add_source(pra.SoundSource(np.array([4.0, 3.0, 2.0]), signals[1], 0.01))
    room.add_microphone_array(pra.MicrophoneArray(np.array([[2.5, 2.6], [2.0, 2.0], [1.5, 1.5]]), FS))
    premix = room.simulate(return_premix=True)
    assert room.rir is not None and room.mic_array is not None and premix is not None
    assert room.mic_array.signals is not None
    expected = np.convolve(np.concatenate([np.zeros(160), signals[1]]), room.rir[1][1])
    np.testing.assert_allclose(premix[1, 1, : len(expected)], expected, atol=1e-12)
    np.testing.assert_allclose(room.mic_array.signals, premix.sum(axis=0))
    clean = room.mic_array.signals
    room.simulate(snr=10.0)
    noise = room.mic_array.signals - clean
    ratio = (clean[0] ** 2).mean() / (noise**2).mean()
    assert 10.0 * np.log10(ratio) == pytest.approx(
        10.0, abs=4 * 10 / np.log(10) * np.sqrt(2 / noise.size)
    )
    room.mic_array.to_wav(tmp_path / "a.wav", norm=True, bitdepth=np.int16)
    sound, rate = soundfile.read(tmp_path / "a.wav")
    assert rate == FS and np.abs(sound).max() == pytest.approx(1.0, abs=1e-4)


def test_a_polygon_is_a_prism_with_walls_by_number() -> None:
    """An L of 20 m²: volume, area and what is inside; its floor's two triangulations do not matter."""
    corners = np.array([[0, 6, 6, 2, 2, 0], [0, 0, 2, 2, 6, 6]], float)
    room = pra.Room.from_corners(corners, fs=8000, max_order=2, materials=pra.Material(0.3, 0.2))
    with pytest.raises(RlrError, match="extrude"):
        room.add_microphone([1.0, 1.0, 1.0])
    room.extrude(3.0, materials=pra.make_materials(floor=0.1, ceiling=(0.6, 0.5)))
    assert room.volume == pytest.approx(60.0)
    assert room.is_inside([1.0, 5.0, 1.0]) and not room.is_inside([4.0, 4.0, 1.0])
    surface, absorbed = 24 * 3 + 40, 0.3 * 72 + 0.1 * 20 + 0.6 * 20
    assert room.rt60_theory() == pytest.approx(24 * np.log(10) / C * 60 / absorbed, rel=1e-9)
    assert surface == 112
    room.add_source([1.0, 5.0, 1.5]).add_microphone([5.0, 1.0, 1.5])
    room.compute_rir()
    assert room.rir is not None
    hidden = (
        np.hypot(4.0, 4.0) / C * 8000 + pra.LEAD
    )  # the corner at (2, 2) is on the straight line: just not seen
    assert np.isfinite(room.rir[0][0]).all() and np.abs(room.rir[0][0]).argmax() > hidden - 2


def test_polygons_are_cut_into_triangles_of_their_area() -> None:
    """Stars, combs and planes askew: areas add up, all triangles turn as the polygon does."""
    draw = np.random.default_rng(3)
    for count in (3, 4, 9, 40):
        angle = np.sort(draw.uniform(0, 2 * np.pi, count))
        radius = draw.uniform(0.3, 2.0, count)
        flat = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(count)])
        if np.diff(np.append(angle, angle[0] + 2 * np.pi)).max() >= np.pi:
            flat = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
        turn, _ = np.linalg.qr(draw.normal(size=(3, 3)))
        corners = flat @ turn.T + draw.normal(size=3)
        triangles = triangulate(corners, "star")
        assert triangles.shape == (count - 2, 3)
        whole = newell_normal(corners)
        parts = np.array([newell_normal(corners[t]) for t in triangles])
        np.testing.assert_allclose(parts.sum(axis=0), whole, atol=1e-9)
        assert (parts @ whole >= -1e-9).all()
    teeth = [[0, 0], [7, 0], [7, 2], [6, 2], [6, 1], [5, 1], [5, 2], [4, 2], [4, 1], [0, 1]]
    comb = np.column_stack([np.array(teeth, float), np.zeros(10)])
    assert np.abs([newell_normal(comb[t])[2] for t in triangulate(comb, "comb")]).sum() == pytest.approx(
        2 * 9.0
    )
    for bad, message in (
        ([[0, 0, 0], [1, 0, 0]], "3 to"),
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], "no area"),
        ([[0, 0, 0], [4, 3, 0], [4, 0, 0], [0, 2, 0]], "cross"),
        (np.full((3, 3), np.nan), "no area"),
    ):
        with pytest.raises(SceneError, match=message):
            triangulate(np.array(bad, float), "polygon")


def test_what_cannot_be_is_said() -> None:
    room = pra.ShoeBox(
        [5.0, 4.0, 3.0],
        fs=FS,
        materials=pra.Material({"coeffs": [0.1, 0.2], "center_freqs": [125, 4000]}),
    )
    for call, message in (
        (lambda: room.add_source([6.0, 1.0, 1.0]), "not in the room"),
        (lambda: room.add_source([np.nan, 1.0, 1.0]), "finite"),
        (lambda: room.compute_rir(), "needs a source"),
        (lambda: pra.ShoeBox([5.0, 4.0]), "three-dimensional"),
        (lambda: pra.ShoeBox([5.0, 4.0, 3.0], materials={"east": pra.Material(0.1)}), "one for each"),
        (lambda: pra.Material({"coeffs": [0.1, 0.2], "center_freqs": [100]}), "as many"),
        (lambda: pra.Material(1.5), "absorption"),
        (lambda: pra.Material("unobtainium"), "unobtainium"),
        (lambda: room.add_source([1, 1, 1], directivity=object()), "directivity"),
        (lambda: pra.Room.from_corners(np.eye(3)), "corners"),
        (lambda: pra.ShoeBox([5.0, 4.0, 3.0], fs=np.nan), "fs"),
        (lambda: pra.ShoeBox([5.0, 4.0, 3.0], max_order=-1), "max_order"),
        (lambda: pra.ShoeBox([5.0, np.nan, 3.0]), "5.0, nan"),
        (lambda: room.add_source(np.ones((3, 2))), "one place"),
        (lambda: room.add_source([1, 1, 1], signal=[0.0, np.nan]), "finite samples"),
        (lambda: room.add_source([1, 1, 1], delay=-1.0), "delay"),
        (lambda: room.add_microphone([1, 1, 1], fs=8000), "the room is at 16000"),
        (lambda: pra.measure_rt60(np.array([1.0, np.nan]), FS), "finite samples"),
        (lambda: pra.measure_rt60(np.ones(4), FS, plot=True), "no plots"),
        (lambda: pra.measure_rt60(np.ones(4), FS, energy_thres=0.0), "share"),
    ):
        with pytest.raises(RlrError, match=message):
            call()
