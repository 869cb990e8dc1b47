"""What any model could gain: of a gap that goes with the motion much, of noise nothing; told in words and JSON."""

from dataclasses import replace

import gap_examples
import numpy as np
import pytest
from labrun.gap.verdict import VerdictBasis
from swings import dataset_of, swing

from labrun.gap.averaging import averaged
from labrun.gap.diagnosis import BeyondScatter, Learnable, Sizes
from labrun.gap.learnable import beyond_scatter, learnable_share
from labrun.gap.recalibration import recalibrate
from labrun.models import load_model
from labrun.report.gap_text import gap_lines

from .benches import CONDITIONS, TRUE, nothing, pendulum, recorded


def left_by(sensor):
    rng = np.random.default_rng(1)
    made = []
    for release in (0.5, 0.7, 0.9, 1.1):
        time_s, angle = swing(release, duration_s=3.0, rate_hz=120.0)
        made.append((time_s, angle + sensor(angle) + 1e-3 * rng.standard_normal(len(angle))))
    model = load_model("hinge-pendulum").with_values(
        {"inertia": 1.2e-3, "gravity_torque": 0.06, "stiffness": 0.0686}
    )
    return recalibrate(model, averaged(dataset_of(made), model), np.random.default_rng(0), lambda _: None)


def test_of_noise_nothing_can_be_learned_and_of_an_error_that_goes_with_the_motion_much():
    noise, error = left_by(np.zeros_like), left_by(lambda angle: 5e-3 * np.sin(12 * angle))
    assert learnable_share(noise.problem, noise.z) < 0.1
    assert learnable_share(noise.problem, noise.z, conditions=True) < 0.1
    assert learnable_share(error.problem, error.z) > 0.5


def test_parameters_that_scatter_by_trial_are_learned_but_are_no_gap_and_a_law_beyond_them_is():
    def left(extra, scatter):
        datasets = [
            recorded(
                extra,
                true={**TRUE, "stiffness": (1 + off) * TRUE["stiffness"]},
                repeats=1,
                noise=2e-4,
                seed=place,
                conditions=[one],
            )
            for place, (one, off) in enumerate(zip(CONDITIONS, scatter, strict=True))
        ]
        data = replace(datasets[0], trials=tuple(trial for one in datasets for trial in one.trials))
        model = pendulum()
        found = recalibrate(model, averaged(data, model), np.random.default_rng(0), lambda _: None)
        return found.problem, found.z, found.noise

    scattered = left(nothing, (0.01, -0.012, 0.008, -0.01, 0.006))
    assert learnable_share(*scattered[:2]) > 0.1
    assert beyond_scatter(*scattered).learnable < 0.02
    cogging = left(lambda t, q, v: 0.012 * float(np.sin(8.0 * q)), (0.0,) * 5)
    assert beyond_scatter(*cogging).learnable > 0.2


@pytest.mark.parametrize(
    ("conditions", "told"), [(None, "one condition"), (0.4, "on unseen conditions 40 %")]
)
def test_a_diagnosis_says_what_could_be_learned(conditions, told):
    diagnosis = replace(gap_examples.not_in_library(), learnable=Learnable(0.8, conditions))
    lines = [line.plain for line in gap_lines(diagnosis, 100)]
    (line,) = [one for one in lines if "could be learned" in one]
    assert "at least 80 % could be learned, at most 20 % is noise" in line
    assert len(lines) <= 20
    told = {"pieces_of_time": 0.8, "conditions": conditions, "why_no_noise": ""}
    assert diagnosis.to_json()["learnable"] == told


def test_what_nothing_learns_is_noise_unless_something_else_tells_that_it_is_not():
    told = Learnable(0.001, 0.0).sentence
    assert told.endswith("nothing could be learned: it is noise, or goes with what was not recorded")
    told = Learnable(0.001, 0.0, "its spectrum has lines").sentence
    assert told.endswith("nothing could be learned, but its spectrum has lines: it is no noise")
    told = Learnable(0.03, 0.0, "repeats agree on it").sentence
    assert told.endswith("at least 3 % could be learned, and repeats agree on it")


@pytest.mark.parametrize(
    ("noise_known", "left", "why"),
    [
        (False, BeyondScatter(chance_of_lines=1e-9), "its spectrum has lines"),
        (False, BeyondScatter(size=1e3), "no sensor adds so much"),
        (True, BeyondScatter(size=3.0), "repeats agree on it"),
        (False, BeyondScatter(learnable=0.9), ""),
        (False, BeyondScatter(), ""),
    ],
)
def test_what_is_left_is_a_gap_by_its_kind_or_its_size(noise_known, left, why):
    basis = VerdictBasis(Sizes(5.0, 4.0, 2.0, 0.15), True, noise_known, 1, beyond_scatter=left, trials=4)
    assert basis.why_no_noise == why
    assert basis.left_is_gap == bool(why or left.learnable)
