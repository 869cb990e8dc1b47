"""What differs from trial to trial is told as such, and neither taken for noise nor for a cause common to all."""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from labrun.fit import Dataset, Deviation, DeviationKind, silent
from labrun.fit.variables import deviated
from labrun.gap.averaging import averaged
from labrun.gap.diagnose import Options, diagnose_dataset
from labrun.gap.recalibration import recalibrate, stated_problem
from labrun.gap.trial_wise import (
    deviations_without_repeats,
    outputs_without_common_zero,
    shape_of,
    simulated_changes,
    words,
)

from .benches import CONDITIONS, TRUE, FloatArray, among, dry_friction, nothing, pendulum, recorded

QUICK = Options(places=False)
FEW = among("coulomb-friction", "bias", "rest-offset", "constant-force", "drift")


def with_zeros_set_anew(data: Dataset, sd: float, common: float = 0.0) -> Dataset:
    rng = np.random.default_rng(3)
    trials = [
        replace(trial, outputs=trial.outputs + common + sd * rng.standard_normal()) for trial in data.trials
    ]
    return replace(data, trials=tuple(trials))


def test_friction_is_found_behind_zeros_that_are_set_anew() -> None:
    dataset = diagnose_dataset(
        with_zeros_set_anew(recorded(dry_friction(0.006), noise=0.002, conditions=CONDITIONS[:3]), 0.03),
        pendulum(),
        FEW,
    )
    assert dataset.differs == ("bias at angle differs by trial (standard deviation 0.043 rad)",)  # as drawn
    assert dataset.sentence.startswith("Bias at angle differs by trial")
    assert dataset.causes[0].values["torque"].value == pytest.approx(0.006, rel=0.02)
    assert dataset.noise["angle"] == pytest.approx(0.002, rel=0.1)


def test_zeros_that_are_set_anew_are_no_cause() -> None:
    dataset = diagnose_dataset(with_zeros_set_anew(recorded(nothing), 0.03), pendulum(), FEW)
    assert dataset.differs
    assert not dataset.causes


def test_a_bias_common_to_all_trials_is_told_beside_zeros_that_are_set_anew() -> None:
    data = with_zeros_set_anew(recorded(nothing), 0.01, common=0.1)
    (sentence,) = diagnose_dataset(data, pendulum(), FEW).differs
    mean = re.fullmatch(
        r"bias at angle differs by trial \(mean (\S+) rad, standard deviation 0.01\d rad\)", sentence
    )
    assert mean is not None
    assert float(mean[1]) == pytest.approx(0.1, abs=3 * 0.01 / np.sqrt(len(data.trials)))


def test_a_deviation_without_unit_keeps_its_digits() -> None:
    assert words(Deviation("bias", 0, 0.011), [("share", "1")]) == (
        "bias at share differs by trial (standard deviation 0.011)"
    )


def never_repeated() -> Dataset:
    return recorded(repeats=1)


def noise_like(data: Dataset, size: float, seed: int = 5) -> list[FloatArray]:
    rng = np.random.default_rng(seed)
    return [size * rng.standard_normal(trial.outputs.shape) for trial in data.trials]


def test_zeros_set_anew_are_seen_without_repeats() -> None:
    data = never_repeated()
    zeros = [0.01, -0.008, 0.012, -0.02, 0.004]
    left = [values + zero for values, zero in zip(noise_like(data, 0.002), zeros, strict=True)]
    (result,), *_ = deviations_without_repeats(data, left, swings(data))
    assert (result.kind, result.output) == ("bias", 0)
    assert result.sd == pytest.approx(np.sqrt(np.mean(np.square(zeros))), rel=0.05)


def swings(data: Dataset) -> list[FloatArray]:
    """Return what a model says of the trials: swings of different size and frequency."""
    return [
        (0.3 + 0.1 * index) * np.sin((3.0 + 0.2 * index) * trial.time_s)[:, None]
        for index, trial in enumerate(data.trials)
    ]


@pytest.mark.parametrize("kind", ["gain", "start time"])
def test_gains_and_start_times_are_seen_without_repeats(kind: DeviationKind) -> None:
    data = never_repeated()
    simulated = swings(data)
    sizes = [0.05, -0.04, 0.02, -0.06, 0.01]
    left = [
        size * shape_of(kind, swing, trial.time_s) + noise
        for size, swing, trial, noise in zip(
            sizes, simulated, data.trials, noise_like(data, 0.002), strict=True
        )
    ]
    (result,), *_ = deviations_without_repeats(data, left, simulated)
    assert result.kind == kind
    assert result.sd == pytest.approx(np.sqrt(np.mean(np.square(sizes))), rel=0.1)


def test_a_zero_that_all_trials_share_is_no_difference_between_them() -> None:
    data = never_repeated()
    assert (
        deviations_without_repeats(data, [values + 0.05 for values in noise_like(data, 0.002)], swings(data))
        == []
    )


def test_zeros_set_anew_have_no_part_in_common_unless_all_trials_plainly_share_it() -> None:
    zero, data = [Deviation("bias", 0, 0.01)], never_repeated()
    zeros = [0.01, -0.008, 0.012, -0.02, 0.004]
    assert outputs_without_common_zero(
        [values + of for values, of in zip(noise_like(data, 1e-3), zeros, strict=True)], zero
    ) == [0]
    shared = [values + 0.5 + of for values, of in zip(noise_like(data, 1e-3), zeros, strict=True)]
    assert outputs_without_common_zero(shared, zero) == []


def test_what_comes_and_goes_within_a_trial_is_no_offset_of_it() -> None:
    data = never_repeated()
    slow = [
        0.02 * np.sin(2 * np.pi * (0.13 + 0.02 * index) * trial.time_s + index)[:, None]
        for index, trial in enumerate(data.trials)
    ]
    assert deviations_without_repeats(data, slow, swings(data)) == []


GAINS = (1.06, 0.95, 1.02, 0.93, 1.05)


def with_an_amplifier_that_is_never_the_same(data: Dataset) -> Dataset:
    """Return trials in which the motor got so many times what was commanded."""
    trials = [
        replace(trial, inputs=trial.inputs / gain) for trial, gain in zip(data.trials, GAINS, strict=True)
    ]
    return replace(data, trials=tuple(trials))


def test_what_a_gain_of_an_input_changes_is_what_a_larger_input_does() -> None:
    problem = stated_problem(pendulum(), never_repeated())
    z = problem.begin()
    changes = simulated_changes(problem, z)["input gain", 0]
    larger = [replace(trial, inputs=1.01 * trial.inputs) for trial in problem.data.trials]
    after = problem.on(replace(problem.data, trials=tuple(larger))).simulated(z)
    for change, now, then in zip(changes, problem.simulated(z), after, strict=True):
        assert now + 0.01 * change == pytest.approx(then, abs=5e-4)


def test_gains_of_an_input_are_told_from_those_of_the_sensor() -> None:
    data = never_repeated()
    problem = stated_problem(pendulum(), data)
    simulated, changes = problem.simulated(problem.begin()), simulated_changes(problem, problem.begin())
    left = [
        (gain - 1.0) * change + noise
        for gain, change, noise in zip(GAINS, changes["input gain", 0], noise_like(data, 1e-4), strict=True)
    ]
    (result,), *_ = deviations_without_repeats(data, left, simulated, changes)
    assert (result.kind, result.output) == ("input gain", 0)
    assert words(result, [("angle", "rad")], (), [("torque", "N m")]).startswith("gain at torque differs")


def test_a_gain_of_an_input_is_worth_a_fit_where_friction_holds_the_joint_still_for_a_while() -> None:
    data = never_repeated()
    changes = {("input gain", 0): swings(data)}
    left = []
    for gain, change in zip(GAINS, changes["input gain", 0], strict=True):
        half = len(change) // 2
        left.append((gain - 1.0) * change * np.repeat([[0.05], [1.0]], [half, len(change) - half], axis=0))
    assert ("input gain", 0) in [
        (deviation.kind, deviation.output)
        for (deviation, *_) in deviations_without_repeats(data, left, swings(data), changes)
    ]


@pytest.mark.slow
def test_friction_is_found_behind_an_amplifier_that_is_never_the_same() -> None:
    alike = [(0.05, frequency) for frequency in (0.7, 0.75, 0.8, 0.85, 0.9)]
    data = recorded(dry_friction(0.006), repeats=1, noise=0.001, conditions=alike)
    data = with_an_amplifier_that_is_never_the_same(data)
    dataset = diagnose_dataset(data, pendulum(), QUICK)
    assert dataset.differs[0].startswith("gain at torque differs by trial")
    assert [str(cause.name) for cause in dataset.causes] == ["coulomb-friction at hinge"]
    assert dataset.causes[0].values["torque"].value == pytest.approx(0.006, rel=0.1)


@pytest.mark.slow
def test_friction_is_found_behind_zeros_set_anew_without_repeats() -> None:
    data = with_zeros_set_anew(recorded(dry_friction(0.006), repeats=1), 0.03)
    dataset = diagnose_dataset(data, pendulum(), QUICK)
    assert dataset.differs[0].startswith("bias at angle differs by trial")
    assert dataset.causes[0].name.effect == "coulomb-friction"
    assert dataset.causes[0].values["torque"].value == pytest.approx(0.006, rel=0.02)


def test_a_trial_that_began_late_is_shifted_and_a_gain_is_a_factor() -> None:
    time_s = np.linspace(0.0, 1.0, 101)
    outputs = np.column_stack([time_s, np.ones(101)])
    late = deviated(outputs, time_s, [Deviation("start time", None, 0.1)], np.array([1.0]), 1)
    assert late[50] == pytest.approx([0.4, 1.0])
    larger = deviated(outputs, time_s, [Deviation("gain", 0, 0.2)], np.array([-1.0]), 4)
    assert larger[50] == pytest.approx([0.45, 1.0])


def test_a_deviation_is_told_in_its_unit() -> None:
    outputs = [("angle", "rad")]
    assert words(Deviation("gain", 0, 0.012), outputs).endswith("(standard deviation 1.2 %)")
    assert words(Deviation("start time", None, 0.02), outputs).startswith("the start time")


def wandering(data: Dataset, size: float) -> Dataset:
    """Return trials whose sensor has 1/f noise of a standard deviation, as amplifiers do."""
    rng = np.random.default_rng(11)
    trials = []
    for trial in data.trials:
        spectrum = np.fft.rfft(rng.standard_normal(4 * len(trial.time_s)))
        spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)))
        noise = np.fft.irfft(spectrum)[: len(trial.time_s)]
        trials.append(replace(trial, outputs=trial.outputs + size * (noise / np.std(noise))[:, None]))
    return replace(data, trials=tuple(trials))


def released(angles: Sequence[float], slow: float, rate_hz: float = 100.0) -> Dataset:
    """Return driven trials of the true pendulum from these angles, with white and with 1/f noise."""
    time_s, made, rng = np.arange(0.0, 4.0, 1 / rate_hz), [], np.random.default_rng(2)
    for trial, angle, (amplitude, frequency_hz) in zip(
        never_repeated().trials, angles, CONDITIONS, strict=True
    ):
        torque = amplitude * np.sin(2 * np.pi * frequency_hz * time_s)

        def slope(t: float, x: FloatArray, torque: FloatArray = torque) -> list[float]:
            held = TRUE["stiffness"] * x[0] + TRUE["damping"] * x[1] + TRUE["gravity"] * np.sin(x[0])
            return [x[1], (float(np.interp(t, time_s, torque)) - held) / TRUE["inertia"]]

        swung = solve_ivp(slope, (0.0, 4.0), [angle, 0.0], t_eval=time_s, rtol=1e-7, atol=1e-9, max_step=0.01)
        seen = swung.y[0] + 1e-3 * rng.standard_normal(len(time_s))
        made.append(replace(trial, time_s=time_s, inputs=torque[:, None], outputs=seen[:, None]))
    return wandering(replace(never_repeated(), trials=tuple(made)), slow)


def deviations_of(data: Dataset) -> list[tuple[DeviationKind, int | None]]:
    recalibrated = recalibrate(pendulum(), averaged(data, pendulum()), np.random.default_rng(0), silent)
    return [(deviation.kind, deviation.output) for deviation in recalibrated.problem.deviations]


def test_a_sensor_whose_noise_is_slow_does_not_let_trials_begin_elsewhere() -> None:
    assert deviations_of(released((0.0,) * 5, slow=0.01, rate_hz=500.0)) == []


@pytest.mark.parametrize("slow", [0.0, 0.004])
def test_trials_that_begin_where_a_hand_let_go_are_told(slow: float) -> None:
    assert ("initial state", 0) in deviations_of(released((0.05, -0.04, 0.08, 0.02, -0.06), slow))


@pytest.mark.parametrize("plant", ["swings", "integrates"])
@pytest.mark.parametrize(("grows", "message"), [(False, [("initial state", 0)]), (True, [])])
def test_what_trials_begin_with_is_told_only_if_their_first_samples_show_it(
    grows: bool, message: list[tuple[DeviationKind, int | None]], plant: str
) -> None:
    data = never_repeated()
    changes = [
        (np.cos(4.0 * trial.time_s) if plant == "swings" else np.ones_like(trial.time_s))[:, None]
        for trial in data.trials
    ]
    sizes = [0.01, -0.008, 0.012, -0.02, 0.004]
    left = [
        size * change * ((1.0 - np.exp(-trial.time_s / 0.3))[:, None] if grows else 1.0) + noise
        for size, change, trial, noise in zip(
            sizes, changes, data.trials, noise_like(data, 1e-3), strict=True
        )
    ]
    shown = {("initial state", 0): changes}
    alone = deviations_without_repeats(
        data, left, [np.zeros_like(values) for values in left], shown, short_s=0.05
    )
    kinds = [(deviation.kind, deviation.output) for several in alone for deviation in several]
    assert [kind for kind in kinds if kind[0] == "initial state"][:1] == message


def test_a_state_that_no_output_shows_at_once_is_not_asked_of_the_first_samples() -> None:
    data = never_repeated()
    changes = [np.sin(4.0 * trial.time_s)[:, None] for trial in data.trials]
    left = [size * change for size, change in zip([0.01, -0.008, 0.012, -0.02, 0.004], changes, strict=True)]
    shown = {("initial state", 1): changes}
    alone = deviations_without_repeats(
        data, left, [np.zeros_like(values) for values in left], shown, short_s=0.05
    )
    assert ("initial state", 1) in [(deviation.kind, deviation.output) for deviation in alone[0]]
