"""A trial comes back from disk exactly as it was measured."""

import json
import os
import tracemalloc

import h5py
import numpy as np
import pytest
import stored_runs
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.devices import Channel, Samples
from labrun.errors import RecordingError, RigBusyError, StoreError
from labrun.store import trial_file as writer_module
from labrun.store.folder import FORMAT, RunFolder
from labrun.store.locate import find_run
from labrun.store.reading import open_run
from labrun.store.trial import TrialOutcome

finite = st.floats(allow_nan=False, allow_infinity=False)


def test_a_new_run_is_named_by_its_start_and_four_letters(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    assert folder.path.parent == tmp_path / "fin"
    start, letters = folder.path.name.rsplit("-", 1)
    assert len(start) == len("2026-05-21T01-30-45")
    assert len(letters) == 4
    assert letters.isalpha()
    assert folder.spec_toml == stored_runs.SPEC
    assert folder.provenance == {"seed": 7}
    assert [event["event"] for event in folder.journal.events()] == ["created"]


def test_outcome_streams_command_and_settle_curve_come_back(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    stored = stored_runs.store(folder, 4)
    run = open_run(folder.path)
    assert run.outcomes == [stored]
    stream = run.signals(4)["wrench"]
    stored_runs.assert_as_measured(stream, 4)
    assert stream.tare == {"force_x": 0.25}
    np.testing.assert_array_equal(run.command(4).column("tail"), stored_runs.motion().angle_rad[:, 0])
    assert (run.command(4).columns, run.command(4).units) == (("tail",), ("rad",))
    np.testing.assert_array_equal(run.settle_curve(4).values, stored_runs.curve().values)


@given(
    condition=st.dictionaries(st.text(min_size=1), finite | st.text()),
    objectives=st.dictionaries(st.text(min_size=1), finite),
    reason=st.text(),
    checkpoint=st.none() | st.text(),
)
def test_any_outcome_survives_json_bit_for_bit(condition, objectives, reason, checkpoint):
    outcome = TrialOutcome(
        3, condition, 1, reason=reason, objectives=objectives, checkpoint=checkpoint, period_s=0.1 + 0.2
    )
    assert TrialOutcome.from_record(json.loads(json.dumps(outcome.to_record()))) == outcome


@settings(max_examples=25, deadline=None)
@given(
    name=st.text(min_size=1, max_size=40),
    value=finite | st.text(max_size=60),
    reason=st.text(max_size=300),
)
def test_any_outcome_survives_the_file(tmp_path_factory, name, value, reason):
    folder = stored_runs.new_run(tmp_path_factory.mktemp("results"))
    stored = stored_runs.store(folder, 0, count=3, condition={name: value}, objectives={}, reason=reason)
    opened = RunFolder.open(folder.path)
    assert opened.outcomes() == {0: stored}
    assert open_run(opened.pack()).outcomes == [stored]


def test_a_checkpoint_larger_than_an_object_header_allows_is_stored(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    stored = stored_runs.store(
        folder, 0, checkpoint=json.dumps(np.random.default_rng(1).normal(size=20_000).tolist())
    )
    assert RunFolder.open(folder.path).outcomes() == {0: stored}


def test_an_outcome_may_hold_numbers_of_numpy(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    stored_runs.store(folder, 0, objectives={"thrust": np.float64(0.5)})
    (kept,) = RunFolder.open(folder.path).outcomes().values()
    assert kept.objectives == {"thrust": 0.5}


def test_a_device_without_samples_and_a_trial_without_command_are_stored(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    writer = folder.writer(0)
    writer.append("wrench", stored_runs.WRENCH, 100.0, Samples.empty(2))
    writer.finish(stored_runs.outcome(0), None, None)
    run = open_run(folder.path)
    assert len(run.signals(0)["wrench"].time_s) == 0
    assert run.signals(0)["wrench"].values.shape == (0, 2)
    assert run.command(0).columns == ()
    assert run.settle_curve(0) is None


NAMES_APART = ["w-x", "w_x", "w x", "w\u00fcx", "wu\u0308x", "W-x"]


def test_devices_whose_names_differ_in_one_character_are_stored_apart(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    writer = folder.writer(0)
    for count, device in enumerate(NAMES_APART, start=1):
        samples = Samples(np.arange(float(count)), np.arange(float(count)), np.full((count, 2), float(count)))
        writer.append(device, stored_runs.WRENCH, 100.0, samples)
    writer.finish(stored_runs.outcome(0), None, None)
    signals = open_run(folder.path).signals(0)
    assert {device: len(signals[device].time_s) for device in signals} == {
        device: count for count, device in enumerate(NAMES_APART, start=1)
    }


def test_runs_of_experiments_whose_names_differ_in_one_character_are_kept_apart(tmp_path):
    runs = {name: RunFolder.create(tmp_path, name, stored_runs.SPEC, {}).path for name in NAMES_APART}
    assert {name: find_run(name, tmp_path) for name in NAMES_APART} == runs


def test_blocks_join_and_losses_add_up(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    whole = stored_runs.samples(2, 120)
    writer = folder.writer(0)
    for start in range(0, 120, 7):
        part = slice(start, start + 7)
        block = Samples(
            whole.device_time_s[part], whole.host_time_s[part], whole.values[part], lost=1, saturated=2
        )
        writer.append("wrench", stored_runs.WRENCH, 100.0, block)
    writer.finish(stored_runs.outcome(0), None, None)
    stream = open_run(folder.path).signals(0)["wrench"]
    np.testing.assert_array_equal(stream.values, whole.values)
    assert (stream.lost, stream.saturated) == (18, 36)


def test_a_long_trial_spills_to_disk_and_comes_back_the_same(tmp_path, monkeypatch):
    streams = {}
    for name, limit in (("memory", writer_module.SPILL_BYTES), ("spilled", 20_000)):
        monkeypatch.setattr(writer_module, "SPILL_BYTES", limit)
        folder = stored_runs.new_run(tmp_path / name)
        writer = folder.writer(0)
        for part in range(30):
            block = stored_runs.samples(0, 100)
            later = 1.0 * part
            writer.append(
                "wrench",
                stored_runs.WRENCH,
                100.0,
                Samples(block.device_time_s + later, block.host_time_s + later, block.values + part),
            )
        spilled = any((folder.path / "trials").iterdir())
        assert spilled == (name == "spilled")
        seen = writer.signals(0.0, {})["wrench"]
        seen_pieces = list(seen.pieces())
        seen_time_s = np.concatenate([piece.time_s for piece in seen_pieces])
        seen_values = np.concatenate([piece.values for piece in seen_pieces])
        writer.finish(stored_runs.outcome(0), stored_runs.curve(), stored_runs.motion())
        streams[name] = open_run(folder.path).signals(0)["wrench"]
        np.testing.assert_array_equal(seen_time_s, streams[name].time_s)
        np.testing.assert_array_equal(seen_values, streams[name].values)
    for field in ("time_s", "device_time_s", "host_time_s", "values"):
        np.testing.assert_array_equal(getattr(streams["memory"], field), getattr(streams["spilled"], field))
    assert streams["memory"].tare == streams["spilled"].tare


def test_memory_stays_bounded_while_a_fast_sensor_runs_for_long(tmp_path, monkeypatch):
    monkeypatch.setattr(writer_module, "SPILL_BYTES", 1 << 20)
    folder = stored_runs.new_run(tmp_path)
    writer = folder.writer(0)
    channels = tuple(Channel(f"c{number}", "N") for number in range(6))
    time_s = np.arange(7000) / 7000
    values = np.zeros((7000, 6))
    tracemalloc.start()
    for second in range(60):
        writer.append("ati", channels, 7000.0, Samples(time_s + second, time_s + second, values))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most <= 5 << 20  # what is kept, and copies of it on the way to disk: not all 27 MB
    writer.finish(stored_runs.outcome(0, tare={}, started_s=0.0), None, None)
    stream = open_run(folder.path).signals(0)["ati"]
    assert len(stream.time_s) == 60 * 7000
    np.testing.assert_allclose(
        stream.time_s, np.concatenate([time_s + second for second in range(60)]), atol=1e-9
    )


def test_a_discarded_trial_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(writer_module, "SPILL_BYTES", 1000)
    folder = stored_runs.new_run(tmp_path)
    writer = folder.writer(0)
    writer.append("wrench", stored_runs.WRENCH, 100.0, stored_runs.samples(0))
    writer.discard()
    assert list((folder.path / "trials").iterdir()) == []
    assert folder.outcomes() == {}


@pytest.mark.parametrize(
    ("device", "channels"),
    [
        ("command", stored_runs.WRENCH),
        ("a/b", stored_runs.WRENCH),
        ("wrench", (Channel("time_s", "s"),)),
        ("wrench", (Channel("force", "N"), Channel("force", "N"))),
    ],
)
def test_a_name_that_would_collide_in_the_file_is_refused(tmp_path, device, channels):
    writer = stored_runs.new_run(tmp_path).writer(0)
    with pytest.raises(StoreError, match="cannot be stored"):
        writer.append(device, channels, 100.0, Samples.empty(len(channels)))


def test_the_journal_tells_size_and_digest_of_every_trial(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    stored_runs.store(folder, 0)
    event = folder.journal.events()[-1]
    assert (event["event"], event["index"], event["status"]) == ("trial", 0, "done")
    assert event["bytes"] == (folder.path / "trials" / "000000.h5").stat().st_size
    assert len(event["blake2b"]) == 32


def test_a_trial_is_found_although_its_journal_line_was_lost(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    stored = stored_runs.store_many(folder, 3)
    lines = folder.journal.path.read_text().splitlines(keepends=True)
    folder.journal.path.write_text("".join(lines[:-1]))
    assert RunFolder.open(folder.path).outcomes() == stored


def test_a_mark_changes_the_status_now_and_when_opened_again(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    stored_runs.store_many(folder, 3)
    folder.mark(1, "rejected", "thrust is 5.1 scaled deviations from the median")
    for opened in (folder.outcomes(), RunFolder.open(folder.path).outcomes()):
        assert [opened[index].status for index in range(3)] == ["done", "rejected", "done"]
        assert opened[1].reason == "thrust is 5.1 scaled deviations from the median"
    with pytest.raises(RecordingError, match="no trial 9"):
        folder.mark(9, "rejected", "")


def test_a_file_is_readable_with_plain_h5py(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    stored_runs.store(folder, 2)
    with h5py.File(folder.path / "trials" / "000002.h5") as file:
        assert set(file) == {"wrench", "command", "settle"}
        about = json.loads(file.attrs["trial"])
        wrench = about["signals"]["wrench"]
        assert wrench["times"] == ["time_s", "device_time_s", "host_time_s"]
        assert (wrench["columns"], wrench["units"]) == (["force_x", "torque_z"], ["N", "N m"])
        np.testing.assert_array_equal(file["wrench"][:, 3:], stored_runs.samples(2).values)
        assert wrench["tare"] == {"force_x": 0.25}
        assert about["outcome"]["condition"]["b"] == pytest.approx(0.2)


def test_a_run_is_held_by_one_process_at_a_time(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    with folder.lock(), folder.lock():
        other = RunFolder(folder.path)
        with pytest.raises(RigBusyError, match=f"in use by process {os.getpid()} since"), other.lock():
            pass
    with RunFolder(folder.path).lock():
        pass


def test_a_folder_that_is_no_run_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="not a run folder"):
        RunFolder.open(tmp_path)
    with pytest.raises(RecordingError, match="not a run folder"):
        open_run(tmp_path)
    with pytest.raises(RecordingError, match="cannot find the run"):
        open_run(tmp_path / "absent")


def test_asking_for_a_signal_or_trial_that_is_not_there_says_so(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    stored_runs.store(folder, 0)
    run = open_run(folder.path)
    with pytest.raises(RecordingError, match="no signal 'force_z'"):
        run.signals(0)["wrench"].column("force_z")
    with pytest.raises(RecordingError, match="has no trial 5"):
        run.signals(5)


def test_a_run_of_an_earlier_labrun_is_refused_with_one_sentence(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    stored_runs.store(folder, 0)
    journal = folder.journal.path.read_text()
    folder.journal.path.write_text(journal.replace(f', "format": {FORMAT}', "", 1))
    for opened in (RunFolder.open, open_run):
        with pytest.raises(RecordingError, match="was made by an earlier labrun"):
            opened(folder.path)
    assert sorted(path.name for path in (folder.path / "trials").iterdir()) == ["000000.h5"]


def test_a_packed_run_of_an_earlier_labrun_is_refused_with_one_sentence(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    stored_runs.store(folder, 0)
    packed = folder.pack().rename(tmp_path / "alone.h5")
    with h5py.File(packed, "r+") as file:
        del file.attrs["format"]
    with pytest.raises(RecordingError, match="was made by an earlier labrun"):
        open_run(packed)


def test_a_run_without_provenance_says_what_is_missing(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    stored_runs.store(folder, 0)
    (folder.path / "provenance.json").unlink()
    with pytest.raises(RecordingError, match=r"has no provenance\.json"):
        open_run(folder.path)
    with pytest.raises(RecordingError, match=r"has no provenance\.json"):
        _ = RunFolder.open(folder.path).provenance


@pytest.mark.parametrize("name", ["log.mcap", "log.csv", "notes"])
def test_a_file_that_is_no_run_is_told_what_labrun_reads(tmp_path, name):
    (tmp_path / name).write_text("time_s,force\n0,1\n")
    with pytest.raises(
        RecordingError, match=rf"(?s){name} is a.* and no run of labrun.*recordings"
    ) as raised:
        open_run(tmp_path / name)
    assert "restore" not in str(raised.value)
