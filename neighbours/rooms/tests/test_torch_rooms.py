"""Random rooms for PyTorch's loaders: stacked batches of rooms that differ."""

from __future__ import annotations

import numpy as np
import pytest

import soundspaces_sim as ss

torch = pytest.importorskip("torch", reason="the extra 'torch' is not installed")

from soundspaces_rooms import RoomStream, TorchRoomStream  # noqa: E402

FEW = ss.SimulationConfig(
    walks=16, duration=0.1, radiance_transfer=ss.RadianceTransferConfig(enabled=False)
)


def test_rooms_are_stacked() -> None:
    """Every number of every room is where it was; what a room has not is zero in signals, NaN elsewhere."""
    dry = [np.random.default_rng(0).normal(size=1600)]
    stream = RoomStream(
        seed=4, count=4, rate=8000, config=FEW, kinds=("shoebox",), speech=dry, seconds=0.2
    )
    rooms = list(stream)
    assert len({room["rir"].shape for room in rooms}) > 1
    loader = torch.utils.data.DataLoader(
        TorchRoomStream(stream), batch_size=4, collate_fn=TorchRoomStream.collate_fn
    )
    (batch,) = list(loader)
    assert set(batch) == set(rooms[0]) | {"source_count", "microphone_count", "length"}
    assert batch["kind"] == ["shoebox"] * 4 and batch["room"].tolist() == [0, 1, 2, 3]
    assert batch["rir"].dtype == torch.float32
    for k, room in enumerate(rooms):
        counts = batch["source_count"][k], batch["microphone_count"][k], batch["length"][k]
        assert tuple(int(n) for n in counts) == room["rir"].shape
        for name in set(room) - {"kind"}:
            found, own = batch[name][k].numpy(), np.asarray(room[name])
            inside = tuple(slice(n) for n in own.shape)
            np.testing.assert_array_equal(found[inside], own, name)
            rest = np.ones(found.shape, bool)
            rest[inside] = False
            of_signals = name in ("rir", "direct", "early") or own.ndim == 3 or name == "mixture"
            assert (found[rest] == 0.0).all() if of_signals else np.isnan(found[rest]).all(), name
