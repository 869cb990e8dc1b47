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
from labrun.report.gap_page import diagnosis_page
from labrun.report.style import as_png

SENTENCE = "could not be drawn"


def words_of(text):
    body = re.sub(r"<(style|script)>.*?</\1>", "", text, flags=re.S)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", body)).replace("\u00a0", " ")


@pytest.fixture(scope="module")
def pages():
    return {name: diagnosis_page(make()) for name, make in examples.ALL.items()}


@pytest.mark.parametrize("name", examples.ALL)
def test_every_page_draws_its_pictures_and_loads_nothing(name, pages):
    text = pages[name]
    assert SENTENCE not in text
    assert text.count("<script") == 1
    without = re.sub(r' xmlns(:xlink)?="[^"]*"', "", text)
    assert "http://" not in without
    assert "https://" not in without
    assert set(re.findall(r' src="([^:]+):', text)) <= {"data"}
    assert set(re.findall(r' href="(.)', text)) == {"#"}


@pytest.mark.parametrize("name", examples.ALL)
def test_every_link_of_a_page_leads_somewhere(name, pages):
    anchors = set(re.findall(r' id="([^"]+)"', pages[name]))
    assert set(re.findall(r'href="#([^"]+)"', pages[name])) <= anchors


@pytest.mark.parametrize("name", examples.ALL)
def test_the_sentence_is_the_title_and_what_next_is_told(name, pages):
    diagnosis, words = examples.ALL[name](), words_of(pages[name])
    assert f"<h1>{diagnosis.sentence}" in pages[name].replace("&#39;", "'")
    for told in (*diagnosis.limitations, *diagnosis.what_next, *diagnosis.notes):
        assert told in words


def test_a_page_is_read_from_the_top_down(pages):
    anchors = re.findall(r'<section id="([a-z]+)">', pages["explained"])
    assert anchors == ["where", "which", "far", "next", "limits", "recalibration", "data", "origin"]


def test_the_head_tells_cause_size_confidence_and_what_closes(pages):
    head = words_of(pages["explained"].split('<section id="where">')[0])
    for told in ("96 %", "4.2 → 0.62", "97 %", "90 % interval 94 % to 99 %", "mN m (95 % interval)"):
        assert told in head


def test_causes_that_cannot_be_told_apart_stand_in_the_head(pages):
    head = words_of(pages["pair"].split('<section id="where">')[0])
    assert "cannot tell lag at torque from delay at torque" in head
    assert "At its upper bound." in head


def test_of_what_is_ruled_out_the_room_that_is_left_is_told(pages):
    words = words_of(pages["explained"])
    assert "time at most 0.8 ms" in words
    assert "offset between -0.002 and 0.003 rad" in words
    assert "level at least 0.88 rad" in words


def test_how_many_conditions_are_drawn_is_told_and_what_makes_it_worse(pages):
    words = words_of(pages["explained"])
    assert "Where they differ most (3 of 5 conditions)" in words
    assert "makes it worse" in words


def test_one_condition_claims_no_check_on_unseen_conditions(pages):
    words = words_of(pages["single-condition"])
    assert "conditions the fit never saw" not in words
    assert "as there is only one condition" in words


def test_a_parameter_far_beyond_its_tolerance_is_marked(pages):
    row = next(row for row in pages["parameter"].split("<tr") if "><td>inertia</td>" in row)
    assert row.startswith(' class="marked"')
    assert "of its tolerances" in row


def test_without_causes_no_closing_is_claimed(pages):
    for name in ("no-gap", "not-in-library"):
        assert "share of the gap that closes" not in pages[name]


def test_names_from_files_never_become_markup():
    evil = replace(examples.single_condition(), name="<b>x", sentence="<script>alert(1)</script>", traces=())
    text = diagnosis_page(evil)
    assert text.count("<script") == 1
    assert "<b>x" not in text


def test_a_dollar_in_a_name_is_no_formula():
    odd = "$\\frac{$ of it"
    diagnosis = examples.static()
    diagnosis = replace(
        diagnosis,
        name=odd,
        where=tuple(replace(place, text=odd) for place in diagnosis.where),
        traces=tuple(replace(trace, label=odd) for trace in diagnosis.traces),
        channels=((odd, odd), (odd, odd)),
        missing=(replace(examples.missing_at_hinge(), site=odd),),
    )
    assert SENTENCE not in diagnosis_page(diagnosis)
    assert as_png(diagnosis_figure(diagnosis))


def test_a_page_is_the_same_for_the_same_diagnosis(pages):
    assert diagnosis_page(examples.static()) == pages["static"]


def test_a_force_whose_arrays_do_not_match_costs_no_page():
    torn = replace(examples.missing_at_hinge(), rate=(), load=(np.zeros(3),))
    text = diagnosis_page(replace(examples.static(), missing=(torn,), traces=()))
    assert SENTENCE not in text
    assert "What is missing at hinge" in text


@settings(max_examples=3, deadline=None, suppress_health_check=list(HealthCheck))
@given(diagnosis=diagnoses())
def test_any_diagnosis_becomes_a_page_and_a_picture(diagnosis):
    text = diagnosis_page(diagnosis)
    assert SENTENCE not in text
    assert set(re.findall(r'href="#([^"]+)"', text)) <= set(re.findall(r' id="([^"]+)"', text))
    assert as_png(diagnosis_figure(diagnosis))


def test_a_floor_of_next_to_nothing_stays_in_the_picture():
    """Far to the left of a logarithmic axis it left no room for anything else."""
    found = replace(examples.explained(), gap=Sizes(62.0, 30.0, 1.2, 7e-9))
    figure = diagnosis_figure(found)
    figure.draw_without_rendering()
    for axes in figure.axes:
        assert axes.get_window_extent().width > 100
        for text in axes.texts:
            assert text.get_window_extent().x0 > axes.get_window_extent().x0 - 5
