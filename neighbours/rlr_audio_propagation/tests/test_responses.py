"""What a context's responses contain."""

from pathlib import Path

import numpy as np
import pytest
from soundspaces_rlr.api import BoxMaterialCategories, Config, Context
from soundspaces_rlr.propagation import group_listeners

from neighbours.rlr_audio_propagation.tests.rooms import (
    BINAURAL,
    MONO,
    SIZE,
    foa,
    material,
    populate,
    quick,
    response,
    room,
    write_database,
)
from soundspaces_sim.core.numerics.air import absorption
from soundspaces_sim.core.numerics.bands import DEFAULT_BANDS
from soundspaces_sim.echogram.filters import band_windows
from soundspaces_sim.echogram.measures import reverberation_times
from soundspaces_sim.rendering.decoder import equalised_spectra
from soundspaces_sim.rendering.hrtf import load_hrtf

C = 343.0
SOURCE, EAR = (1.5, 1.0, 1.2), (4.0, 3.0, 1.5)


def free(config: Config, sources: object, listeners: object) -> Context:
    """A context without objects."""
    context = populate(Context(config), sources, listeners)  # type: ignore[arg-type]
    context.simulate()
    return context


def arrival(signal: np.ndarray, rate: float) -> float:
    """Delay in s of a lone pulse, from the phase of its spectrum below 4 kHz."""
    size = 4 * len(signal)
    spectrum = np.fft.rfft(signal, size)
    frequency = np.fft.rfftfreq(size, 1.0 / rate)
    use = (frequency > 200.0) & (frequency < 4000.0)
    return float(-np.polyfit(2.0 * np.pi * frequency[use], np.unwrap(np.angle(spectrum))[use], 1)[0])


@pytest.mark.parametrize("distance", [0.5, 3.0, 7.3])
def test_direct_sound_in_the_free_field(distance: float) -> None:
    context = free(quick(sample_rate=44100.0), [(distance, 0, 0)], [((0, 0, 0), MONO)])
    (signal,) = response(context)
    assert arrival(signal, 44100.0) == pytest.approx(distance / C, abs=2e-5)
    spectrum = np.abs(np.fft.rfft(signal, 65536))
    frequency = np.fft.rfftfreq(65536, 1.0 / 44100.0)
    band = spectrum[(frequency > 300.0) & (frequency < 3000.0)]
    np.testing.assert_allclose(band, np.sqrt(1.0 / (4.0 * np.pi)) / distance, rtol=0.02)
    first = int(np.flatnonzero(signal)[0])
    assert 0 <= distance / C * 44100.0 - first <= 8


def test_ambisonics_are_acn_n3d_in_world_axes() -> None:
    """(0.6, 0.48, 0.64) as the original encodes it, whatever way the listener is turned."""
    direction = np.array([0.6, 0.48, 0.64])
    expected = np.array(
        [0.0970, 0.0806, 0.1075, 0.1008, 0.1081, 0.1154, 0.0248, 0.1442, 0.0243,
         0.0827, 0.1831, 0.0790, -0.0781, 0.0988, 0.0412, -0.0403]
    ) / 0.0970  # fmt: skip
    context = populate(
        Context(quick()), [tuple(3.0 * direction)], [((0, 0, 0), foa(16)), ((0, 5, 0), foa(5))]
    )
    context.set_listener_orientation_quaternion(0, [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    context.simulate()
    signal = response(context)
    peak = int(np.abs(signal[0]).argmax())
    np.testing.assert_allclose(signal[:, peak] / signal[0, peak], expected, atol=0.005)
    assert response(context, 1).shape[0] == 5
    config = quick(direct_sh_order=1)
    low = response(free(config, [(1, 2, 2)], [((0, 0, 0), foa(9))]))
    assert low[:4].any(axis=1).all()
    assert not low[4:].any()


def test_ears_are_where_the_axes_and_the_quaternion_put_them() -> None:
    """Sound from +x: at the right ear by default; behind a head turned to -x; on the left of one upside down."""

    def ears(turn: tuple[float, ...] | None = None, **axes: object) -> np.ndarray:
        context = populate(Context(quick(**axes)), [(3, 0, 0)], [((0, 0, 0), BINAURAL)])
        if turn is not None:
            context.set_listener_orientation_quaternion(0, turn)
        context.simulate()
        return np.asarray((response(context) ** 2).sum(axis=1))

    left, right = ears()
    assert right > 4.0 * left
    half = np.sqrt(0.5)
    left, right = ears((half, 0.0, half, 0.0))  # about y by 90 degrees: front -z goes to -x
    assert left == pytest.approx(right, rel=0.15)
    left, right = ears((0.0, 0.0, 0.0, 1.0))
    assert left > 4.0 * right
    left, right = ears(hrtf_right=[0, -1, 0], hrtf_up=[0, 0, 1], hrtf_back=[-1, 0, 0])  # faces +x, Z up
    assert left == pytest.approx(right, rel=0.15)
    with pytest.raises(RuntimeError, match="right-handed"):
        ears(hrtf_right=[-1, 0, 0])


def _octave_levels(signal: np.ndarray) -> np.ndarray:
    """(C, octaves) dB from 125 Hz to 8 kHz, of (C, n) at 44.1 kHz."""
    size = 1 << 16
    power = np.abs(np.fft.rfft(signal, size)) ** 2
    f = np.fft.rfftfreq(size, 1.0 / 44100.0)
    octaves = [(f >= o / 2**0.5) & (f < o * 2**0.5) for o in 125.0 * 2.0 ** np.arange(7)]
    return np.array([10.0 * np.log10(power[:, use].mean(axis=1)) for use in octaves]).T


@pytest.mark.parametrize("azimuth", [0.0, 30.0, 60.0, 90.0, 120.0, 180.0])
def test_ears_hear_what_the_hrtf_has(azimuth: float) -> None:
    """Source at `azimuth` to the left: of either ear the level of every octave, which zeros before the onset leave
    whole, and the interaural level from 250 Hz up (below the set is weak, and a rigid head stands in) are those of the
    measured head; equalisation weighs the parts of an octave otherwise than it was measured. Ears have 4 pi times the
    energy of a microphone, as the original's."""
    turn = np.deg2rad(azimuth)
    place = (-2.0 * np.sin(turn), 0.0, -2.0 * np.cos(turn))
    config = quick(sample_rate=44100.0)
    ears = _octave_levels(response(free(config, [place], [((0, 0, 0), BINAURAL)])))
    mono = _octave_levels(response(free(config, [place], [((0, 0, 0), MONO)])))
    hrtf = load_hrtf()
    row = int((hrtf.directions @ [np.cos(turn), np.sin(turn), 0.0]).argmax())
    own = _octave_levels(np.roll(np.fft.irfft(equalised_spectra(hrtf)[row]), 1024, axis=1))
    np.testing.assert_allclose(ears - mono - 10.0 * np.log10(4.0 * np.pi), own, atol=0.6)
    measured = _octave_levels(hrtf.ir[row])
    np.testing.assert_allclose((ears[0] - ears[1])[1:], (measured[0] - measured[1])[1:], atol=1.5)
    if 20.0 < azimuth < 160.0:
        assert (ears[0] > ears[1]).all()


def test_octaves_of_a_response_at_the_ears_are_whole() -> None:
    """In a room the energy of both ears over a microphone's is that of a diffuse field, 11 dB, within 2 dB in every
    octave: the direct sound and reflections of one pair are not quite diffuse."""
    context = room(quick(sample_rate=44100.0), [SOURCE], [(EAR, BINAURAL), (EAR, MONO)])
    context.simulate()
    ears, mono = (_octave_levels(response(context, l)) for l in range(2))
    both = 10.0 * np.log10((10.0 ** (ears / 10.0)).mean(axis=0))
    np.testing.assert_allclose(both - mono[0], 10.0 * np.log10(4.0 * np.pi), atol=2.0)


def test_scale_volume_and_flags() -> None:
    plain = response(free(quick(), [(3, 0, 0)], [((0, 0, 0), MONO)]))
    np.testing.assert_allclose(
        response(free(quick(global_volume=0.5), [(3, 0, 0)], [((0, 0, 0), MONO)])), 0.5 * plain
    )
    scaled = response(free(quick(unit_scale=0.3), [(10, 0, 0)], [((0, 0, 0), MONO)]))
    np.testing.assert_allclose(scaled, plain, atol=1e-12)
    assert not response(free(quick(direct=0), [(3, 0, 0)], [((0, 0, 0), MONO)])).any()

    first = {}
    for name, settings in (("all", {}), ("late", {"direct": 0}), ("direct", {"indirect": 0})):
        context = room(quick(**settings), [SOURCE], [(EAR, MONO)])
        context.simulate()
        first[name] = np.pad(response(context)[0], (0, 4800))[:4800]
    np.testing.assert_allclose(first["late"] + first["direct"], first["all"], atol=2e-6)


def test_the_longest_response_is_cut() -> None:
    context = room(quick(max_ir_length=0.12), [SOURCE], [(EAR, MONO)])
    context.simulate()
    assert context.get_ir_sample_count(0, 0) <= 0.12 * 16000


def test_nothing_sounds_before_the_shortest_path() -> None:
    """Exact zeros, in every layout, seen or not; channels of one listener begin together."""
    context = room(
        quick(), [SOURCE, (5.0, 4.0, 1.0)], [(EAR, MONO), (EAR, foa()), ((2, 4, 1), BINAURAL)]
    )
    context.simulate()
    listeners = np.array([EAR, EAR, (2, 4, 1)], float)
    for l in range(3):
        for s, source in enumerate((SOURCE, (5.0, 4.0, 1.0))):
            due = np.linalg.norm(np.subtract(source, listeners[l])) / C * 16000.0
            lead = 8 + (0.0003 * 16000.0 if l == 2 else 0.0)
            begins = [int(np.flatnonzero(c)[0]) for c in response(context, l, s)]
            assert due - lead - 1 <= min(begins)
            assert max(begins) - min(begins) < 10
            assert max(begins) <= due + 1


def test_same_calls_same_bits_for_any_threads_and_company() -> None:
    """Again, with two threads, and with more sources and far listeners: the pair's response is the same."""
    once = room(quick(), [SOURCE], [(EAR, foa())])
    once.simulate()
    before = response(once)
    once.simulate()
    assert np.array_equal(response(once), before)
    crowd = room(
        quick(thread_count=2), [(5.0, 4.0, 1.0), SOURCE], [((1.0, 4.0, 1.0), MONO), (EAR, foa())]
    )
    crowd.simulate()
    assert np.array_equal(
        response(crowd, 1, 1)[:, : before.shape[1]], before[:, : crowd.get_ir_sample_count(1, 1)]
    )


def test_groups_of_listeners() -> None:
    spots = np.array([[0, 0, 0], [0.1, 0, 0], [2, 0, 0], [0.2, 0, 0], [2.25, 0, 0], [0.31, 0, 0]], float)
    groups = group_listeners(spots)
    assert [g.members for g in groups] == [(0, 1, 3), (2, 4), (5,)]
    assert groups[0].place == 1  # nearest to the middle


def test_capsules_of_an_array_hear_one_field() -> None:
    """Capsules 3 cm apart: coherent below 1 kHz (k r < 0.6), direct sound at its own time, alike in level
    with a listener on its own."""
    capsules = [
        np.add(EAR, offset).tolist() for offset in ([0, 0, 0], [0.03, 0, 0], [0, 0.03, 0], [0, 0, 0.03])
    ]
    context = room(quick(), [SOURCE], [(c, MONO) for c in capsules])
    context.simulate()
    signals = np.array([response(context, l)[0] for l in range(4)])
    late = np.fft.rfft(signals[:, 800:], axis=1)
    frequency = np.fft.rfftfreq(signals.shape[1] - 800, 1.0 / 16000.0)
    low = late[:, (frequency > 150.0) & (frequency < 1000.0)]
    for other in low[1:]:
        cross = (low[0] * other.conj()).sum().real
        assert cross > 0.9 * np.sqrt((np.abs(low[0]) ** 2).sum() * (np.abs(other) ** 2).sum())
    assert len(np.unique(signals, axis=0)) == 4
    alone = room(quick(), [SOURCE], [(EAR, MONO)])
    alone.simulate()
    level = 10.0 * np.log10((signals[0] ** 2).sum() / (response(alone) ** 2).sum())
    assert abs(level) < 1.0


def free_paths(size: tuple[float, ...], count: int) -> np.ndarray:
    """Lengths of paths between walls of a box, from walls everywhere alike, by Lambert's law."""
    random, box = np.random.default_rng(0), np.array(size)
    area = np.prod(box) / box
    axis = random.choice(3, count, p=area / area.sum())
    rows = np.arange(count)
    place = random.uniform(0.0, box, (count, 3))
    place[rows, axis] = 0.0
    sine, turn = np.sqrt(random.uniform(size=count)), random.uniform(0.0, 2.0 * np.pi, count)
    direction = np.empty((count, 3))
    direction[rows, axis] = np.sqrt(1.0 - sine**2)
    direction[rows, (axis + 1) % 3], direction[rows, (axis + 2) % 3] = (
        sine * np.cos(turn),
        sine * np.sin(turn),
    )
    wall = np.where(direction > 0.0, box - place, -place)
    return np.asarray((wall / direction).min(axis=1))


def test_reverberation_time_is_kuttruffs(tmp_path: Path) -> None:
    """T30 of 16 places where walls scatter all they reflect: Eyring's, corrected for the variance of free paths
    (Kuttruff, Room Acoustics, 5th ed., eq. 5.42), within 3 %."""
    database = write_database(tmp_path / "m.json", material("wall", 0.2, 1.0))
    config = quick(indirect_ray_count=2000, max_ir_length=0.6)
    listeners = [((0.8 + 1.4 * i, 0.8 + 1.1 * j, 1.2), MONO) for i in range(4) for j in range(4)]
    context = room(config, [(1.1, 1.3, 1.6)], listeners, database)
    context.simulate()
    signals = context.get_audio()[:, 0, 0]
    spectrum = np.fft.rfft(
        signals, 2 * signals.shape[1], axis=1
    )  # twice: the filter's ringing must not wrap
    frequency = np.fft.rfftfreq(2 * signals.shape[1], 1.0 / 16000.0)
    spectrum *= np.sqrt(band_windows(DEFAULT_BANDS, frequency, 16000.0)[2])
    energy = (np.fft.irfft(spectrum, axis=1)[:, : signals.shape[1]] ** 2).sum(axis=0)
    t30 = float(reverberation_times(energy, 1.0 / 16000.0, -5.0, -35.0)[0])
    paths, log = free_paths(SIZE, 200_000), np.log(1.0 - 0.2)
    volume, surface = 6.0 * 5.0 * 2.7, 2.0 * (6 * 5 + 6 * 2.7 + 5 * 2.7)
    assert paths.mean() == pytest.approx(4.0 * volume / surface, rel=0.01)
    walls = -log * (1.0 + 0.5 * paths.var() / paths.mean() ** 2 * log)
    air = absorption([1625.4], 20.0, 50.0, 101.325)[0]  # 1/m
    assert t30 == pytest.approx(6.0 * np.log(10.0) / C / (walls / paths.mean() + air), rel=0.03)


@pytest.mark.parametrize("turn", [0.0, 0.3, 1.1])
def test_a_listener_on_a_surface_hears_the_direct_sound(turn: float) -> None:
    """Places on the faces of a box in the room, sources in front of them: 1 / (4 pi r²) at each of 40."""
    random, half = np.random.default_rng(0), np.array([0.4, 0.3, 0.35])
    about = np.array(
        [[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]]
    )
    context = room(quick(indirect=0, max_ir_length=0.05), [], [])
    context.add_object()
    context.set_object_box(1, (-half).tolist(), half.tolist(), BoxMaterialCategories())
    context.set_object_position(1, [2.1, 1.4, 0.36])
    context.set_object_orientation_quaternion(1, [np.cos(turn / 2), 0, 0, np.sin(turn / 2)])
    for k in range(40):
        axis, place = k % 3, random.uniform(-0.9, 0.9, 3)
        place[axis] = 1.0 if axis == 2 or k % 2 else -1.0
        normal = about @ (np.eye(3)[axis] * place[axis])
        place = about @ (place * half) + [2.1, 1.4, 0.36]
        source = place + random.uniform(0.2, 0.5) * (normal + random.uniform(-0.4, 0.4, 3))
        context.clear_sources()
        context.clear_listeners()
        populate(context, [source], [(place, MONO)])
        context.simulate()
        level = np.sqrt((response(context) ** 2).sum()) * np.linalg.norm(source - place)
        assert level == pytest.approx(np.sqrt(1.0 / (4.0 * np.pi)), rel=0.1), k


def test_objects_that_move_change_what_is_heard() -> None:
    """A wall between source and listener takes the direct sound away; moved aside, it gives it back."""
    context = Context(quick(indirect=0))
    context.add_object()
    context.add_mesh_vertices([1, -1, -1, 1, 1, -1, 1, 1, 1, 1, -1, 1])
    context.add_mesh_indices([0, 1, 2, 3], 4, "default")
    context.finalize_object_mesh(0)
    populate(context, [(0, 0, 0)], [((2, 0, 0), MONO)])
    context.simulate()
    assert not response(context).any()
    context.set_object_position(0, [0, 5, 0])
    context.simulate()
    assert response(context).any()
    context.set_object_position(0, [0, 0, 0])
    context.set_object_orientation_quaternion(
        0, [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
    )  # about z: x = 1 to y = 1
    context.simulate()
    assert response(context).any()
    context.set_object_position(0, [0, -1, 0])  # now it stands on the path, edge on
    scene = context._propagation
    context.set_source_position(0, [0, -2, 0])
    context.set_listener_position(0, [0, 2, 0])
    context.simulate()
    assert not response(context).any()
    assert context._propagation is not scene
    kept = context._propagation
    context.set_source_position(0, [0, -3, 0])  # sources and listeners change nothing in the scene
    context.simulate()
    assert context._propagation is kept


def test_moving_a_listener_gives_what_a_fresh_context_gives() -> None:
    """What is kept between simulations leaves no trace in results."""
    moved = room(quick(), [SOURCE], [((5.0, 1.0, 2.0), foa())])
    moved.simulate()
    moved.set_listener_position(0, EAR)
    moved.simulate()
    fresh = room(quick(), [SOURCE], [(EAR, foa())])
    fresh.simulate()
    assert np.array_equal(response(moved), response(fresh))


def test_temporal_coherence_keeps_the_noise_as_things_move() -> None:
    """With the flag a step of 1 cm leaves the late waveform nearly as it was; without it noise is drawn anew."""

    def likeness(flag: int) -> float:
        context = room(quick(temporal_coherence=flag), [SOURCE], [(EAR, MONO)])
        context.simulate()
        a = response(context)[0, 800:4000]
        context.set_listener_position(0, np.add(EAR, [0.01, 0.0, 0.0]).tolist())
        context.simulate()
        b = response(context)[0, 800:4000]
        return float((a * b).sum() / np.sqrt((a**2).sum() * (b**2).sum()))

    assert likeness(1) > 0.6
    assert abs(likeness(0)) < 0.3
