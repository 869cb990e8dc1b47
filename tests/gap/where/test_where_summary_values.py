"""Recordings whose trials are one sample each: Table 7.2 of the source work, torque extremes of a flapping fin."""

from pathlib import Path

import numpy as np
import pytest
from where_cases import compared

from labrun.fit.dataset import load_dataset
from labrun.gap.where import find_places, missing_forces
from labrun.models import load_model

TABLE = Path(__file__).parents[3] / "experiments" / "recordings" / "table-7-2"


@pytest.fixture(scope="module")
def difference():
    model = load_model(str(TABLE / "model.toml"))
    return compared(model, load_dataset(TABLE, model).trials)


@pytest.fixture(scope="module")
def places_and_notes(difference):
    notes = []
    return find_places(difference, np.random.default_rng(0), note=notes.append), notes


def test_the_model_gives_the_simulated_extremes_that_the_source_prints(difference):
    simulated = np.concatenate(difference.simulated)
    assert simulated[:, 0] == pytest.approx([0.04, 0.14, 0.30, 0.46], abs=0.005)
    assert simulated[:, 1] == pytest.approx([-0.04, -0.14, -0.23, -0.24], abs=0.005)


def test_the_gap_is_in_the_recovery_stroke_once_buckling_starts(places_and_notes):
    places, _ = places_and_notes
    best = next(part for part in places if part.at == "recovery_stroke | buckling = one side")
    # as printed it is (0.10^2 + 0.12^2) of (0.01^2 + 0.10^2 + 0.02^2 + 0.12^2 + 0.02^2)
    assert best.share == pytest.approx(0.0244 / 0.0253, abs=0.02)
    assert best.p <= 0.05


def test_gap_and_noise_are_said_not_to_be_separable(places_and_notes):
    assert any("Nothing was repeated" in note for note in places_and_notes[1])


def test_only_channels_and_conditions_are_places_of_single_values(places_and_notes):
    assert {part.by for part in places_and_notes[0]} == {"channel", "condition"}


def test_no_force_over_time_is_told_of_single_values(difference):
    assert missing_forces(difference) == ()
