"""Exports as SOFA are read as their clients read them."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
import sofar
from msgspec.structs import replace
from soundspaces_exports.sofa import plan_sofa

import soundspaces_sim as ss
from soundspaces_sim.dataset.exporters.plan import carry_out
from soundspaces_sim.rendering.soundfield import convert


def test_sofa_export(dataset_folder: Path, tmp_path: Path) -> None:
    with ss.open_dataset(dataset_folder) as ds:
        assert carry_out(plan_sofa(ds, tmp_path)) == len(ds.points)
        sofa = sofar.read_sofa(str(tmp_path / "two_rooms_source1.sofa"), verbose=False)
        assert sofa.GLOBAL_SOFAConventions == "SingleRoomSRIR"
        np.testing.assert_allclose(sofa.ListenerPosition, ds.points)
        np.testing.assert_allclose(
            sofa.SourcePosition, np.repeat(ds.points[1:2], len(ds.points), axis=0)
        )
        field = convert(ds.ambisonic(1, 2), "n3d")
        np.testing.assert_allclose(sofa.Data_IR[2, :, : field.shape[1]], field, atol=1e-9)


def test_sofa_per_listener_and_what_the_manifest_says(dataset_folder: Path, tmp_path: Path) -> None:
    """A copy whose manifest names its maker; what pysofaconventions 0.1.5 asks for, attribute by attribute."""
    with ss.open_dataset(dataset_folder) as ds:
        dataset = replace(
            ds.manifest.config.dataset,
            author="A. Maker <a@b.org>",
            organization="A lab",
            licence="CC BY 4.0",
        )
        ds.manifest = replace(ds.manifest, config=replace(ds.manifest.config, dataset=dataset))
        pairs = tmp_path / "pairs.txt"
        pairs.write_text("0 2\n1 2\n3 4\n")
        assert carry_out(plan_sofa(ds, tmp_path / "out", pairs=pairs, per="listener")) == 2
        path = tmp_path / "out" / "two_rooms_listener2.sofa"
        sofa = sofar.read_sofa(str(path), verbose=False)
        np.testing.assert_allclose(sofa.ListenerPosition, ds.points[[2, 2]])
        np.testing.assert_allclose(sofa.SourcePosition, ds.points[[0, 1]])
        field = convert(ds.ambisonic(1, 2), "n3d")
        np.testing.assert_allclose(sofa.Data_IR[1, :, : field.shape[1]], field, atol=1e-9)
        with pytest.raises(ss.ConfigError, match="per: expected source or listener, got 'ear'"):
            carry_out(plan_sofa(ds, tmp_path, per="ear"))  # type: ignore[arg-type]
    assert sofa.GLOBAL_AuthorContact == "A. Maker <a@b.org>"
    assert (sofa.GLOBAL_Organization, sofa.GLOBAL_License) == ("A lab", "CC BY 4.0")
    assert sofa.RoomTemperature == pytest.approx(293.15) and not hasattr(sofa, "RoomVolume")
    with h5py.File(path) as file:
        for name in ("Listener", "Receiver", "Source", "Emitter"):
            for part in ("Position", "View", "Up"):
                assert {"Type", "Units"} <= set(file[name + part].attrs), name + part


def test_size_of_sofa_files(dataset_folder: Path, tmp_path: Path) -> None:
    """Compressed, so within a factor of two."""
    pairs = tmp_path / "pairs.txt"
    pairs.write_text("2 0\n2 5\n4 1\n")
    with ss.open_dataset(dataset_folder) as ds:
        plan = plan_sofa(ds, tmp_path / "out", pairs=pairs)
        assert carry_out(plan) == 2
        files = sorted((tmp_path / "out").iterdir())
        assert [p.name for p in files] == ["two_rooms_source2.sofa", "two_rooms_source4.sofa"]
        assert 0.5 < sum(p.stat().st_size for p in files) / plan.bytes < 2.0
