"""Without repeats a cause is believed because it explains what chance does not, whatever the size of the noise."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun.gap.diagnose import Options, diagnose_dataset
from labrun.gap.noise import of_sensor
from labrun.gap.noise_threshold import NoiseThreshold
from labrun.gap.null import independent_share

from .benches import CONDITIONS, dry_friction, nothing, pendulum, recorded

QUICK = Options(places=False)


@given(st.floats(0.01, 0.98), st.floats(1e-6, 1e6))
def test_evidence_counts_shares_not_sizes(share: float, size: float) -> None:
    one = NoiseThreshold(gain=0.3, dispersion=0.02, squares=1.0)
    scaled = NoiseThreshold(gain=0.3 * size, dispersion=0.02 * size, squares=size)
    assert scaled.evidence(share * size) == pytest.approx(one.evidence(share))
    assert scaled.log_likelihood(share * size) == pytest.approx(one.log_likelihood(share))


def test_what_removes_nearly_all_is_far_beyond_what_chance_removes() -> None:
    threshold = NoiseThreshold(gain=0.8, dispersion=0.1, squares=1.0)
    assert threshold.evidence(0.99) > 20
    assert threshold.evidence(0.8) == pytest.approx(1.0)


def test_white_noise_has_an_independent_number_to_each_sample_and_a_sine_few_to_a_trial() -> None:
    rng = np.random.default_rng(0)
    noise = [rng.standard_normal((1000, 1)) for _ in range(4)]
    sine = [np.sin(2 * np.pi * 5 * np.arange(1000) / 1000)[:, None]]
    assert independent_share(noise) > 0.85
    assert independent_share(sine) == pytest.approx(4 / 1000, rel=1e-3)


@pytest.mark.parametrize("slow", [0.0, 0.05])
def test_the_noise_of_a_sensor_is_seen_beside_a_slow_gap(slow: float) -> None:
    data = recorded(repeats=1, noise=0.004)
    data = replace(data, trials=tuple(replace(one, members=(one.outputs,)) for one in data.trials))
    rng = np.random.default_rng(1)
    residual = [
        0.004 * rng.standard_normal(one.outputs.shape) + slow * np.sin(2 * np.pi * 0.7 * one.time_s)[:, None]
        for one in data.trials
    ]
    assert of_sensor(data, residual).sd[0] == pytest.approx(0.004, rel=0.1)


def test_friction_is_named_from_trials_that_were_never_repeated() -> None:
    found = diagnose_dataset(
        recorded(dry_friction(0.006), repeats=1, conditions=CONDITIONS[:3]), pendulum(), QUICK
    )
    assert [str(one.name) for one in found.causes] == ["coulomb-friction at hinge"]
    assert found.causes[0].values["torque"].value == pytest.approx(0.006, rel=0.1)
    assert found.verdict == "explained"


def test_what_no_model_predicts_is_not_called_a_gap() -> None:
    found = diagnose_dataset(recorded(nothing, repeats=1), pendulum(), QUICK)
    assert not found.causes
    assert found.verdict in ("parameter", "undecided", "no-gap")
    assert found.gap.recalibrated <= found.gap.raw


def test_a_law_that_the_library_lacks_is_no_noise_even_without_repeats() -> None:
    cogging = diagnose_dataset(
        recorded(lambda t, q, v: 0.012 * float(np.sin(8.0 * q)), repeats=1), pendulum(), QUICK
    )
    assert cogging.verdict == "not-in-library"


def test_where_nothing_shows_no_gain_is_evidence():
    assert NoiseThreshold(gain=0.0, dispersion=1.0).evidence(3.0) == 0.0
