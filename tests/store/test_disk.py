"""What a disk has room for is found out before a run begins."""

import shutil
from collections import namedtuple

from labrun.store import lacking_room

Usage = namedtuple("Usage", "total used free")


def test_a_run_that_does_not_fit_says_what_it_needs_and_what_is_free(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**9, 10**9 - 1_080_000, 1_080_000))
    told = lacking_room(tmp_path / "results" / "not yet there", 170e6)
    assert "needs 170 MB, but 1.08 MB are free" in told
    assert lacking_room(tmp_path, 1e6) is None
