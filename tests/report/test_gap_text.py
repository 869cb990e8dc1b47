"""A diagnosis in a terminal."""

from dataclasses import replace

import gap_examples as examples
import pytest
from gap_strategies import diagnoses
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from labrun.report.gap_text import MOST_LINES, gap_lines


def lines_of(diagnosis, width, files=None):
    return [line.plain.replace("\u00a0", " ") for line in gap_lines(diagnosis, width, files)]


@pytest.mark.parametrize("width", [80, 120])
@pytest.mark.parametrize("name", examples.ALL)
def test_a_diagnosis_is_told_in_twenty_lines_that_fit(name, width, tmp_path):
    diagnosis = examples.ALL[name]()
    lines = lines_of(
        diagnosis, width, {"report": tmp_path / "gap.html", "saved": tmp_path / "corrected.toml"}
    )
    assert len(lines) <= MOST_LINES
    assert all(len(line) <= width for line in lines[:-2])
    assert lines[-1].endswith("corrected.toml")
    assert diagnosis.sentence.startswith(lines[0])


def test_the_cause_comes_with_confidence_and_interval():
    text = "\n".join(lines_of(examples.explained(), 120))
    assert "Coulomb friction at hinge, confidence 96 %: torque 0.1520 [0.1440, 0.1590] mN m" in text
    assert "9.1 as stated > 4.2 recalibrated > 0.62 with the cause; noise floor 0.8" in text
    assert "97 % of it closes on unseen conditions (90 % interval 94 % to 99 %)" in text


def test_what_cannot_be_told_apart_is_told_with_the_cause():
    assert any(
        "lag at torque, confidence 55 %, or delay at torque" in line
        for line in lines_of(examples.pair(), 120)
    )


def test_the_law_at_the_end_of_a_long_verdict_is_told():
    verdict = (
        "Gain at torque differs by trial (standard deviation 0.13 %) and gain at side_force differs by trial (standard "
        "deviation 0.097 %). Beside that: the cause is not in the library: a gap of 27 times one trial's noise remains "
        "after recalibration; the nearest, end stop at root and asymmetric stiffness at root, remove 91 % of it, but a "
        "law of signal at torque explains more without them."
    )
    told = " ".join(lines_of(replace(examples.no_gap(), sentence=verdict), 100))
    assert "a law of signal at torque explains more without them." in told


def test_a_narrow_part_that_holds_most_is_named_first():
    lines = lines_of(examples.static(), 120)
    where = next(line for line in lines if line.startswith("where"))
    assert where == "where    79 %  in the recovery torque from 0.3 Hz on"


def test_a_part_that_holds_more_than_all_since_others_are_below_the_noise_holds_all_of_it():
    diagnosis = examples.explained()
    first = replace(diagnosis.where[0], share=1.31)
    lines = lines_of(replace(diagnosis, where=(first, *diagnosis.where[1:])), 120)
    assert "where    100 %  at frequencies of 2 to 4 Hz (p = 0.005)" in lines


def test_where_the_signal_is_says_nothing_about_the_gap():
    diagnosis = examples.explained()
    swing = replace(diagnosis.where[0], part=0.95)
    text = "\n".join(lines_of(replace(diagnosis, where=(swing, *diagnosis.where[1:])), 120))
    assert "where    44 %  at release 10 (p = 0.005)" in text
    assert "2 to 4 Hz" not in text


def test_a_part_is_told_where_its_p_is_the_least_that_few_draws_allow():
    diagnosis = examples.explained()
    first = replace(diagnosis.where[0], p=0.05)
    text = "\n".join(lines_of(replace(diagnosis, where=(first, *diagnosis.where[1:])), 120))
    assert "91 %  at frequencies of 2 to 4 Hz (p = 0.05)" in text


def test_without_a_gap_no_place_is_blamed():
    assert not any(line.startswith("where") for line in lines_of(examples.no_gap(), 120))


def test_a_single_condition_is_not_called_unseen():
    assert "unseen" not in "\n".join(lines_of(examples.single_condition(), 120))


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(diagnosis=diagnoses(), width=st.integers(40, 200))
def test_any_diagnosis_is_at_most_twenty_lines(diagnosis, width):
    lines = lines_of(diagnosis, width, {"report": "gap.html", "saved": "corrected.toml"})
    assert len(lines) <= MOST_LINES
    assert all(len(line) <= width for line in lines)
