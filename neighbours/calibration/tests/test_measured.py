"""Measured rooms from files: what is read, and one clear line for what is not."""

from __future__ import annotations

import csv
import os
from pathlib import Path

import h5py
import numpy as np
import pytest
import soundfile
import soundspaces_calibration as cal
from soundspaces_calibration.measured.collect import Places
from soundspaces_calibration.report import _cell

from soundspaces_sim.core.errors import DatasetError

PLACES = "source_x,source_y,source_z,receiver_x,receiver_y,receiver_z"
HEAD = f"source,receiver,{PLACES},octave_hz,t30,edt,c80,d50,t30_error"
ROW = "S1,R1,1,2,1.5,3,4,1.2,{octave},{t30},0.8,2.5,0.6,{error}"
RATE = 8000


def _table(folder: Path, *lines: str, head: str = HEAD, name: str = "room.csv") -> Path:
    path = folder / name
    path.write_text("\n".join([head, *lines]) + "\n")
    return path


def test_a_table_of_parameters(tmp_path: Path) -> None:
    """Octaves between those that were given are there without values; an empty cell is not measured."""
    path = _table(
        tmp_path,
        ROW.format(octave=250, t30=0.9, error=0.02),
        ROW.format(octave=1000, t30="", error=""),
        "S1,R2,1,2,1.5,5,4,1.2,1000,1.1,,,,",
    )
    room = cal.read_measured(path)
    assert room.source_names == ("S1",) and room.receiver_names == ("R1", "R2")
    assert room.octaves == (250.0, 500.0, 1000.0) and len(room.edges) == 4
    np.testing.assert_allclose(room.receivers, [[3.0, 4.0, 1.2], [5.0, 4.0, 1.2]])
    np.testing.assert_allclose(room.values[0, 0, :, 0], [0.9, 0.8, 2.5, 0.6])
    assert np.isnan(room.values[0, 0, 0, 2]) and room.values[0, 1, 0, 2] == 1.1
    assert np.isnan(room.values[0, :, :, 1]).all()
    assert room.error[0, 0, 0, 0] == 0.02 and np.isnan(room.error[0, 0, 1:, 0]).all()
    np.testing.assert_allclose(room.jnd[0, 0, :, 0], [0.045, 0.04, 1.0, 0.05])
    assert "2 pairs of 1 sources and 2 receivers, octaves of 250 to 1000 Hz" in repr(room)


def test_names_of_pairs(tmp_path: Path) -> None:
    lines = [f"S{s},R{r},{s},2,1.5,{r},4,1.2,500,1.0,,,," for s in (1, 2) for r in (1, 2)]
    room = cal.read_measured(_table(tmp_path, *lines))
    np.testing.assert_array_equal(room.pairs_of(["S2"]), [[0, 0], [1, 1]])
    np.testing.assert_array_equal(room.pairs_of(["R1"]), [[1, 0], [1, 0]])
    np.testing.assert_array_equal(room.pairs_of(["S1:R2", "S2:R1"]), [[0, 1], [1, 0]])
    assert not room.pairs_of([]).any()
    for bad in ("S3", "S1:S2", "S1:", ""):
        with pytest.raises(DatasetError, match=r"expected a source \(S1, S2\), a receiver \(R1, R2\)"):
            room.pairs_of([bad])


GOOD = ROW.format(octave=500, t30=0.9, error="")


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ([], "no t30, edt, c80, d50 of any pair"),
        ([ROW.format(octave=500, t30=0.9, error="").replace(",0.6,", ",60,")], "line 2: d50 must lie between 0 and 1, got 60; is it in per cent"),
        ([ROW.format(octave=500, t30="x", error="")], "line 2: expected a number for t30, got 'x'"),
        ([ROW.format(octave=500, t30="-1", error="")], "line 2: t30 must lie between 0 and 100 s, got -1"),
        ([ROW.format(octave=500, t30="inf", error="")], "t30 must lie between 0 and 100 s, got inf"),
        ([ROW.format(octave=500, t30=1, error=0)], "line 2: t30_error must be a standard error above 0, got 0"),
        ([ROW.format(octave=440, t30=1, error="")], "expected the midband frequency of an octave .*, got 440"),
        ([ROW.format(octave="", t30=1, error="")], "expected the midband frequency of an octave"),
        ([GOOD, GOOD], "line 3: this pair's octave of 500 Hz was given before"),
        ([GOOD, GOOD.replace("500", "1000").replace("3,4", "3,5")], "'R1' is at \\(3, 5, 1.2\\) m, and was at \\(3, 4, 1.2\\)"),
        ([GOOD.replace("S1,R1,1", "S1,R1,")], "expected a position of source 'S1' in m"),
        ([GOOD.replace("S1", " ")], "expected names of source and receiver"),
        ([GOOD + ",1,2"], "line 2: expected 14 cells"),
        (["S1,R1"], "line 2: expected 14 cells"),
        (["S1,R1,1,2,1.5,3,4,1.2,500,,,,,"], "no t30, edt, c80, d50 of any pair"),
    ],
)  # fmt: skip
def test_tables_that_cannot_be(tmp_path: Path, lines: list[str], words: str) -> None:
    with pytest.raises(DatasetError, match=words) as error:
        cal.read_measured(_table(tmp_path, *lines))
    assert str(tmp_path) in str(error.value) and "\n" not in str(error.value)


def test_files_that_cannot_be(tmp_path: Path) -> None:
    for head, words in (
        ("a;b;c", "expected columns source, receiver"),
        (f"source,receiver,{PLACES}", "octave_hz with t30, edt, c80 or d50; or file"),
        ("", "got an empty file"),
    ):
        with pytest.raises(DatasetError, match=words):
            cal.read_measured(_table(tmp_path, head=head))
    (tmp_path / "room.csv").write_bytes(b"\xff\xfe\x00source")
    for name, words in (("room.csv", "not UTF-8"), ("gone.csv", "cannot read"), ("room.txt", "expected a .csv table"), (".", "expected SOFA files"), ("gone.sofa", "cannot open")):  # fmt: skip
        with pytest.raises(DatasetError, match=words):
            cal.read_measured(tmp_path / name)


def _response(rng: np.random.Generator) -> np.ndarray:
    time = np.arange(int(0.9 * RATE)) / RATE
    return np.asarray(rng.standard_normal(len(time)) * 10.0 ** (-3.0 * time / 0.4))


def test_a_table_of_wav_files(tmp_path: Path) -> None:
    """A decay of .4 s in the second of two channels: T30 within four of its standard errors by ISO 3382-2."""
    response = _response(np.random.default_rng(5))
    both = 0.1 * np.stack([np.ones_like(response), response], axis=1)
    soundfile.write(tmp_path / "a.wav", both, RATE, subtype="FLOAT")
    row = "S1,R1,1,2,1.5,3,4,1.2,a.wav,{channel}"
    head = f"source,receiver,{PLACES},file,channel"
    room = cal.read_measured(_table(tmp_path, row.format(channel=2), head=head))
    assert room.octaves == (125.0, 250.0, 500.0, 1000.0, 2000.0)
    t30 = room.values[0, 0, 0]
    allowed = 4.0 * 0.55 * np.sqrt(0.4 / np.diff(room.edges))
    assert (np.abs(t30 - 0.4)[1:] < allowed[1:]).all()
    for channel, words in (("", "has 2 channels; say which"), ("3", "a channel from 1 to 2, got 3"), ("1.5", "got 1.5")):  # fmt: skip
        with pytest.raises(DatasetError, match=words):
            cal.read_measured(_table(tmp_path, row.format(channel=channel), head=head))
    soundfile.write(tmp_path / "a.wav", np.zeros(800), RATE)
    with pytest.raises(DatasetError, match="silent"):
        cal.read_measured(_table(tmp_path, row.format(channel=""), head=head))
    (tmp_path / "a.wav").write_bytes(b"RIFF and nothing")
    with pytest.raises(DatasetError, match=r"line 2: .*a\.wav: cannot read this sound"):
        cal.read_measured(_table(tmp_path, row.format(channel=""), head=head))


def test_sofa_files(tmp_path: Path) -> None:
    """As sofar writes them: ambisonic responses of one source at two listeners, the same as WAV files of the first
    channel."""
    sofar = pytest.importorskip("sofar", reason="the extra `sofa` is not installed")
    rng = np.random.default_rng(6)
    responses = np.stack([_response(rng), _response(rng)])
    sofa = sofar.Sofa("SingleRoomSRIR")
    sofa.Data_IR = np.stack([responses, 0.5 * responses, responses, responses], axis=1)
    sofa.Data_SamplingRate = float(RATE)
    sofa.Data_Delay = np.zeros((1, 4))
    sofa.GLOBAL_RoomType = "reverberant"
    sofa.SourcePosition = np.tile([1.0, 2.0, 1.5], (2, 1))
    sofa.ReceiverView = np.tile(np.array([[1.0], [0.0], [0.0]]), (4, 1, 1))
    sofa.ReceiverUp = np.tile(np.array([[0.0], [0.0], [1.0]]), (4, 1, 1))
    sofa.ListenerPosition = np.array([[3.0, 4.0, 1.2], [5.0, 4.0, 1.2]])
    sofa.ReceiverPosition = np.zeros((4, 3, 1))
    sofa.ReceiverPosition_Type = "spherical harmonics"
    for optional in ("ReceiverDescriptions", "EmitterDescriptions", "RoomVolume", "RoomCorners", "RoomCornerA", "RoomCornerB"):  # fmt: skip
        sofa.delete(optional)
    sofa.MeasurementDate = np.zeros(2)
    sofar.write_sofa(str(tmp_path / "room.sofa"), sofa)
    room = cal.read_measured(tmp_path / "room.sofa")
    assert room.source_names == ("S1",) and room.receiver_names == ("R1", "R2")
    np.testing.assert_allclose(room.receivers, sofa.ListenerPosition)
    head, lines = f"source,receiver,{PLACES},file", []
    for k, name in enumerate(("R1", "R2")):
        soundfile.write(tmp_path / f"{k}.wav", 0.1 * responses[k], RATE, subtype="DOUBLE")
        lines.append(f"S1,{name},1,2,1.5,{3 + 2 * k},4,1.2,{k}.wav")
    again = cal.read_measured(_table(tmp_path, *lines, head=head))
    np.testing.assert_allclose(room.values, again.values, rtol=1e-6)
    np.testing.assert_allclose(cal.read_measured(tmp_path).values, room.values)
    sofa.ReceiverPosition_Type, sofa.ReceiverPosition_Units = "cartesian", "metre"
    sofar.write_sofa(str(tmp_path / "room.sofa"), sofa)
    with pytest.raises(DatasetError, match="expected one receiver, or ambisonic ones, got 4"):
        cal.read_measured(tmp_path / "room.sofa")


_OF_FILES = f"source,receiver,{PLACES},file,channel"


def _of_file(folder: Path, channel: str = "", file: str = "a.wav") -> Path:
    return _table(folder, f"S1,R1,1,2,1.5,3,4,1.2,{file},{channel}", head=_OF_FILES)


@pytest.mark.parametrize("samples", [1, 2, 80, 400, 639])
@pytest.mark.parametrize("silence", [0, RATE])
def test_a_response_that_ends_at_once_is_told(tmp_path: Path, samples: int, silence: int) -> None:
    """10 ms are 80 samples; C80 needs 80 ms after the direct sound."""
    wave = np.concatenate([np.zeros(silence), np.exp(-np.arange(samples) / 50.0)])
    soundfile.write(tmp_path / "a.wav", wave, RATE)
    with pytest.raises(
        DatasetError, match=r"line 2: this response ends \d+ ms after its peak; expected 80 ms"
    ):
        cal.read_measured(_of_file(tmp_path))


@pytest.mark.parametrize("channel", ["inf", "-inf", "0", "1.5", "3", "1e300"])
def test_a_channel_that_there_is_not(tmp_path: Path, channel: str) -> None:
    soundfile.write(tmp_path / "a.wav", np.ones((RATE, 2)), RATE)
    with pytest.raises(DatasetError, match="line 2: expected a channel from 1 to 2, got"):
        cal.read_measured(_of_file(tmp_path, channel))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no FIFOs")
def test_a_fifo_is_no_sound(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.wav")
    with pytest.raises(
        DatasetError, match=r"line 2: .*a\.wav: cannot read this sound: it is not a regular"
    ):
        cal.read_measured(_of_file(tmp_path))


@pytest.mark.parametrize("rate", [1, 200, 2**31 - 1])
def test_rates_that_cannot_be(tmp_path: Path, rate: int) -> None:
    soundfile.write(tmp_path / "a.wav", np.ones(1000), rate)
    with pytest.raises(DatasetError, match=r"line 2: .*expected a rate"):
        cal.read_measured(_of_file(tmp_path))


def test_pairs_beyond_measure_are_told_before_memory_is_taken(tmp_path: Path) -> None:
    rows = [f"S{i},R{i},{i},2,1.5,{i},4,1.2,500,1.0,,,," for i in range(6000)]
    with pytest.raises(DatasetError, match="6,000 sources and 6,000 receivers"):
        cal.read_measured(_table(tmp_path, *rows))


@pytest.mark.parametrize("cell", ["inf", "1e300", "-1e9"])
def test_places_that_cannot_be(tmp_path: Path, cell: str) -> None:
    with pytest.raises(DatasetError, match="line 2: expected a position of source 'S1' in m"):
        cal.read_measured(_table(tmp_path, f"S1,R1,{cell},2,1.5,3,4,1.2,500,1.0,,,,"))


def test_unnamed_places_are_one_within_a_millimetre() -> None:
    places = Places("source")
    assert [
        places.unnamed(np.array([x, 0.0, 0.0]), "") for x in (0.0, 0.0009, -0.0009, 0.0015, 0.001)
    ] == [0, 0, 0, 1, 0]
    with pytest.raises(DatasetError, match="in m, got"):
        places.unnamed(np.array([np.nan, 0.0, 0.0]), "here")


@pytest.mark.parametrize(
    ("kind", "unit", "right"),
    [
        ("cartesian", "metre", True), ("cartesian", "metre, metre, metre", True), ("cartesian", "meters", True),
        ("spherical", "degree, degree, metre", True), ("spherical", "degrees, degrees, meters", True),
        ("cartesian", "degree, degree, metre", False), ("spherical", "metre", False),
        ("spherical", "radian, radian, metre", False), ("cartesian", "millimetre", False),
    ],
)  # fmt: skip
def test_units_of_positions(tmp_path: Path, kind: str, unit: str, right: bool) -> None:
    noise = np.exp(-np.arange(RATE) / 400.0) * np.random.default_rng(0).standard_normal(RATE)
    with h5py.File(tmp_path / "a.sofa", "w") as sofa:
        sofa["Data.IR"], sofa["Data.SamplingRate"] = noise[None, None], np.array([float(RATE)])
        for name in ("SourcePosition", "ListenerPosition"):
            sofa[name] = np.array([[1.0, 2.0, 1.5]])
            sofa[name].attrs.update({"Type": kind, "Units": unit})
    if right:
        assert cal.read_measured(tmp_path / "a.sofa").sources.shape == (1, 3)
    else:
        with pytest.raises(DatasetError, match=f"SourcePosition is {kind}, and its units are '{unit}'"):
            cal.read_measured(tmp_path / "a.sofa")


@pytest.mark.parametrize("name", ["=1+2", "+1", "-1", "@SUM(A1)", "\t=1", '=a"b'])
def test_names_are_no_formulas(name: str) -> None:
    cell = _cell(name)
    (row,) = csv.reader([cell])
    assert row == ["'" + name]
    assert next(csv.reader([_cell("S=1")])) == ["S=1"]
