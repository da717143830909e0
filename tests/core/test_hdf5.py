"""HDF5 files are opened again before they are published."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from soundspaces_sim.core.errors import DatasetError
from soundspaces_sim.dataset.format.floorplan import encode_floorplan
from soundspaces_sim.layout.records import FloorPlan
from soundspaces_sim.nav.baked_arrays import write_arrays


class WrongChecksum(io.BytesIO):
    """What h5py before 3.16 made of a file that was still open: the checksum of the first block is wrong."""

    def getvalue(self) -> bytes:
        data = bytearray(super().getvalue())
        data[44] ^= 1
        return bytes(data)


def _plan(_: Path) -> object:
    plan = FloorPlan((np.zeros((1, 4)),), np.zeros((1, 2, 2), np.int16), ("wall",), np.zeros(2), 0.1)
    return encode_floorplan(plan)


def _arrays(folder: Path) -> object:
    return write_arrays(folder / "views.h5", {"of": "this"}, {"depth": np.ones(3)})


@pytest.mark.parametrize("write", [_plan, _arrays])
def test_a_file_that_cannot_be_opened_is_not_published(
    write: Callable[[Path], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path)
    (tmp_path / "views.h5").unlink(missing_ok=True)
    monkeypatch.setattr(io, "BytesIO", WrongChecksum)
    with pytest.raises(DatasetError, match=r"checksum.*nothing was kept: install another h5py"):
        write(tmp_path)
    assert not list(tmp_path.iterdir())
