"""What was synced survives a power cut, and that alone must be enough for every trial that was acknowledged."""

import errno
import os
import stat
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import stored_runs
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from labrun.errors import StoreError
from labrun.store import trial_log
from labrun.store import writer as writer_module
from labrun.store.folder import RunFolder
from labrun.store.reading import open_run

SMALL, LARGE, LONG = 200, 20_000, 40_000
FATES = ("gone", "empty", "zeros", "half", "whole")
"""What becomes of content and names that nobody synced."""


@dataclass
class Disk:
    """What is on the platters: content by inode, and names by directory, as of the last sync of each."""

    contents: dict[int, bytes] = field(default_factory=dict)
    names: dict[int, dict[str, int]] = field(default_factory=dict)

    def synced(self, descriptor: int) -> None:
        about = os.fstat(descriptor)
        path = Path(f"/proc/self/fd/{descriptor}").resolve()
        if stat.S_ISDIR(about.st_mode):
            self.names[about.st_ino] = {entry.name: entry.stat().st_ino for entry in path.iterdir()}
        elif path.exists():
            self.contents[about.st_ino] = path.read_bytes()

    def after_power_cut(self, live: Path, target: Path, fate: str) -> None:
        """Write the tree at `live` as it is found after a power cut at this moment."""
        target.mkdir(parents=True)
        known = self.names.get(live.stat().st_ino, {})
        entries = {entry.name: entry for entry in live.iterdir()}
        by_inode = {entry.stat().st_ino: entry for entry in entries.values()}
        names = known if fate == "gone" else known | {n: e.stat().st_ino for n, e in entries.items()}
        for name, inode in names.items():
            entry = by_inode.get(inode)
            if entry is not None and entry.is_dir():
                self.after_power_cut(entry, target / name, fate)
                continue
            durable = self.contents.get(inode, b"")
            now = entry.read_bytes() if entry is not None else durable
            if now != durable and not name.startswith("."):
                now = {
                    "gone": durable,
                    "empty": durable,
                    "zeros": durable + bytes(max(0, len(now) - len(durable))),
                    "half": durable + now[len(durable) : (len(durable) + len(now)) // 2],
                    "whole": now,
                }[fate]
            if name == "journal.jsonl":
                now = now.replace(b"\0", b"")  # an appended file grows with what was written to it
            (target / name).write_bytes(durable if name.startswith(".") else now)


@pytest.fixture
def disk(monkeypatch):
    found = Disk()

    def watched(real):
        def call(descriptor):
            real(descriptor)
            found.synced(descriptor)

        return call

    for name in ("fsync", "fdatasync"):
        monkeypatch.setattr(os, name, watched(getattr(os, name)))
    monkeypatch.setattr(writer_module, "SPILL_BYTES", 800_000)
    return found


def assert_all_there(path: Path, stored: dict, counts: dict) -> None:
    folder = RunFolder.open(path)
    assert folder.faults == []
    assert folder.outcomes() == stored
    run = open_run(path)
    for index, count in counts.items():
        stored_runs.assert_as_measured(run.stream(index, "wrench"), index, count)


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    counts=st.lists(st.sampled_from([SMALL, SMALL, SMALL, LARGE, LONG]), min_size=1, max_size=6),
    fate=st.sampled_from(FATES),
    dry_run=st.booleans(),
    most=st.sampled_from([40_000, trial_log.MOST]),
    sessions=st.integers(1, 3),
)
def test_every_acknowledged_trial_survives_a_power_cut(
    disk, monkeypatch, tmp_path_factory, counts, fate, dry_run, most, sessions
):
    monkeypatch.setattr(trial_log, "MOST", most)
    scratch = tmp_path_factory.mktemp("cut")
    folder = RunFolder.create(scratch / "live", "fin", stored_runs.SPEC, {"dry_run": dry_run})
    stored, known = {}, {}
    for first in range(sessions):
        with folder.lock():
            for index in range(first, len(counts), sessions):
                stored[index] = stored_runs.store(folder, index, counts[index])
                known[index] = counts[index]
                found = scratch / f"found{index}" / "fin" / folder.path.name
                disk.after_power_cut(folder.path, found, fate)
                assert_all_there(found, dict(sorted(stored.items())), known)
        assert not (folder.path / "trials" / ".log").exists()
        found = scratch / f"session{first}" / "fin" / folder.path.name
        disk.after_power_cut(folder.path, found, fate)
        assert_all_there(found, dict(sorted(stored.items())), known)
    folder.pack()
    found = scratch / "packed" / "fin" / folder.path.name
    disk.after_power_cut(folder.path, found, fate)
    assert_all_there(found, dict(sorted(stored.items())), known)


def test_a_small_trial_takes_one_sync(tmp_path, monkeypatch):
    folder = stored_runs.new_run(tmp_path)
    with folder.lock():
        stored_runs.store_many(folder, 2)
        calls = []
        for name in ("fsync", "fdatasync"):
            real = getattr(os, name)
            monkeypatch.setattr(
                os, name, lambda descriptor, n=name, real=real: (calls.append(n), real(descriptor))
            )
        stored_runs.store(folder, 2)
        assert calls == ["fdatasync"]


def test_the_log_is_gone_after_a_session_that_ended_in_order_and_a_file_removed_then_stays_removed(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    with folder.lock():
        stored_runs.store_many(folder, 3)
        assert (folder.path / "trials" / ".log").exists()
    assert sorted(path.name for path in (folder.path / "trials").iterdir()) == [
        f"{index:06d}.h5" for index in range(3)
    ]
    (folder.path / "trials" / "000001.h5").unlink()
    assert sorted(RunFolder.open(folder.path).outcomes()) == [0, 2]


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0, 1, exclude_max=True), flip=st.booleans())
def test_a_log_torn_in_its_last_trial_gives_the_trials_before_it(tmp_path_factory, share, flip):
    folder = stored_runs.new_run(tmp_path_factory.mktemp("torn"))
    stored = stored_runs.store_many(folder, 3)
    log = folder.path / "trials" / ".log"
    records = folder.log.records()
    begin, end = records[1].first + records[1].length, records[2].first + records[2].length
    content = bytearray(log.read_bytes()[:end])
    place = begin + int(share * (end - begin))
    if flip:
        content[place] ^= 1
    else:
        del content[place:]
    log.write_bytes(bytes(content))
    for index in range(3):
        (folder.path / "trials" / f"{index:06d}.h5").unlink()
    lines = folder.journal.path.read_text().splitlines(keepends=True)
    folder.journal.path.write_text("".join(line for line in lines if '"trial"' not in line))
    reopened = RunFolder.open(folder.path)
    assert reopened.outcomes() == {index: stored[index] for index in range(2)}
    assert reopened.faults == []
    assert [e["index"] for e in reopened.journal.events() if e["event"] == "trial"] == [0, 1]


def test_a_trial_stored_anew_without_the_log_is_not_put_back_to_what_it_was(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    stored_runs.store(folder, 0)
    later = stored_runs.store(folder, 0, LARGE, attempt=1)
    assert RunFolder.open(folder.path).outcomes() == {0: later}


def test_a_recovery_that_finds_the_disk_full_leaves_the_log_for_the_next(tmp_path, monkeypatch):
    folder = stored_runs.new_run(tmp_path)
    stored = stored_runs.store_many(folder, 3)
    for index in range(3):
        (folder.path / "trials" / f"{index:06d}.h5").unlink()

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(trial_log, "write_synced", refuse)
        with pytest.raises(StoreError, match="the disk is full"):
            RunFolder.open(folder.path)
    assert RunFolder.open(folder.path).outcomes() == stored


def test_a_trial_whose_own_file_cannot_be_written_is_gone_from_the_log_too(tmp_path, monkeypatch):
    folder = stored_runs.new_run(tmp_path)
    stored = stored_runs.store_many(folder, 2)

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(writer_module, "write_unsynced", refuse)
        with pytest.raises(StoreError, match="2 trials are saved"):
            stored_runs.store(folder, 2)
    stored[3] = stored_runs.store(folder, 3)
    assert sorted(folder.log.records()) == [0, 1, 3]
    assert RunFolder.open(folder.path).outcomes() == stored
