"""What was synced survives a power cut, and that alone must be enough for every trial that was acknowledged."""

import os
import stat
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import stored_runs
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from labrun.store import trial_file as writer_module
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
    result = Disk()

    def watched(real):
        def call(descriptor):
            real(descriptor)
            result.synced(descriptor)

        return call

    monkeypatch.setattr(os, "fsync", watched(os.fsync))
    monkeypatch.setattr(writer_module, "SPILL_BYTES", 800_000)
    return result


def assert_all_there(path: Path, stored: dict, counts: dict) -> None:
    folder = RunFolder.open(path)
    assert folder.faults == []
    assert folder.outcomes() == stored
    run = open_run(path)
    for index, count in counts.items():
        stored_runs.assert_as_measured(run.signals(index)["wrench"], index, count)


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    counts=st.lists(st.sampled_from([SMALL, SMALL, SMALL, LARGE, LONG]), min_size=1, max_size=6),
    fate=st.sampled_from(FATES),
    sessions=st.integers(1, 3),
)
def test_every_acknowledged_trial_survives_a_power_cut(disk, tmp_path_factory, counts, fate, sessions):
    scratch = tmp_path_factory.mktemp("cut")
    folder = RunFolder.create(scratch / "live", "fin", stored_runs.SPEC, {"dry_run": False})
    stored, known = {}, {}
    for first in range(sessions):
        with folder.lock():
            for index in range(first, len(counts), sessions):
                stored[index] = stored_runs.store(folder, index, counts[index])
                known[index] = counts[index]
                result = scratch / f"found{index}" / "fin" / folder.path.name
                disk.after_power_cut(folder.path, result, fate)
                assert_all_there(result, dict(sorted(stored.items())), known)
        result = scratch / f"session{first}" / "fin" / folder.path.name
        disk.after_power_cut(folder.path, result, fate)
        assert_all_there(result, dict(sorted(stored.items())), known)
    folder.pack()
    result = scratch / "packed" / "fin" / folder.path.name
    disk.after_power_cut(folder.path, result, fate)
    assert_all_there(result, dict(sorted(stored.items())), known)


@pytest.mark.parametrize("dry_run", [False, True])
def test_a_dry_run_waits_for_no_disk(tmp_path, monkeypatch, dry_run):
    calls = []
    real = os.fsync
    monkeypatch.setattr(os, "fsync", lambda descriptor: (calls.append(descriptor), real(descriptor)))
    folder = RunFolder.create(tmp_path, "fin", stored_runs.SPEC, {"dry_run": dry_run})
    calls.clear()
    stored_runs.store_many(folder, 2)
    folder.pack()
    assert bool(calls) != dry_run
