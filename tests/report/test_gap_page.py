"""The page of a diagnosis, as whoever opens it finds it."""

import re
from dataclasses import replace

import gap_examples as examples
import numpy as np
import pytest
from gap_strategies import diagnoses
from hypothesis import HealthCheck, given, settings

from labrun.gap.diagnosis import Sizes
from labrun.report.figures.gap import diagnosis_figure
from labrun.report.figures.gap_traces import traces_figure
from labrun.report.gap_page import diagnosis_page
from labrun.report.style import as_png

SENTENCE = "could not be drawn"


def words_of(text):
    body = re.sub(r"<(style|script)>.*?</\1>", "", text, flags=re.S)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", body)).replace("\u00a0", " ")


@pytest.fixture(scope="module")
def pages():
    return {name: diagnosis_page(make()) for name, make in examples.ALL.items()}


@pytest.mark.rendered
@pytest.mark.parametrize("name", examples.ALL)
def test_every_page_draws_its_pictures_and_loads_nothing(name):
    text = diagnosis_page(examples.ALL[name]())
    assert SENTENCE not in text
    assert text.count("<script") == 1
    without = re.sub(r' xmlns(:xlink)?="[^"]*"', "", text)
    assert "http://" not in without
    assert "https://" not in without
    assert set(re.findall(r' src="([^:]+):', text)) <= {"data"}
    assert set(re.findall(r' href="(.)', text)) == {"#"}
    assert set(re.findall(r'href="#([^"]+)"', text)) <= set(re.findall(r' id="([^"]+)"', text))


@pytest.mark.parametrize("name", examples.ALL)
def test_the_sentence_is_the_title_and_what_next_is_told(name, pages):
    diagnosis, words = examples.ALL[name](), words_of(pages[name])
    assert f"<h1>{diagnosis.sentence}" in pages[name].replace("&#39;", "'")
    for text in (*diagnosis.limitations, *diagnosis.what_next, *diagnosis.notes):
        assert text in words


def test_a_page_is_read_from_the_top_down(pages):
    anchors = re.findall(r'<section id="([a-z]+)">', pages["explained"])
    assert anchors == [
        "ladder",
        "which",
        "rest",
        "where",
        "next",
        "limits",
        "recalibration",
        "data",
        "origin",
    ]


def head_of(page):
    return words_of(page.split('<section id="ladder">')[0])


def test_the_head_tells_cause_size_share_and_how_often_it_wins(pages):
    head = head_of(pages["explained"])
    for text in (
        "4.2 → 0.62",
        "closes 85 % of the gap",
        "90 % interval 76 % to 90 %",
        "mN m (95 % interval)",
    ):
        assert text in head


def test_rivals_of_a_cause_stand_in_the_head_and_in_the_table(pages):
    assert "Rivals: delay at torque." in head_of(pages["pair"])
    assert "At its upper bound." in head_of(pages["pair"])
    assert "rival of lag at torque" in words_of(pages["pair"])


def test_a_size_is_told_with_what_it_refers_to(pages):
    assert "at order 1" in head_of(pages["pair"])


def test_the_ladder_is_a_table_of_the_error_of_each_model_in_the_outputs_unit(pages):
    table = words_of(pages["explained"].split('<section id="ladder">')[1].split("</table>")[0])
    for text in ("angle (rad)", "as stated 0.0364 9.1", "recalibrated 0.0168 4.2", "0.00248 0.62 85 %"):
        assert text in table


def test_the_rest_has_a_section_of_its_own(pages):
    rest = words_of(pages["unexplained"].split('<section id="rest">')[1].split("</section>")[0])
    assert "80 % of its square is predictable from position of hinge and angle" in rest


def test_a_search_that_was_stopped_early_is_marked(pages):
    assert "stopped early" not in pages["pair"]
    assert "stopped early" in diagnosis_page(
        replace(examples.pair(), stopped="interrupted", traces=(), missing=())
    )


def test_of_what_is_excluded_the_size_above_which_it_is_told(pages):
    words = words_of(pages["explained"])
    assert "time at most 0.8 ms" in words
    assert "offset between -0.002 and 0.003 rad" in words
    assert "level at least 0.88 rad" in words


def test_how_many_conditions_are_drawn_is_told(pages):
    assert "Where they differ most (3 of 5 conditions)" in words_of(pages["explained"])


def test_one_condition_claims_no_check_on_unseen_conditions(pages):
    words = words_of(pages["single-condition"])
    assert "conditions the fit never saw" not in words
    assert "as there is only one condition" in words


def test_a_parameter_far_beyond_its_tolerance_is_marked(pages):
    row = next(row for row in pages["parameter"].split("<tr") if "><td>inertia</td>" in row)
    assert row.startswith(' class="marked"')
    assert "of its tolerances" in row


def test_without_causes_no_closing_is_claimed(pages):
    for name in ("no-gap", "unexplained"):
        assert "share of the gap that closes" not in pages[name]


def test_names_from_files_never_become_markup():
    evil = replace(examples.single_condition(), name="<b>x", sentence="<script>alert(1)</script>", traces=())
    text = diagnosis_page(evil)
    assert text.count("<script") == 1
    assert "<b>x" not in text


@pytest.mark.rendered
def test_a_dollar_in_a_name_is_no_formula():
    odd = "$\\frac{$ of it"
    diagnosis = examples.static()
    diagnosis = replace(
        diagnosis,
        name=odd,
        where=tuple(replace(location, text=odd) for location in diagnosis.where),
        traces=tuple(replace(trace, label=odd) for trace in diagnosis.traces),
        channels=((odd, odd),),
        noise={odd: 0.05},
        ladder=tuple(replace(rung, errors={odd: 0.1}) for rung in diagnosis.ladder),
        missing=(replace(examples.missing_at_hinge(), site=odd),),
    )
    assert SENTENCE not in diagnosis_page(diagnosis)
    assert as_png(diagnosis_figure(diagnosis))


@pytest.mark.rendered
def test_a_page_is_the_same_for_the_same_diagnosis():
    assert diagnosis_page(examples.static()) == diagnosis_page(examples.static())


def test_a_force_whose_arrays_do_not_match_costs_no_page():
    torn = replace(examples.missing_at_hinge(), rate=(), load=(np.zeros(3),))
    text = diagnosis_page(replace(examples.static(), missing=(torn,), traces=()))
    assert SENTENCE not in text
    assert "What is missing at hinge" in text


@pytest.mark.rendered
@settings(max_examples=3, deadline=None, suppress_health_check=list(HealthCheck))
@given(diagnosis=diagnoses())
def test_any_diagnosis_becomes_a_page_and_a_picture(diagnosis):
    text = diagnosis_page(diagnosis)
    assert SENTENCE not in text
    assert set(re.findall(r'href="#([^"]+)"', text)) <= set(re.findall(r' id="([^"]+)"', text))
    assert as_png(diagnosis_figure(diagnosis))


@pytest.mark.rendered
@pytest.mark.parametrize(("noise", "size"), [(1e-304, 1e9), (1.0, 1e200), (1e300, 1e-200)])
def test_differences_of_any_size_in_noise_are_drawn(noise, size):
    diagnosis = examples.explained()
    trace = diagnosis.traces[0]
    difference = size * np.arange(1.0, 1.0 + trace.measured.size).reshape(trace.measured.shape)
    extreme = replace(trace, measured=trace.recalibrated + difference)
    diagnosis = replace(diagnosis, traces=(extreme,), noise=dict.fromkeys(diagnosis.noise, noise))
    assert as_png(traces_figure(diagnosis))


@pytest.mark.rendered
def test_a_floor_of_next_to_nothing_stays_in_the_picture():
    """Far to the left of a logarithmic axis it left no room for anything else."""
    diagnosis = replace(examples.explained(), gap=Sizes(62.0, 30.0, 1.2, 7e-9))
    figure = diagnosis_figure(diagnosis)
    figure.draw_without_rendering()
    for axes in figure.axes:
        assert axes.get_window_extent().width > 100
        for text in axes.texts:
            assert text.get_window_extent().x0 > axes.get_window_extent().x0 - 5
