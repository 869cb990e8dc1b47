"""Finding the generator, and what is said where there is none or it fails."""

from pathlib import Path

import pytest

from labrun.errors import LabrunError, RequestError
from labrun.gap.check import check
from labrun.gap.check.generator import find_generator


def test_the_generator_is_found_from_anywhere_in_the_checkout() -> None:
    root = Path(__file__).resolve().parents[3]
    assert find_generator(None, Path(__file__).parent) == root / "benchmarks" / "withheld"


def test_without_a_generator_it_is_said_where_there_is_one(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match=r"--generator") as caught:
        find_generator(None, tmp_path)
    assert str(tmp_path) in str(caught.value)


def test_a_folder_that_makes_no_cases_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match=r"has no __main__\.py"):
        find_generator(tmp_path, tmp_path)


def test_what_a_failing_generator_said_is_told(tmp_path: Path) -> None:
    generator = tmp_path / "failing"
    generator.mkdir()
    (generator / "__main__.py").write_text("raise SystemExit('no bench left to draw')\n")
    with pytest.raises(LabrunError, match=r"exit code 1:\n +no bench left to draw"):
        check(cases=1, seed=1, workers=1, generator=generator, out=tmp_path / "out")


def test_a_folder_with_something_else_in_it_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(RequestError, match="holds something else"):
        check(cases=1, seed=1, workers=1, out=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]
