"""The log file of long work, beside the folder of its answer."""

from pathlib import Path

import pytest

from labrun.app.progress_log import logged, progress_file


def test_the_log_stands_beside_the_folder_of_the_answer(tmp_path: Path) -> None:
    assert progress_file(tmp_path / "results" / "gap").parent == tmp_path / "results"


def test_the_terminal_gets_every_note_and_the_file_the_first_and_the_last_with_the_time(
    tmp_path: Path,
) -> None:
    notes: list[str] = []
    file = tmp_path / "new" / "gap-progress.log"
    with logged(notes.append, file) as note:
        for number in range(100):
            note(f"fitting: {number} of 100")
    assert len(notes) == 100
    lines = file.read_text().splitlines()
    assert 2 <= len(lines) < 100
    assert lines[0].endswith("UTC  fitting: 0 of 100")
    assert lines[-1].endswith("UTC  fitting: 99 of 100")


def test_the_last_note_is_kept_when_the_work_is_interrupted(tmp_path: Path) -> None:
    file = tmp_path / "gap-progress.log"
    with pytest.raises(KeyboardInterrupt), logged(lambda _: None, file) as note:
        note("reading")
        note("fitting: 3 of 40")
        raise KeyboardInterrupt
    assert file.read_text().splitlines()[-1].endswith("fitting: 3 of 40")


def test_a_second_run_adds_to_the_log(tmp_path: Path) -> None:
    for text in ("first", "second"):
        with logged(lambda _: None, tmp_path / "log") as note:
            note(text)
    assert [line.split("  ")[1] for line in (tmp_path / "log").read_text().splitlines()] == [
        "first",
        "second",
    ]
