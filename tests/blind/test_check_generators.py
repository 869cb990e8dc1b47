"""What is said where there is no generator, where it fails, or where it may not write."""

from pathlib import Path

import pytest

from labrun.blind import check
from labrun.errors import LabrunError, RequestError


def test_a_folder_that_makes_no_cases_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match=r"has no __main__\.py"):
        check(cases=1, seed=1, workers=1, generator=tmp_path, out=tmp_path / "out")


def test_what_a_failing_generator_said_is_told(tmp_path: Path) -> None:
    generator = tmp_path / "failing"
    generator.mkdir()
    (generator / "__main__.py").write_text("raise SystemExit('no bench left to draw')\n")
    with pytest.raises(LabrunError, match=r"exit code 1:\n +no bench left to draw"):
        check(cases=1, seed=1, workers=1, generator=generator, out=tmp_path / "out")


def test_a_folder_with_something_else_in_it_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(RequestError, match="is not a check"):
        check(cases=1, seed=1, workers=1, out=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]
