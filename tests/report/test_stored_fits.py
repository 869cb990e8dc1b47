"""Fits in a run's folder, as the findings of a run show them."""

import json

import pytest
from rich.console import Console

from labrun.app.report import stored_fits
from labrun.report.findings import StoredFit
from labrun.report.terminal import print_fit


def write(folder, name, numbers):
    (folder / "fit").mkdir(exist_ok=True)
    (folder / "fit" / name).write_text(numbers if isinstance(numbers, str) else json.dumps(numbers))


def test_every_fit_of_a_run_is_found_by_name(tmp_path):
    write(tmp_path, "pid.json", {"parameters": {}, "model": "magnitude", "method": "pid"})
    write(tmp_path, "hinge.json", {"parameters": {}, "model": "hinge", "method": "hinge"})
    assert [fit.title for fit in stored_fits(tmp_path)] == ["hinge", "magnitude, by pid"]


def test_numbers_without_an_interval_are_not_shown_as_known(tmp_path):
    entries = {
        "k": {"value": 2.0, "ci95": [1.0, 3.0], "unit": "N"},
        "b": {"value": 1.0, "ci95": None},
        "c": 3,
    }
    write(tmp_path, "a.json", {"parameters": entries})
    (fit,) = stored_fits(tmp_path)
    assert list(fit.estimates) == ["k"]
    assert fit.estimates["k"].ci95 == (1.0, 3.0)


@pytest.mark.parametrize("text", ["{", "[]", "7", '{"parameters": 3}'])
def test_what_is_not_a_fit_costs_nothing(tmp_path, text):
    write(tmp_path, "odd.json", text)
    assert all(fit.fault for fit in stored_fits(tmp_path))


def test_show_prints_estimates_and_what_a_fit_says_of_itself(tmp_path, capsys):
    numbers = {
        "parameters": {"gain": {"value": 0.00912, "ci95": [0.009, 0.0092], "unit": "N/deg"}},
        "findings": ["the lag is short"],
        "warnings": ["three trials are few"],
    }
    print_fit(StoredFit(tmp_path / "fopdt.json", numbers), Console(width=100))
    shown = capsys.readouterr().out
    for text in ("fopdt", "gain", "0.0091", "N/deg", "- the lag is short", "! three trials are few"):
        assert text in shown
