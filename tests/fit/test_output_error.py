"""Output-error fits find what made the data, say how well, and say what the data cannot tell."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lsim

from labrun.errors import FitError
from labrun.fit.dataset import Dataset, FitTrial
from labrun.fit.output_error import fit_model
from labrun.fit.problem import Problem
from labrun.fit.uncertainty import correlation_length
from labrun.models import Model, parse_model
from labrun.store import SignalInfo

FloatArray = NDArray[np.float64]

OSCILLATOR = """
name = "oscillator"
states = ["position", "speed"]
inputs = ["force"]
[parameters]
mass      = { value = 1.5, tolerance = 0.0, unit = "kg" }
stiffness = { value = 30.0, tolerance = "free", unit = "N/m" }
damping   = { value = 0.3, tolerance = "free", unit = "N s/m" }
[equations]
position = "speed"
speed = "(force - stiffness*position - damping*speed) / mass"
[outputs]
position = "position"
[initial]
position = "free"
speed = "free"
"""
TRUE = {"mass": 1.5, "stiffness": 40.0, "damping": 0.5}
LAG = """
name = "lag"
states = ["x"]
inputs = ["u"]
[parameters]
gain = { value = 1.0, tolerance = "free", unit = "1" }
tau  = { value = 0.3, tolerance = "free", unit = "s" }
[equations]
x = "(gain*u - x)/tau"
[outputs]
x = "x"
[initial]
x = 0.0
"""


def oscillator(**tolerances: float | str) -> Model:
    model = parse_model(OSCILLATOR, "oscillator.toml")
    changed = [
        replace(parameter, tolerance=tolerances.get(parameter.name, parameter.tolerance))
        for parameter in model.parameters
    ]
    return replace(model, parameters=tuple(changed))


def driven(
    rng: np.random.Generator,
    trials: int,
    *,
    noise: float = 0.0,
    scatter: float = 0.0,
    drive: float = 1.0,
    duration_s: float = 5.0,
) -> Dataset:
    """Return trials of a driven oscillator by scipy: linear force between samples, parameters scattering by trial."""
    time_s = np.arange(0.0, duration_s, 0.02)
    made = []
    for index in range(trials):
        stiffness = TRUE["stiffness"] * (1 + scatter * rng.normal())
        damping = TRUE["damping"] * (1 + scatter * rng.normal())
        start = rng.normal(size=2) * [0.05, 0.2]
        force = drive * np.convolve(rng.normal(size=len(time_s)), np.ones(10) / 3, mode="same")

        # exact for a force that runs linearly between samples: lsim integrates by matrix exponential
        dynamics = [[0.0, 1.0], [-stiffness / TRUE["mass"], -damping / TRUE["mass"]]]
        system = (dynamics, [[0.0], [1.0 / TRUE["mass"]]], [[1.0, 0.0]], [[0.0]])
        _, clean, _ = lsim(system, force, time_s, X0=start)
        position = clean[:, None] + noise * rng.normal(size=(len(time_s), 1))
        made.append(FitTrial(f"trial {index}", {}, index + 1, time_s, force[:, None], position))
    inputs, outputs = (SignalInfo("force", "N"),), (SignalInfo("position", "m"),)
    return Dataset("driven", Path("driven"), "recording", inputs, outputs, tuple(made))


def test_clean_data_give_back_the_parameters_and_initial_states() -> None:
    dataset = driven(np.random.default_rng(0), 3)
    result = fit_model(oscillator(), dataset, rng=np.random.default_rng(0))
    assert result.parameters["stiffness"].value == pytest.approx(TRUE["stiffness"], rel=1e-4)
    assert result.parameters["damping"].value == pytest.approx(TRUE["damping"], rel=1e-4)
    assert result.fixed == {"mass": 1.5}
    assert result.rmse["position"] < 1e-5
    for trial, state in zip(dataset.trials, result.initial_states, strict=True):
        assert state[0] == pytest.approx(trial.outputs[0, 0], abs=1e-5)
    np.testing.assert_allclose(result.residuals[0], dataset.trials[0].outputs - result.simulated[0])


def test_the_error_is_in_the_unit_of_the_output_over_all_samples() -> None:
    dataset = driven(np.random.default_rng(1), 4, noise=0.003)
    result = fit_model(oscillator(), dataset, rng=np.random.default_rng(0), starts=1)
    assert result.rmse["position"] == pytest.approx(0.003, rel=0.05)
    stacked = np.concatenate([part.ravel() for part in result.residuals])
    assert result.rmse["position"] == pytest.approx(float(np.sqrt(np.mean(stacked**2))))


@pytest.mark.parametrize(
    ("scatter", "noise"), [pytest.param(0.0, 0.01, marks=pytest.mark.slow), (0.03, 0.003)]
)
def test_intervals_hold_the_truth_about_95_times_in_100(scatter: float, noise: float) -> None:
    rng = np.random.default_rng(7)
    model = oscillator()
    held = []
    for _ in range(40):
        dataset = driven(rng, 6, noise=noise, scatter=scatter, duration_s=2.0)
        result = fit_model(model, dataset, rng=rng, starts=1)
        for name in ("stiffness", "damping"):
            low, high = result.parameters[name].ci95
            held.append(low <= TRUE[name] <= high)
    # 80 intervals: 95 % +- 2.5 % by chance alone; scatter between trials must not make them too narrow
    assert 0.88 <= float(np.mean(held)) <= 1.0


def test_a_distant_stated_value_is_overcome_by_other_starts() -> None:
    dataset = driven(np.random.default_rng(2), 3, noise=0.001, drive=0.3)
    far = oscillator().with_values({"stiffness": 110.0, "damping": 1.5})
    result = fit_model(far, dataset, rng=np.random.default_rng(0), starts=6)
    assert result.parameters["stiffness"].value == pytest.approx(TRUE["stiffness"], rel=0.02)
    assert len(result.starts) == 6
    assert result.starts == tuple(sorted(result.starts, key=lambda start: start.misfit))


def test_the_same_seed_gives_the_same_numbers() -> None:
    dataset = driven(np.random.default_rng(3), 3, noise=0.01)
    first, second = (
        fit_model(oscillator(), dataset, rng=np.random.default_rng(5), starts=3).to_json() for _ in range(2)
    )
    assert first == second


def test_parameters_that_only_occur_as_a_ratio_are_named() -> None:
    dataset = driven(np.random.default_rng(4), 5, noise=0.001, drive=0.0)
    model = oscillator(mass="free")
    result = fit_model(model, dataset, rng=np.random.default_rng(0), starts=2)
    message = " ".join(result.warnings)
    assert "mass, stiffness and damping are only determined as ratios to one another" in message
    low, high = result.parameters["mass"].ci95
    assert high - low > result.parameters["mass"].value


def test_a_tolerance_settles_what_the_data_cannot_and_keeps_its_width() -> None:
    dataset = driven(np.random.default_rng(5), 8, noise=0.001, drive=0.0)
    result = fit_model(oscillator(mass=0.05), dataset, rng=np.random.default_rng(0), starts=1)
    mass = result.parameters["mass"]
    assert mass.value == pytest.approx(1.5, rel=0.01)
    assert 0.5 * (mass.ci95[1] - mass.ci95[0]) == pytest.approx(1.96 * 0.05 * 1.5, rel=0.35)
    assert any("mass rests on its stated value" in warning for warning in result.warnings)
    stiffness = result.parameters["stiffness"]
    assert 0.5 * (stiffness.ci95[1] - stiffness.ci95[0]) == pytest.approx(1.96 * 0.05 * 40, rel=0.35)


def test_what_moved_is_not_said_to_rest_on_its_stated_value() -> None:
    dataset = driven(np.random.default_rng(11), 4, noise=0.001, scatter=0.2)
    stated = oscillator(stiffness=0.1, damping=0.0).with_values({"stiffness": 34.0})
    result = fit_model(stated, dataset, rng=np.random.default_rng(0), starts=1)
    stiffness = result.parameters["stiffness"]
    away = abs(stiffness.value - 34.0) / 3.4
    assert 1.0 < away < 3.0
    assert stiffness.ci95[1] - stiffness.ci95[0] > 2 * 1.96 * 3.4
    messages = [warning for warning in result.warnings if warning.startswith("stiffness")]
    assert len(messages) == 1
    assert f"moved {away:.1f} standard deviations of its tolerance from the stated 34 N/m" in messages[0]
    assert "the model lacks something" in messages[0]


def test_strong_data_overrule_a_wrong_stated_value_and_say_so() -> None:
    dataset = driven(np.random.default_rng(6), 6, noise=0.001)
    wrong = oscillator(mass=0.02).with_values({"mass": 1.2})
    result = fit_model(wrong, dataset, rng=np.random.default_rng(0), starts=1)
    assert result.parameters["mass"].value == pytest.approx(1.5, rel=0.03)
    assert any("standard deviations of its tolerance away" in warning for warning in result.warnings)


def test_a_parameter_without_effect_is_said_to_be_undetermined() -> None:
    text = OSCILLATOR.replace(
        "[equations]", 'idle = { value = 2.0, tolerance = "free", unit = "N" }\n[equations]'
    ).replace("force - stiffness", "force + 0*idle - stiffness")
    dataset = driven(np.random.default_rng(8), 5, noise=0.001)
    result = fit_model(parse_model(text, "m.toml"), dataset, rng=np.random.default_rng(0), starts=1)
    assert any("do not determine idle" in warning for warning in result.warnings)
    low, high = result.parameters["idle"].ci95
    assert low < 0.0 < high
    assert result.parameters["stiffness"].value == pytest.approx(40.0, rel=0.01)


def test_a_force_that_is_not_there_is_not_distinguishable_from_zero() -> None:
    text = OSCILLATOR.replace(
        "[equations]", 'cubic = { value = 1.0, tolerance = "free", unit = "N/m^3" }\n[equations]'
    ).replace("- damping*speed", "- damping*speed - cubic*position^3")
    dataset = driven(np.random.default_rng(9), 6, noise=0.003)
    result = fit_model(parse_model(text, "m.toml"), dataset, rng=np.random.default_rng(0), starts=1)
    assert any(warning.startswith("cubic is not distinguishable from zero") for warning in result.warnings)


def test_a_bound_that_holds_a_parameter_back_is_said() -> None:
    model = oscillator()
    bounded = replace(
        model,
        parameters=tuple(
            replace(parameter, upper=35.0) if parameter.name == "stiffness" else parameter
            for parameter in model.parameters
        ),
    )
    result = fit_model(
        bounded, driven(np.random.default_rng(10), 5, noise=0.001), rng=np.random.default_rng(0), starts=1
    )
    assert any("stiffness ended at its upper bound of 35" in warning for warning in result.warnings)
    assert result.parameters["stiffness"].ci95[1] <= 35.0


def test_few_trials_are_said_to_be_few() -> None:
    rng = np.random.default_rng(11)
    three = fit_model(oscillator(), driven(rng, 3, noise=0.01), rng=rng, starts=1)
    assert any("3 trials only" in warning for warning in three.warnings)
    model = fit_model(oscillator(), driven(rng, 1, noise=0.01), rng=rng, starts=1)
    assert any("one trial only" in warning for warning in model.warnings)
    low, high = model.parameters["stiffness"].ci95
    assert low < TRUE["stiffness"] < high


def test_a_lag_is_found_from_its_closed_form_step_response() -> None:
    time_s = np.arange(0, 2, 0.01)
    made = []
    for index, height in enumerate((0.5, 1.0, 2.0, 3.0, 4.0)):
        response = 1.7 * height * (1 - np.exp(-time_s / 0.21))
        made.append(
            FitTrial(f"{height}", {}, index + 1, time_s, np.full((len(time_s), 1), height), response[:, None])
        )
    dataset = Dataset(
        "steps",
        Path("steps"),
        "recording",
        (SignalInfo("u", "1", "hold"),),
        (SignalInfo("x", "1"),),
        tuple(made),
    )
    result = fit_model(parse_model(LAG, "lag.toml"), dataset, rng=np.random.default_rng(0))
    assert result.parameters["gain"].value == pytest.approx(1.7, rel=1e-5)
    assert result.parameters["tau"].value == pytest.approx(0.21, rel=1e-4)


def test_a_model_that_blows_up_is_refused_without_numpy_warnings(recwarn: pytest.WarningsRecorder) -> None:
    text = LAG.replace("(gain*u - x)/tau", "gain*exp(exp(x^2 + u^2 + 9)) + tau")
    dataset = driven(np.random.default_rng(12), 2)
    dataset = replace(dataset, inputs=(SignalInfo("u", "1"),), outputs=(SignalInfo("x", "1"),))
    with pytest.raises(FitError, match="leave the finite numbers"):
        fit_model(parse_model(text, "m.toml"), dataset, rng=np.random.default_rng(0), starts=2)
    assert not [warning for warning in recwarn if issubclass(warning.category, RuntimeWarning)]


TWO_SIGNS = """
name = "two signs"
states = ["x"]
inputs = ["u"]
[parameters]
rate = {{ value = {rate}, tolerance = "free", unit = "1/s"{bounds} }}
[equations]
x = "rate*(u - x)"
[outputs]
x = "x"
[initial]
x = 1.0
"""


def relaxing(rate: float) -> Dataset:
    """Return trials of x' = -rate x from 1."""
    time_s = np.arange(0, 2, 0.02)
    made = [
        FitTrial(
            f"{index}", {}, index + 1, time_s, np.zeros((len(time_s), 1)), np.exp(-rate * time_s)[:, None]
        )
        for index in range(5)
    ]
    inputs, outputs = (SignalInfo("u", "1"),), (SignalInfo("x", "1"),)
    return Dataset("relaxing", Path("relaxing"), "recording", inputs, outputs, tuple(made))


def test_a_sign_that_the_data_demand_is_found_and_told() -> None:
    model = parse_model(TWO_SIGNS.format(rate=0.8, bounds=""), "m.toml")
    result = fit_model(model, relaxing(-0.5), rng=np.random.default_rng(0))
    assert result.parameters["rate"].value == pytest.approx(-0.5, rel=1e-4)
    assert any(warning.startswith("rate came out negative") for warning in result.warnings)


def test_a_bound_in_the_model_holds_a_sign() -> None:
    model = parse_model(TWO_SIGNS.format(rate=0.8, bounds=", lower = 0.0"), "m.toml")
    result = fit_model(model, relaxing(-0.5), rng=np.random.default_rng(0))
    assert result.parameters["rate"].value == 0.0
    assert any("lower bound" in warning for warning in result.warnings)


def test_starts_do_not_wander_through_zero_into_what_fits_as_well() -> None:
    # only the square of the gain acts: the negative one fits exactly as well, and nobody stated it
    text = LAG.replace("gain*u", "gain^2*u")
    dataset = driven(np.random.default_rng(20), 3, drive=1.0)
    time_s = dataset.trials[0].time_s
    trials = []
    for trial in dataset.trials:
        _, response, _ = lsim(([[-1 / 0.2]], [[1.3**2 / 0.2]], [[1.0]], [[0.0]]), trial.inputs[:, 0], time_s)
        trials.append(replace(trial, outputs=response[:, None]))
    dataset = replace(
        dataset, inputs=(SignalInfo("u", "1"),), outputs=(SignalInfo("x", "1"),), trials=tuple(trials)
    )
    result = fit_model(parse_model(text, "m.toml"), dataset, rng=np.random.default_rng(0), starts=6)
    assert all(start.parameters["gain"] >= 0 for start in result.starts)
    assert result.parameters["gain"].value == pytest.approx(1.3, rel=1e-4)
    assert not any("came out" in warning for warning in result.warnings)


def test_a_region_that_blows_up_does_not_keep_the_fit_from_the_rest() -> None:
    dataset = driven(np.random.default_rng(13), 3, noise=0.001)
    unstable = oscillator().with_values({"damping": -60.0})
    result = fit_model(unstable, dataset, rng=np.random.default_rng(1), starts=2)
    assert np.isfinite(result.rmse["position"])


def test_nothing_to_fit_is_an_error() -> None:
    text = OSCILLATOR.replace('"free"', "0.0", 2).replace(
        'position = "free"\nspeed = "free"', "position = 0.0\nspeed = 0.0"
    )
    with pytest.raises(FitError, match="nothing to fit"):
        fit_model(
            parse_model(text, "m.toml"), driven(np.random.default_rng(0), 2), rng=np.random.default_rng(0)
        )


def test_an_output_of_zeros_is_an_error() -> None:
    dataset = driven(np.random.default_rng(0), 2)
    silent = replace(
        dataset, trials=tuple(replace(trial, outputs=0 * trial.outputs) for trial in dataset.trials)
    )
    with pytest.raises(FitError, match="'position' is zero throughout"):
        fit_model(oscillator(), silent, rng=np.random.default_rng(0))


def test_derivatives_of_one_trial_do_not_touch_another() -> None:
    dataset = driven(np.random.default_rng(14), 2)
    problem = Problem.of(oscillator(), dataset)
    z = problem.begin()
    blocks = problem.jacobian(z)
    changed = z.copy()
    changed[problem.size] += 1e-3
    first, second = problem.residuals(changed)
    np.testing.assert_array_equal(second, blocks.residual[1])
    np.testing.assert_allclose((first - blocks.residual[0]) / 1e-3, blocks.own[0][:, 0], atol=1e-6)


def test_the_correlation_length_of_an_autoregression_is_its_closed_form() -> None:
    rng = np.random.default_rng(0)
    parts = []
    for _ in range(8):
        values = np.zeros(20_000)
        kicks = rng.normal(size=len(values))
        for index in range(1, len(values)):
            values[index] = 0.8 * values[index - 1] + kicks[index]
        parts.append(values)
    assert correlation_length(parts) == pytest.approx((1 + 0.8) / (1 - 0.8), rel=0.15)
    assert correlation_length([rng.normal(size=20_000)]) == pytest.approx(1.0, abs=0.2)
    assert correlation_length([np.zeros(10)]) == 1.0
