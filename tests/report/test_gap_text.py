"""A diagnosis in a terminal."""

from dataclasses import replace

import gap_examples as examples
import pytest
from gap_strategies import diagnoses
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from labrun.gap import Cause, Name, ResampledNumber
from labrun.report.gap_text import MOST_LINES, gap_lines


def words_of(diagnosis, width=140):
    return " ".join(" ".join(lines_of(diagnosis, width)).split())


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


def test_the_ladder_tells_the_error_of_each_step_in_the_outputs_unit_and_beside_it_the_noise():
    text = "\n".join(lines_of(examples.explained(), 140))
    for step in ("as stated 0.036", "recalibrated 0.017", "+ Coulomb friction 0.0025 rad", "about 0.004 rad"):
        assert step in text


def test_a_cause_comes_with_size_interval_share_of_the_gap_and_how_often_it_wins():
    text = words_of(examples.explained())
    assert "Coulomb friction at hinge: torque 0.1520 [0.1440, 0.1590] mN m" in text
    assert "closes 85 % of the gap; confidence 96 % from resamples" in text


def test_a_cause_that_helps_only_together_closes_no_more_than_the_whole_gap():
    diagnosis = examples.explained()
    cause = replace(diagnosis.causes[0], closes=-0.2, returns=1.18)
    lines = gap_lines(replace(diagnosis, causes=(cause,)), 400)
    text = " ".join(" ".join(line.plain for line in lines).split())
    assert "closes 100 % of the gap, together with the other causes only" in text


def test_rivals_are_told_with_their_cause():
    text = words_of(examples.pair())
    assert "rivals: Stribeck friction at hinge" in text
    assert "rivals: delay at torque" in text


def test_a_size_is_told_with_what_it_refers_to():
    drag = Cause(
        Name("quadratic-drag", "hinge"),
        0.9,
        {"coefficient": ResampledNumber(4.39e-5, 4e-5, 5e-5, "N m s^2/rad^2")},
        0.5,
        0.5,
        refers_to={"reference_speed": (5.1, "rad/s"), "exponent": (2.0, "1")},
    )
    text = words_of(replace(examples.explained(), causes=(drag,)))
    assert "at reference speed 5.1 rad/s, exponent 2" in text


def test_what_is_left_is_told_with_its_share_and_what_of_it_is_predictable():
    text = words_of(examples.pair())
    assert (
        "40 % of the gap (4.9 times the noise); 30 % of its square is predictable from speed of hinge" in text
    )
    assert "within the noise (0.62 times the noise)" in words_of(examples.explained())


def test_an_answer_that_was_stopped_early_says_so():
    assert "Stopped early" not in words_of(examples.pair())
    assert "Stopped early" in words_of(replace(examples.pair(), stopped="time"))


def test_the_end_of_a_long_answer_is_told():
    answer = (
        "Gain at torque differs by trial (standard deviation 0.13 %) and gain at side_force differs by trial (standard "
        "deviation 0.097 %). Beside that: end stop at root closes 41 % of the gap and asymmetric stiffness at root "
        "closes 31 % of the gap; 28 % of the gap (27 times the noise of one trial) is left, of which 80 % is "
        "predictable from the speed of the root."
    )
    assert "80 % is predictable from the speed of the root." in words_of(
        replace(examples.no_gap(), sentence=answer), 100
    )


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


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(diagnosis=diagnoses(), width=st.integers(40, 200))
def test_any_diagnosis_is_at_most_twenty_lines(diagnosis, width):
    lines = lines_of(diagnosis, width, {"report": "gap.html", "saved": "corrected.toml"})
    assert len(lines) <= MOST_LINES
    assert all(len(line) <= width for line in lines)
