"""What the disk spoiled is moved aside, told, and counts as not run; everything else stays."""

import shutil

import pytest
import stored_runs
from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.errors import RecordingError
from labrun.store.disk import FileLock
from labrun.store.folder import RunFolder
from labrun.store.reading import open_run


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    """A run of three trials, to be copied."""
    folder = stored_runs.new_run(tmp_path_factory.mktemp("template"))
    with folder.lock():
        stored_runs.store_many(folder, 3)
    return folder.path


@pytest.fixture(scope="module")
def whole(template):
    """Content of one trial file."""
    return (template / "trials" / "000001.h5").read_bytes()


@pytest.fixture(scope="module")
def packed_content(tmp_path_factory):
    """Content of a run.h5."""
    folder = stored_runs.new_run(tmp_path_factory.mktemp("packed"))
    stored_runs.store_many(folder, 2)
    return folder.pack().read_bytes()


def run_with_second_trial(template, results, content, *, journalled):
    path = shutil.copytree(template, results / "fin" / template.name)
    (path / "trials" / "000001.h5").write_bytes(content)
    if not journalled:
        journal = path / "journal.jsonl"
        lines = journal.read_text().splitlines(keepends=True)
        journal.write_text("".join(line for line in lines if '"index": 1,' not in line))
    return path


@settings(max_examples=60, deadline=None)
@given(share=st.floats(0, 1, exclude_max=True), journalled=st.booleans())
def test_a_trial_file_cut_short_anywhere_is_moved_aside(tmp_path_factory, template, whole, share, journalled):
    cut = int(share * len(whole))
    path = run_with_second_trial(
        template, tmp_path_factory.mktemp("results"), whole[:cut], journalled=journalled
    )
    assert [outcome.index for outcome in open_run(path).outcomes] == [0, 2]
    folder = RunFolder.open(path)
    assert sorted(folder.outcomes()) == [0, 2]
    assert (path / "trials" / "000001.h5.damaged").stat().st_size == cut
    assert not (path / "trials" / "000001.h5").exists()
    assert "000001.h5" in folder.faults[0]
    assert "counts as not run" in folder.faults[0]


@settings(max_examples=40, deadline=None)
@given(position=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_a_single_flipped_bit_is_found(tmp_path_factory, template, whole, position, bit):
    content = bytearray(whole)
    content[int(position * len(content))] ^= 1 << bit
    path = run_with_second_trial(
        template, tmp_path_factory.mktemp("results"), bytes(content), journalled=True
    )
    assert sorted(RunFolder.open(path).outcomes()) == [0, 2]


def test_a_damaged_trial_is_run_again_under_its_index(tmp_path, template, whole):
    path = run_with_second_trial(template, tmp_path, whole[:1000], journalled=True)
    folder = RunFolder.open(path)
    again = stored_runs.store(folder, 1, attempt=1)
    reopened = RunFolder.open(path)
    assert reopened.outcomes()[1] == again
    assert reopened.faults == []
    assert sorted(reopened.outcomes()) == [0, 1, 2]


def test_a_trial_that_was_journalled_but_is_gone_is_told(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    with folder.lock():
        stored_runs.store_many(folder, 2)
    (folder.path / "trials" / "000001.h5").unlink()
    reopened = RunFolder.open(folder.path)
    assert sorted(reopened.outcomes()) == [0]
    assert "trial 1" in reopened.faults[0]


def test_a_trial_file_under_a_wrong_name_does_not_count(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    with folder.lock():
        stored_runs.store_many(folder, 2)
    (folder.path / "trials" / "000001.h5").rename(folder.path / "trials" / "000005.h5")
    assert sorted(RunFolder.open(folder.path).outcomes()) == [0]


def test_temporary_files_of_a_crash_are_removed_when_the_run_is_opened(tmp_path):
    folder = stored_runs.new_run(tmp_path)
    stored = stored_runs.store_many(folder, 2)
    leftovers = [folder.path / "trials" / ".000002.h5.partial", folder.path / "run.h5.partial"]
    for leftover in leftovers:
        leftover.write_bytes(b"half")
    assert RunFolder.open(folder.path).outcomes() == stored
    assert not any(leftover.exists() for leftover in leftovers)


def test_a_run_held_by_someone_is_left_as_it_is(tmp_path, template, whole):
    path = run_with_second_trial(template, tmp_path, whole[:500], journalled=True)
    holder = FileLock(path / ".lock", "run")
    holder.acquire()
    assert sorted(RunFolder.open(path).outcomes()) == [0, 2]
    assert (path / "trials" / "000001.h5").exists()
    holder.release()


@settings(max_examples=30, deadline=None)
@given(share=st.floats(0, 1, exclude_max=True))
def test_a_packed_run_cut_short_is_refused_with_its_name(tmp_path_factory, packed_content, share):
    content = packed_content
    moved = tmp_path_factory.mktemp("elsewhere") / "run.h5"
    moved.write_bytes(content[: int(share * len(content))])
    with pytest.raises(RecordingError, match=r"run\.h5 cannot be read"):
        open_run(moved)
