"""SOFA files with the layouts that institutions' files have: each is made here, quirks and all."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

import soundspaces_sim as ss
from soundspaces_sim.rendering.hrtf import HrtfError, load_hrtf, onset_delays

RATE = 44100.0
_POSITIONS = np.array(
    [[a, e, 1.2] for e in (-40.0, 0.0, 40.0) for a in range(0, 360, 30)] + [[0.0, 90.0, 1.2], [0.0, -90.0, 1.2]]
)  # fmt: skip
M, N = len(_POSITIONS), 64
_CARTESIAN = 1.2 * np.stack(
    [
        np.cos(np.deg2rad(_POSITIONS[:, 1])) * np.cos(np.deg2rad(_POSITIONS[:, 0])),
        np.cos(np.deg2rad(_POSITIONS[:, 1])) * np.sin(np.deg2rad(_POSITIONS[:, 0])),
        np.sin(np.deg2rad(_POSITIONS[:, 1])),
    ],
    axis=1,
)


def _itd(positions: np.ndarray = _CARTESIAN) -> np.ndarray:
    """(M,) samples by which the right ear hears later: of two ears 0.18 m apart in free air."""
    return np.asarray(0.18 * positions[:, 1] / 1.2 / 343.0 * RATE)


def _pulses(where: np.ndarray) -> np.ndarray:
    ir = np.zeros((M, 2, N))
    for m in range(M):
        for ear in range(2):
            ir[m, ear, int(where[m, ear])] = 1.0
    return ir


def _null(owner: h5py.File | h5py.Dataset, name: str) -> None:
    """An empty text, as netCDF writes it for MATLAB's API: no dataspace."""
    kind = h5py.h5t.C_S1.copy()
    h5py.h5a.create(owner.id, name.encode(), kind, h5py.h5s.create(h5py.h5s.NULL))


def _netcdf(sofa: h5py.File, dtype: str = "f8", variable: bool = False) -> None:
    """As the API of MATLAB writes: dimensions as unnamed scales, texts of fixed or any length, empty ones null."""
    text: Callable[[str], object] = str if variable else np.bytes_
    for name, size in (("I", 1), ("C", 3), ("R", 2), ("E", 1), ("M", M), ("N", N)):
        scale = sofa.create_dataset(name, (size,), ">f4")
        scale[...] = 0.0
        scale.make_scale(f"This is a netCDF dimension but not a netCDF variable. {size:10d}")
    for name in ("Comment", "History", "References", "Title", "Origin"):
        _null(sofa, name)
    sofa.attrs["Conventions"] = text("SOFA")
    sofa.attrs["SOFAConventions"] = text("SimpleFreeFieldHRIR")
    sofa.attrs["DataType"] = text("FIR")
    sofa.create_dataset(
        "Data.IR", data=_pulses(np.full((M, 2), 10)), dtype=dtype, chunks=(1, 2, N), compression=1
    )
    sofa["Data.IR"].dims[0].attach_scale(sofa["M"])
    sofa.create_dataset("Data.SamplingRate", data=np.array([RATE]), dtype=dtype)
    sofa["Data.SamplingRate"].attrs["Units"] = text("hertz")
    _null(sofa["Data.SamplingRate"], "LongName")
    sofa.create_dataset("SourcePosition", data=_POSITIONS, dtype=dtype)
    sofa["SourcePosition"].attrs["Type"] = text("spherical")
    sofa["SourcePosition"].attrs["Units"] = text("degree, degree, metre")
    sofa.create_dataset("ReceiverPosition", data=np.array([[0, 0.09, 0], [0, -0.09, 0]])[..., None])


def _cipic(sofa: h5py.File) -> None:
    _netcdf(sofa)
    sofa["Data.Delay"] = np.zeros((1, 2))


def _listen(sofa: h5py.File) -> None:
    _netcdf(sofa, "f4", variable=True)
    sofa["Data.Delay"] = np.zeros((M, 2), np.float32)
    sofa["SourcePosition"].attrs["Units"] = "degree, degree, meter"


def _kemar(sofa: h5py.File) -> None:
    _netcdf(sofa)
    del sofa["Data.SamplingRate"]
    sofa["Data.SamplingRate"] = RATE  # a scalar
    sofa["Data.Delay"] = np.zeros((1, 2), np.int32)


def _tune_in(sofa: h5py.File) -> None:
    """Onsets taken out of the responses and into Data.Delay, of each direction."""
    _netcdf(sofa, variable=True)
    sofa["Data.Delay"] = 20.0 + np.array([-0.5, 0.5]) * _itd()[:, None]


def _ari(sofa: h5py.File) -> None:
    _netcdf(sofa, "f4")
    sofa["Data.Delay"] = np.zeros((1, 2))
    sofa["SourcePosition"].attrs["Type"] = np.array([b"spherical"])
    sofa["SourcePosition"].attrs["Units"] = np.array([b"degree, degree, metre"])


def _fhk(sofa: h5py.File) -> None:
    _netcdf(sofa, "f4")
    sofa["SourcePosition"][...] = _CARTESIAN
    sofa["SourcePosition"].attrs["Type"] = "cartesian"
    sofa["SourcePosition"].attrs["Units"] = "metre"
    sofa["Data.Delay"] = np.zeros((1, 2))


def _radian(sofa: h5py.File) -> None:
    _netcdf(sofa)
    sofa["SourcePosition"][:, :2] = np.deg2rad(_POSITIONS[:, :2])
    sofa["SourcePosition"].attrs["Units"] = "radian, radian, metre"


_SETS = {f.__name__: f for f in (_cipic, _listen, _kemar, _tune_in, _ari, _fhk, _radian)}


@pytest.mark.parametrize("name", _SETS)
def test_files_as_institutions_write_them(tmp_path: Path, name: str) -> None:
    with h5py.File(tmp_path / "set.sofa", "w") as sofa:
        _SETS[name](sofa)
    found = load_hrtf(tmp_path / "set.sofa")
    np.testing.assert_allclose(found.directions, _CARTESIAN / 1.2, atol=1e-6)
    assert found.rate == RATE and found.distance == pytest.approx(1.2) and found.citation == ""
    if name != "_tune_in":
        np.testing.assert_array_equal(found.ir, _pulses(np.full((M, 2), 10)))
    ss.Ears(tmp_path / "set.sofa")


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("each", [True, False])
def test_delays_are_part_of_the_responses(tmp_path: Path, each: bool, whole: bool) -> None:
    """The interaural delay is that of pulses in the responses and what Data.Delay adds, for all or each direction."""
    delay = 20.0 + (
        np.stack([-0.5 * _itd(), 0.5 * _itd()], axis=1) if each else np.array([[3.25, 12.5]])
    )
    if whole:
        delay = np.round(delay)
    with h5py.File(tmp_path / "set.sofa", "w") as sofa:
        _netcdf(sofa)
        sofa["Data.Delay"] = delay
    found = load_hrtf(tmp_path / "set.sofa")
    onset = onset_delays(found) * RATE
    expected = np.broadcast_to(delay[:, 1] - delay[:, 0], M)
    np.testing.assert_allclose(onset[:, 1] - onset[:, 0], expected, atol=1e-9 if whole else 0.3)
    energy = np.square(found.ir).sum(axis=2)
    np.testing.assert_allclose(energy, 1.0, atol=1e-9 if whole else 0.02)


@pytest.mark.parametrize(
    "delay",
    [
        np.zeros((3, 2)),
        np.zeros(2),
        np.full((1, 2), np.nan),
        np.full((1, 2), -1.0),
        np.full((M, 2), 1e9),
    ],
)
def test_delays_that_cannot_be(tmp_path: Path, delay: np.ndarray) -> None:
    with h5py.File(tmp_path / "set.sofa", "w") as sofa:
        _netcdf(sofa)
        sofa["Data.Delay"] = delay
    with pytest.raises(HrtfError, match=r"set\.sofa: Data\.Delay: expected"):
        load_hrtf(tmp_path / "set.sofa")


@pytest.mark.parametrize(
    "convention",
    ["SingleRoomDRIR", "MultiSpeakerBRIR", "SimpleHeadphoneIR", "SimpleFreeFieldHRTF", "GeneralTF"],
)
def test_other_conventions_are_refused_by_name(tmp_path: Path, convention: str) -> None:
    with h5py.File(tmp_path / "set.sofa", "w") as sofa:
        _netcdf(sofa)
        sofa.attrs["SOFAConventions"] = convention
    with pytest.raises(HrtfError, match=rf"SimpleFreeFieldHRIR.* got '{convention}'"):
        ss.Ears(tmp_path / "set.sofa")
