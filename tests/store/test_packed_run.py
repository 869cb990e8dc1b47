"""A packed run holds everything, stands alone, and opens without labrun."""

import shutil

import numpy as np
import pytest
import stored_runs

from labrun.errors import StoreError
from labrun.store import packed_file, writer
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
        stored_runs.assert_as_measured(run.stream(index, "wrench"), index)
        np.testing.assert_array_equal(run.command(index).values, stored_runs.motion().angle_rad)
        np.testing.assert_array_equal(run.settle_curve(index).drift, stored_runs.curve().drift)


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
    stored_runs.assert_as_measured(run.streams(5)["wrench"], 5)


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


def test_xarray_reads_the_signals_of_a_trial(packed):
    with xarray.open_dataset(
        packed.path / "run.h5", group="trials/000003/wrench", engine="h5netcdf"
    ) as wrench:
        assert wrench["force_x"].dims == ("time_s",)
        assert wrench["force_x"].attrs["units"] == "N"
        np.testing.assert_array_equal(wrench["force_x"], stored_runs.samples(3).values[:, 0])
        assert wrench.attrs["rate_hz"] == 100.0
        assert wrench.attrs["lost"] == 3
    with xarray.open_dataset(
        packed.path / "run.h5", group="trials/000003/command", engine="h5netcdf"
    ) as command:
        assert command["tail"].attrs["units"] == "rad"
    with xarray.open_dataset(
        packed.path / "run.h5", group="trials/000003/settle", engine="h5netcdf"
    ) as settle:
        assert settle.attrs["reason"] == "quiet"


def test_xarray_reads_the_whole_run_as_a_tree(packed):
    with xarray.open_datatree(packed.path / "run.h5", engine="h5netcdf") as tree:
        assert sorted(tree["trials"].children) == [f"{index:06d}" for index in range(6)]
        assert tree["trials/000000/wrench"]["torque_z"].sizes == {"time_s": 200}
        assert tree["trials/000004"].attrs["status"] == "rejected"
        assert str(tree["record"]["spec_toml"].values) == stored_runs.SPEC


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
        stored_runs.assert_as_measured(run.stream(index, "wrench"), index)


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
    monkeypatch.setattr(writer, "SPILL_BYTES", 1000)
    folder = stored_runs.new_run(tmp_path)
    stored_runs.store(folder, 0)
    folder.pack()
    stored_runs.assert_as_measured(open_run(folder.path).stream(0, "wrench"), 0)
    with xarray.open_dataset(
        folder.path / "run.h5", group="trials/000000/wrench", engine="h5netcdf"
    ) as wrench:
        assert wrench["force_x"].dims == ("time_s",)


def test_what_was_written_wrongly_never_replaces_the_trials(tmp_path, monkeypatch):
    folder = stored_runs.new_run(tmp_path)
    stored = stored_runs.store_many(folder, 3)
    write = packed_file.write

    def failing_disk(path, texts, outcomes, sources):
        write(path, texts, outcomes, sources)
        content = bytearray(path.read_bytes())
        sample = content.find(stored_runs.samples(1).values[0, 0].tobytes())
        content[sample] ^= 1
        path.write_bytes(content)

    monkeypatch.setattr(packed_file, "write", failing_disk)
    with pytest.raises(StoreError, match="does not hold what was written"):
        folder.pack()
    assert sorted(path.name for path in (folder.path / "trials").iterdir()) == [
        f"{index:06d}.h5" for index in range(3)
    ]
    assert not list(folder.path.glob("run.h5*"))
    assert RunFolder.open(folder.path).outcomes() == stored
