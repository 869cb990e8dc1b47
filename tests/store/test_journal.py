"""The journal keeps every event it acknowledged, and says what a crash tore."""

import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun.errors import RecordingError, StoreError
from labrun.store.journal import Journal


def journal(folder: Path, events: int) -> Journal:
    made = Journal(folder / "journal.jsonl")
    for number in range(events):
        made.append("trial", index=number, sync=False)
    made.close()
    return made


def test_events_come_back_in_order_with_their_fields_and_a_utc_time(tmp_path):
    kept = Journal(tmp_path / "journal.jsonl")
    kept.append("settled", clock_s=12.5, spread=np.float64(0.25), channels=("a", "b"))
    kept.append("trial", index=np.int64(3))
    settled, trial = kept.events()
    assert settled["event"] == "settled"
    assert (settled["clock_s"], settled["spread"], settled["channels"]) == (12.5, 0.25, ["a", "b"])
    assert settled["time_utc"].endswith("+00:00")
    assert trial["index"] == 3


def test_a_synced_event_is_on_disk_before_append_returns(tmp_path, monkeypatch):
    synced: list[int] = []
    real = os.fsync
    monkeypatch.setattr(
        os, "fsync", lambda descriptor: (synced.append(os.fstat(descriptor).st_size), real(descriptor))
    )
    kept = Journal(tmp_path / "journal.jsonl")
    kept.append("looked", sync=False)
    assert synced == []
    kept.append("moves")
    assert synced == [(tmp_path / "journal.jsonl").stat().st_size]


def test_a_journal_that_does_not_exist_has_no_events(tmp_path):
    assert Journal(tmp_path / "journal.jsonl").events() == []


@given(cut=st.integers(1, 200))
def test_a_torn_last_line_is_dropped_told_and_cut_off_before_the_next_event(tmp_path_factory, cut):
    folder = tmp_path_factory.mktemp("run")
    journal(folder, 5)
    path = folder / "journal.jsonl"
    content = path.read_bytes()
    path.write_bytes(content[: len(content) - cut])
    whole = content[: len(content) - cut].count(b"\n")

    torn = Journal(path)
    assert [event["index"] for event in torn.events()] == list(range(whole))
    ends_in_line = not content[: len(content) - cut].endswith(b"\n")
    assert (torn.torn is not None) == ends_in_line
    if ends_in_line:
        assert f"{path}:{whole + 1}:" in torn.torn
    torn.append("resumed")
    assert [event["event"] for event in Journal(path).events()] == ["trial"] * whole + ["resumed"]


def test_a_last_line_of_zeros_as_a_power_cut_leaves_it_counts_as_torn(tmp_path):
    kept = journal(tmp_path, 2)
    with kept.path.open("ab") as file:
        file.write(b"\0" * 40 + b"\n")
    assert len(kept.events()) == 2
    assert kept.torn is not None


def test_a_torn_line_in_the_middle_is_an_error_with_its_number(tmp_path):
    kept = journal(tmp_path, 4)
    lines = kept.path.read_text().splitlines()
    lines[1] = lines[1][:10]
    kept.path.write_text("\n".join(lines) + "\n")
    with pytest.raises(RecordingError, match=r"journal\.jsonl:2: not a journal event"):
        kept.events()


def test_a_full_disk_leaves_the_journal_as_it_was(tmp_path, monkeypatch):
    kept = journal(tmp_path, 3)
    before = kept.path.read_bytes()

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StoreError, match="the disk is full"):
        kept.append("trial", index=3)
    assert kept.path.read_bytes() == before


names = st.text(min_size=1).filter(lambda name: name not in {"event", "sync", "self", "time_utc"})


@given(st.dictionaries(names, st.integers() | st.text() | st.floats(allow_nan=False)))
def test_any_field_survives(tmp_path_factory, fields):
    kept = Journal(tmp_path_factory.mktemp("run") / "journal.jsonl")
    kept.append("noted", **fields)
    kept.close()
    (event,) = kept.events()
    assert {name: event[name] for name in fields} == fields
    assert json.loads(kept.text())["event"] == "noted"
