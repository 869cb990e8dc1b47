"""What a watcher sees of a run folder, at every stage of the run."""

import fcntl
import json
import os
import platform
import subprocess
import sys
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rich.console import Console

from labrun.app.watch import Watcher
from labrun.devices import Channel, Samples
from labrun.errors import RequestError
from labrun.report.live import braille_curve, render
from labrun.runner import SimulatedClock
from labrun.search import BestSoFar
from labrun.store.folder import RunFolder
from labrun.store.trial import TrialOutcome

SPEC = """
title = "Thrust of a tail"
kind = "sweep"
[rig.devices.tail]
plugin = "simulated-servo"
[rig.devices.wrench]
plugin = "simulated-robotiq-ft300"
port = "anywhere"
[gait]
plugin = "sine"
joints.tail = { offset_deg = 0, amplitude_deg = "a", frequency_hz = 1 }
[trial]
cycles = 2
repeats = 2
[sweep]
axes = { a = [10, 20] }
[objectives.thrust]
plugin = "mean"
channel = "wrench.force_x"
goal = "maximise"
[units]
a = "deg"
"""
CHANNELS = (Channel("force_y", "N"), Channel("force_x", "N"))


@pytest.fixture
def folder(tmp_path) -> RunFolder:
    return RunFolder.create(tmp_path, "fin", SPEC, {"seed": 1})


def store(folder, index, thrust=1.0, a=10.0, **changes):
    condition = {"a": a}
    folder.journal.append("prepare", index=index, condition=condition)
    writer = folder.writer(index)
    time_s = np.arange(100) / 50
    values = np.column_stack([np.zeros(100), index + np.sin(time_s)])
    writer.append("wrench", CHANNELS, 50.0, Samples(time_s, time_s, values))
    fields = {"objectives": {"thrust": thrust}, "duration_s": 2.0, "tare": {"wrench.force_x": float(index)}}
    writer.finish(TrialOutcome(index, condition, 0, **(fields | changes)), None, None)


def shown(snapshot, width=100) -> str:
    console = Console(width=width, height=40, record=True, file=open(os.devnull, "w"))  # noqa: SIM115, PTH123
    console.print(render(snapshot, console))
    return console.export_text()


def test_trials_best_and_last_trace_are_those_of_the_run(folder):
    folder.journal.append("expected", trials=8)
    store(folder, 0, 1.0)
    store(folder, 1, 3.0, a=20.0)
    store(folder, 2, 9.0, status="rejected", reason="lost samples")
    seen = Watcher(folder.path, SimulatedClock()).look()
    assert (seen.state, seen.trials, seen.expected) == (
        "running",
        {"done": 2, "rejected": 1, "failed": 0},
        8,
    )
    assert [trial.index for trial in seen.last_trials] == [2, 1, 0]
    assert seen.best is not None
    assert (seen.best.condition, seen.best.value) == ({"a": 20.0}, 3.0)
    assert seen.units == {"thrust": "N", "a": "deg"}
    assert seen.trace is not None
    assert (seen.trace.index, seen.trace.channel, seen.trace.unit) == (2, "wrench.force_x", "N")
    np.testing.assert_allclose(seen.trace.values, np.sin(np.arange(100) / 50), atol=1e-12)
    text = shown(seen)
    for words in ("Thrust of a tail", "3 of 8 expected trials", "thrust 3 N", "a = 20", "lost samples"):
        assert words in text


def test_the_channel_can_be_chosen_and_a_wrong_one_names_those_there_are(folder):
    store(folder, 0)
    seen = Watcher(folder.path, SimulatedClock(), "wrench.force_y").look()
    assert seen.trace is not None
    assert seen.trace.channel == "wrench.force_y"
    with pytest.raises(RequestError, match=r"(?s)force_z.*wrench\.force_y, wrench\.force_x"):
        Watcher(folder.path, SimulatedClock(), "wrench.force_z").look()


def test_a_trial_that_an_outlier_rule_rejects_later_counts_no_more(folder):
    watcher = Watcher(folder.path, SimulatedClock())
    store(folder, 0, 1.0)
    store(folder, 1, 5.0, a=20.0)
    assert watcher.look().best.value == 5.0
    folder.mark(1, "rejected", "outlier")
    seen = watcher.look()
    assert seen.trials == {"done": 1, "rejected": 1, "failed": 0}
    assert seen.best.value == 1.0


def test_a_trial_whose_line_a_crash_took_is_seen_once_the_run_went_on(folder):
    store(folder, 0, 4.0)
    journal = folder.path / "journal.jsonl"
    folder.journal.close()
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(lines[:-1]))
    watcher = Watcher(folder.path, SimulatedClock())
    assert watcher.look().total == 0
    folder.journal.append("resumed")
    store(folder, 1, 2.0)
    seen = watcher.look()
    assert seen.total == 2
    assert seen.best.value == 3.0


def test_packing_takes_the_trial_files_away_and_nothing_is_lost_from_sight(folder):
    watcher = Watcher(folder.path, SimulatedClock())
    store(folder, 0)
    first = watcher.look()
    store(folder, 1)
    folder.pack()
    assert not (folder.path / "trials").exists()
    second = watcher.look()
    assert (first.trace.index, second.trace.index) == (0, 1)
    (folder.path / "run.h5").unlink()
    third = watcher.look()
    assert third.trace is second.trace


def test_a_damaged_trial_file_is_no_reason_to_stop_watching(folder):
    store(folder, 0)
    watcher = Watcher(folder.path, SimulatedClock())
    watcher.look()
    store(folder, 1)
    path = folder.path / "trials" / "000001.h5"
    path.write_bytes(path.read_bytes()[:1000])
    seen = watcher.look()
    assert seen.total == 2
    assert seen.trace.index == 0


def test_a_folder_that_vanishes_leaves_the_last_sight(folder, tmp_path):
    store(folder, 0)
    watcher = Watcher(folder.path, SimulatedClock())
    before = watcher.look()
    folder.path.rename(tmp_path / "away")
    assert watcher.look().total == before.total == 1


@pytest.mark.parametrize(
    ("event", "fields", "state"),
    [
        ("finished", {}, "finished"),
        ("interrupted", {"reason": "Ctrl-C"}, "stopped"),
        ("failed", {"reason": "device tail: no answer\n  hint"}, "stopped"),
        ("limit-reached", {"limit": 5}, "stopped"),
    ],
)
def test_how_a_run_ended_is_told_and_how_to_go_on(folder, event, fields, state):
    store(folder, 0)
    watcher = Watcher(folder.path, SimulatedClock())
    folder.journal.append(event, **fields)
    seen = watcher.look()
    assert seen.state == state
    assert (seen.resume is None) == (state == "finished")
    if state == "stopped":
        assert f"labrun resume {folder.path}" in shown(seen).replace("\n", "")
        folder.journal.append("resumed")
        assert watcher.look().state == "running"


def test_silence_is_told_when_it_is_longer_than_the_run_has_ever_paused(folder):
    (folder.path / ".lock").write_text(json.dumps({"pid": 1, "machine": "another-machine"}))
    clock = SimulatedClock()
    watcher = Watcher(folder.path, clock)
    store(folder, 0)
    assert watcher.look().state == "running"
    clock.sleep(10)
    assert watcher.look().state == "running"
    clock.sleep(10)
    seen = watcher.look()
    assert seen.state == "silent"
    assert seen.quiet_s == pytest.approx(20, abs=1)
    assert "silent since" in shown(seen)
    assert seen.resume is not None
    store(folder, 1)
    assert watcher.look().state == "running"


def _journal(folder, ages_s, **fields):
    """Write events of so many seconds ago, by the clock of the machine that runs."""
    now = datetime.now(UTC)
    lines = [
        json.dumps({"event": "record", "index": 0, "time_utc": (now - timedelta(seconds=age)).isoformat()})
        for age in ages_s
    ]
    folder.journal.close()
    (folder.path / "journal.jsonl").write_text("\n".join(lines) + "\n")


def test_a_run_with_long_recordings_is_not_called_silent_during_one(folder):
    _journal(folder, [1000, 400])
    path = folder.path / "journal.jsonl"
    os.utime(path, (path.stat().st_atime, path.stat().st_mtime - 400))
    seen = Watcher(folder.path, SimulatedClock()).look()
    assert seen.state == "running"
    assert seen.quiet_s == pytest.approx(400, abs=5)


@pytest.mark.parametrize("ahead_s", [3600, -3600])
def test_a_wrong_clock_at_the_bench_neither_hides_nor_ages_a_run(folder, ahead_s):
    _journal(folder, [-ahead_s])
    seen = Watcher(folder.path, SimulatedClock()).look()
    assert seen.state == "running"
    assert seen.quiet_s < 10
    assert "1 h 00 min" in seen.notes[0]


def test_a_process_that_is_gone_is_named_on_its_own_machine(folder):
    ended = subprocess.Popen([sys.executable, "-c", "pass"])
    ended.wait()
    clock = SimulatedClock()
    store(folder, 0)
    watcher = Watcher(folder.path, clock)
    lock = folder.path / ".lock"
    watcher.look()
    clock.sleep(5)
    for pid, state in ((os.getpid(), "running"), (ended.pid, "dead")):
        lock.write_text(json.dumps({"pid": pid, "machine": platform.node()}))
        assert watcher.look().state == state
    lock.write_text("{")
    assert watcher.look().state == "running"


def test_files_that_others_have_locked_are_read_all_the_same(folder):
    store(folder, 0)
    script = (
        "from pathlib import Path\nfrom labrun.app.watch import Watcher\n"
        "from labrun.runner import SimulatedClock\n"
        f"seen = Watcher(Path({str(folder.path)!r}), SimulatedClock()).look()\n"
        "print(seen.total, seen.trace.index)"
    )
    with folder.lock(), (folder.path / "trials" / "000000.h5").open("rb+") as trial:
        fcntl.flock(trial, fcntl.LOCK_EX)
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["1", "0"], done.stderr


def test_a_run_of_a_newer_labrun_is_watched_as_far_as_it_is_understood(tmp_path):
    folder = RunFolder.create(tmp_path, "fin", f"{SPEC}\n[later]\nkey = 1\n", {})
    store(folder, 0)
    seen = Watcher(folder.path, SimulatedClock()).look()
    assert (seen.total, seen.best, seen.trace.index) == (1, None, 0)
    assert "later" in seen.notes[0]


def test_a_run_without_a_trial_yet_is_starting_or_running(folder):
    seen = Watcher(folder.path, SimulatedClock()).look()
    assert (seen.state, seen.total, seen.trace, seen.best) == ("running", 0, None, None)
    assert "0 trials" in shown(seen)
    folder.journal.close()
    (folder.path / "journal.jsonl").unlink()
    assert Watcher(folder.path, SimulatedClock()).look().state == "starting"


def test_a_packed_file_without_its_folder_has_nothing_to_follow(folder, tmp_path):
    store(folder, 0)
    moved = tmp_path / "elsewhere" / "run.h5"
    moved.parent.mkdir()
    folder.pack().rename(moved)
    with pytest.raises(RequestError, match="labrun show"):
        Watcher(moved, SimulatedClock())


def test_a_long_trace_is_read_at_its_end_only(folder, monkeypatch):
    monkeypatch.setattr("labrun.store.watching.MOST_SAMPLES", 30)
    store(folder, 0)
    trace = Watcher(folder.path, SimulatedClock()).look().trace
    assert not trace.whole
    np.testing.assert_allclose(trace.values, np.sin(np.arange(70, 100) / 50))


def test_text_without_unicode_has_no_dots(folder):
    store(folder, 0)
    with open(os.devnull, "w", encoding="ascii") as nowhere:  # noqa: PTH123
        console = Console(width=100, record=True, file=nowhere)
        console.print(render(Watcher(folder.path, SimulatedClock()).look(), console))
    assert console.export_text().isascii()


def _seen(index, a, value, **changes):
    fields = {"role": "measure", "status": "done"} | changes
    return TrialOutcome(index, {"a": a}, 0, reason="", objectives={"thrust": value}, **fields)


def best_yet(trials, *rule):
    so_far = BestSoFar(*rule)
    for trial in trials:
        so_far.take(trial)
    return so_far.best


def test_the_best_has_all_its_repeats_as_soon_as_any_condition_has():
    lucky, twice = _seen(0, 1.0, 9.0), [_seen(1, 2.0, 4.0), _seen(2, 2.0, 6.0)]
    assert best_yet([lucky], "thrust", "maximise", 2).value == 9.0
    assert best_yet([lucky, *twice], "thrust", "maximise", 2).value == 5.0
    assert best_yet([*twice, _seen(3, 3.0, 1.0)], "thrust", "minimise", 1).value == 1.0
    others = [_seen(4, 4.0, 99.0, role="reference"), _seen(5, 5.0, 99.0, status="rejected")]
    assert best_yet([*twice, *others], "thrust", "maximise", 1).value == 5.0
    assert best_yet([], "thrust", "maximise", 1) is None


@given(
    values=arrays(float, st.integers(1, 400), elements=st.floats(-1e6, 1e6)),
    width=st.integers(1, 40),
    height=st.integers(1, 6),
)
def test_a_curve_has_its_size_and_touches_its_extremes(values, width, height):
    rows = braille_curve(np.arange(len(values)) / 10, values, width, height)
    assert [len(row) for row in rows] == [width] * height
    assert all(0x2800 <= ord(character) <= 0x28FF for row in rows for character in row)
    if values.max() > values.min():
        assert any(ord(character) & 0b1001 for character in rows[0])
        assert any(ord(character) & 0b11000000 for character in rows[-1])


def test_one_sample_among_a_hundred_thousand_shows():
    values = np.zeros(100_000)
    values[54_321] = 1.0
    rows = braille_curve(np.arange(100_000) / 1e3, values, 50, 4)
    assert rows[0].strip("\u2800")


def test_a_curve_without_a_number_is_not_drawn():
    assert braille_curve(np.arange(3.0), np.full(3, np.nan), 10, 3) == []
