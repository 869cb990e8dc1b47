"""What a disk has room for is found out before a run begins."""

import shutil
from collections import namedtuple

import pytest

from labrun.errors import StoreError
from labrun.store import lacking_room, require_writable, saving

Usage = namedtuple("Usage", "total used free")


def test_a_run_that_does_not_fit_says_what_it_needs_and_what_is_free(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**9, 10**9 - 1_080_000, 1_080_000))
    room = lacking_room(tmp_path / "results" / "not yet there", 170e6)
    assert "needs 170 MB, but 1.08 MB are free" in room
    assert lacking_room(tmp_path, 1e6) is None


def test_what_is_free_is_told_of_a_folder_that_is_not_made_yet(tmp_path):
    with (
        pytest.raises(StoreError, match=r"B free on this disk"),
        saving("a run", tmp_path / "results" / "swing"),
    ):
        raise PermissionError(13, "Permission denied")


def test_a_place_below_a_file_takes_nothing(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match=r"Not a directory; .* free on this disk; nothing was computed"):
        require_writable(tmp_path / "file" / "results", "the fit")
