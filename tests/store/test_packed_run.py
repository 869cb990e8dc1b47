"""A packed run holds everything, stands alone, and opens without labrun."""

import shutil

import h5py
import numpy as np
import pytest
import stored_runs

from labrun.devices import Channel, Samples
from labrun.errors import StoreError
from labrun.store import packed_file, trial_file
from labrun.store.folder import RunFolder
from labrun.store.reading import open_run

xarray = pytest.importorskip("xarray")


@pytest.fixture
def packed(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    stored_runs.store_many(folder, 6)
    folder.mark(4, "rejected", "an outlier")
    folder.pack()
    return folder


def test_packing_keeps_every_outcome_and_sample_and_removes_the_trial_files(packed):
    assert not (packed.path / "trials").exists()
    run = open_run(packed.path)
    expected = [stored_runs.outcome(index) for index in range(6)]
    expected[4] = expected[4].marked("rejected", "an outlier")
    assert run.outcomes == expected
    for index in range(6):
        stored_runs.assert_as_measured(run.signals(index)["wrench"], index)
        np.testing.assert_array_equal(run.command(index).values, stored_runs.motion().angle_rad)
        np.testing.assert_array_equal(run.settle_curve(index).values, stored_runs.curve().values)


def test_a_packed_run_stands_alone(packed, tmp_path):
    moved = tmp_path / "elsewhere.h5"
    shutil.move(packed.path / "run.h5", moved)
    journal = packed.journal.events()
    texts = (packed.spec_toml, packed.provenance)
    identifier = packed.path.name
    shutil.rmtree(packed.path)
    run = open_run(moved)
    assert (run.experiment_toml, run.provenance) == texts
    assert (run.name, run.identifier) == ("fin", identifier)
    assert run.outcomes[4].status == "rejected"
    assert run.events == journal[: len(run.events)]
    assert [event["event"] for event in run.events[-2:]] == ["trial", "mark"]
    stored_runs.assert_as_measured(run.signals(5)["wrench"], 5)


def test_xarray_reads_the_table_of_trials(packed):
    with xarray.open_dataset(packed.path / "run.h5", engine="h5netcdf") as table:
        assert dict(table.sizes) == {"trial": 6}
        assert table["index"].values.tolist() == list(range(6))
        np.testing.assert_array_equal(table["b"], [0.1 * index for index in range(6)])
        assert table["b"].attrs["units"] == "deg"
        assert table["foil"].values.tolist() == ["stiff"] * 6
        assert table["repeat"].values.tolist() == [0, 1, 2, 0, 1, 2]
        assert table["status"].values.tolist() == ["done"] * 4 + ["rejected", "done"]
        assert table["reason"].values[4] == "an outlier"
        np.testing.assert_array_equal(table["thrust"], [1 / (index + 3) for index in range(6)])
        assert table["started_s"].attrs["units"] == "s"


def test_xarray_reads_all_samples_of_a_device_and_those_of_one_trial(packed):
    with xarray.open_dataset(packed.path / "run.h5", group="wrench", engine="h5netcdf") as wrench:
        assert dict(wrench.sizes) == {"sample": 6 * 200, "trial": 6}
        assert wrench["force_x"].attrs["units"] == "N"
        assert wrench["time_s"].attrs["units"] == "s"
        assert wrench["sample_count"].attrs["sample_dimension"] == "sample"
        assert wrench["rate_hz"].values.tolist() == [100.0] * 6
        assert wrench["lost"].values.tolist() == list(range(6))
        assert wrench["tare_force_x"].values.tolist() == [0.25] * 6
        expected = stored_runs.samples(3).values
        first, count = int(wrench["first_sample"][3]), int(wrench["sample_count"][3])
        for entry in (
            wrench.isel(sample=slice(first, first + count)),
            wrench.isel(sample=wrench["trial_index"] == 3),
        ):
            np.testing.assert_array_equal(entry["force_x"], expected[:, 0])
            np.testing.assert_array_equal(entry["torque_z"], expected[:, 1])
        means = wrench["force_x"].groupby(wrench["trial_index"]).mean()
        np.testing.assert_allclose(means[3], expected[:, 0].mean())
    with xarray.open_dataset(packed.path / "run.h5", group="command", engine="h5netcdf") as command:
        assert command["tail"].attrs["units"] == "rad"
    with xarray.open_dataset(packed.path / "run.h5", group="settle", engine="h5netcdf") as settle:
        assert settle["spread"].attrs["units"] == "N"


def test_xarray_reads_the_whole_run_as_a_tree(packed):
    with xarray.open_datatree(packed.path / "run.h5", engine="h5netcdf") as tree:
        assert sorted(tree.children) == ["command", "record", "settle", "wrench"]
        assert tree["wrench/torque_z"].sizes == {"sample": 1200}
        assert tree["status"].values[4] == "rejected"
        assert tree["settle_reason"].values.tolist() == ["quiet"] * 6
        assert str(tree["record"]["spec_toml"].values) == stored_runs.SPEC


def test_the_netcdf_library_reads_the_whole_run(packed):
    netcdf = pytest.importorskip("netCDF4")
    with netcdf.Dataset(packed.path / "run.h5") as file:
        assert file.dimensions["trial"].size == 6
        assert file.variables["status"][4] == "rejected"
        wrench = file.groups["wrench"]
        assert wrench.variables["force_x"].dimensions == ("sample",)
        assert wrench.variables["sample_count"].dimensions == ("trial",)
        np.testing.assert_array_equal(
            wrench.variables["force_x"][600:800], stored_runs.samples(3).values[:, 0]
        )


def test_plain_h5py_reads_every_dataset_as_numbers_or_text(packed):
    with h5py.File(packed.path / "run.h5") as file:
        results = []
        file.visititems(lambda _, item: results.append(item) if isinstance(item, h5py.Dataset) else None)
        assert {item.dtype.kind for item in results} <= {"f", "i", "O"}
        assert all(item[()] is not None for item in results)


def test_trials_may_differ_in_devices_and_channels(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    stored_runs.store(folder, 0)
    torque = (Channel("torque_z", "N m"),)
    volts = (Channel("torque_z", "V"), Channel("lost", "V"))
    samples = stored_runs.samples(2, 30)
    for index, channels in ((2, torque), (5, volts)):
        writer = folder.writer(index)
        writer.append(
            "wrench",
            channels,
            50.0,
            Samples(samples.device_time_s, samples.host_time_s, samples.values[:, : len(channels)]),
        )
        writer.finish(stored_runs.outcome(index, tare={}), None, None)
    writer = folder.writer(6)
    writer.append("camera", (Channel("angle", "rad"),), 25.0, Samples.empty(1))
    writer.finish(stored_runs.outcome(6, status="failed", settle=None), None, None)
    before = {index: open_run(folder.path).signals(index) for index in (0, 2, 5, 6)}
    run = open_run(folder.pack())
    for index, streams in before.items():
        assert run.signals(index).keys() == streams.keys()
        for name, stream in streams.items():
            packed = run.signals(index)[name]
            assert (packed.columns, packed.units, packed.tare, packed.rate_hz) == (
                stream.columns,
                stream.units,
                stream.tare,
                stream.rate_hz,
            )
            np.testing.assert_array_equal(packed.values, stream.values)
            np.testing.assert_array_equal(packed.time_s, stream.time_s)
    assert run.settle_curve(2) is None
    assert run.command(2).columns == ()
    with xarray.open_dataset(run.path, group="wrench", engine="h5netcdf") as wrench:
        assert wrench["sample_count"].values.tolist() == [200, 30, 30, 0]
        assert np.isnan(wrench["force_x"].values[200:]).all()
        assert not np.isnan(wrench["force_x"].values[:200]).any()
        assert wrench["torque_z_"].attrs["units"] == "V"
        assert wrench["channel_lost"].attrs["channel"] == "lost"
        assert np.unique(wrench["trial_index"]).tolist() == [0, 2, 5]


@pytest.mark.parametrize("block", [64, 450, 1 << 20])
def test_large_runs_are_written_in_blocks_and_read_the_same(tmp_path, monkeypatch, block):
    folder = stored_runs.new_run(tmp_path)
    stored_runs.store_many(folder, 5)
    stored_runs.store(folder, 5, count=1)
    writer_without_device = folder.writer(6)
    writer_without_device.finish(stored_runs.outcome(6), None, stored_runs.motion())
    stored_runs.store(folder, 7, count=333)
    for module in (packed_file, trial_file):
        monkeypatch.setattr(module, "MEMORY_ROWS", block)
    monkeypatch.setattr(packed_file, "CHUNK", 100)
    run = open_run(folder.pack())
    for index, count in [*((index, 200) for index in range(5)), (5, 1), (7, 333)]:
        stored_runs.assert_as_measured(run.signals(index)["wrench"], index, count)
        np.testing.assert_array_equal(run.command(index).values, stored_runs.motion().angle_rad)
    assert run.signals(6) == {}
    with xarray.open_datatree(run.path, engine="h5netcdf") as tree:
        assert tree["wrench/force_x"].sizes == {"sample": 1334}
        assert not np.isnan(tree["wrench/force_x"].values).any()


def test_an_objective_named_like_a_device_stands_beside_it(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    stored_runs.store(folder, 0, objectives={"wrench": 2.0})
    with xarray.open_datatree(folder.pack(), engine="h5netcdf") as tree:
        assert tree["objective_wrench"].values.tolist() == [2.0]
        assert tree["wrench/force_x"].sizes == {"sample": 200}


def test_names_that_collide_stay_apart_in_the_table(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    stored_runs.store(folder, 0, condition={"index": 5.0, "speed/m": 1.0, "thrust": 2.0})
    stored_runs.store(folder, 1, condition={"index": "many"}, objectives={}, status="failed", reason="lost")
    with xarray.open_dataset(folder.pack(), engine="h5netcdf") as table:
        assert table["condition_index"].values.tolist() == ["5.0", "many"]
        assert table["speed_m"].values[0] == 1.0
        assert table["thrust"].values[0] == 2.0
        assert np.isnan(table["objective_thrust"].values[1])


def test_a_packed_run_goes_on_and_is_packed_again(packed):
    folder = RunFolder.open(packed.path)
    stored_runs.store(folder, 6)
    folder.mark(0, "rejected", "a bubble")
    assert len(open_run(packed.path).outcomes) == 7
    folder.pack()
    run = open_run(packed.path)
    assert [outcome.index for outcome in run.outcomes] == list(range(7))
    assert [outcome.status for outcome in run.outcomes if outcome.status != "done"] == [
        "rejected",
        "rejected",
    ]
    for index in range(7):
        stored_runs.assert_as_measured(run.signals(index)["wrench"], index)


def test_a_mark_after_packing_is_seen_through_the_packed_file_too(packed):
    RunFolder.open(packed.path).mark(2, "rejected", "seen on the video")
    assert open_run(packed.path / "run.h5").outcomes[2].reason == "seen on the video"


def test_packing_twice_changes_nothing(packed):
    before = (packed.path / "run.h5").read_bytes()
    RunFolder.open(packed.path).pack()
    assert (packed.path / "run.h5").read_bytes() == before


def test_a_run_without_trials_can_be_packed(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    folder.pack()
    assert open_run(folder.path / "run.h5").outcomes == []


def test_a_spilled_trial_packs_like_any_other(tmp_path, monkeypatch):
    monkeypatch.setattr(trial_file, "SPILL_BYTES", 1000)
    folder = stored_runs.new_run(tmp_path)
    stored_runs.store(folder, 0)
    folder.pack()
    stored_runs.assert_as_measured(open_run(folder.path).signals(0)["wrench"], 0)
    with xarray.open_dataset(folder.path / "run.h5", group="wrench", engine="h5netcdf") as wrench:
        assert wrench["force_x"].sizes == {"sample": 200}


def test_what_was_written_wrongly_never_replaces_the_trials(tmp_path, monkeypatch):
    folder = stored_runs.new_run(tmp_path)
    stored = stored_runs.store_many(folder, 3)
    write = packed_file.write_packed

    def failing_disk(path, *arguments):
        digests = write(path, *arguments)
        content = bytearray(path.read_bytes())
        sample = content.find(stored_runs.samples(1).values[0, 0].tobytes())
        content[sample] ^= 1
        path.write_bytes(content)
        return digests

    monkeypatch.setattr(packed_file, "write_packed", failing_disk)
    with pytest.raises(StoreError, match="does not hold what was written"):
        folder.pack()
    assert sorted(path.name for path in (folder.path / "trials").iterdir()) == [
        f"{index:06d}.h5" for index in range(3)
    ]
    assert not list(folder.path.glob("run.h5*"))
    assert RunFolder.open(folder.path).outcomes() == stored
