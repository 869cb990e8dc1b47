"""A model on fresh data: its error at each horizon against closed forms, and the model it came from beside it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labrun.app.predict_fresh import predict_fresh as predict_file
from labrun.errors import RequestError
from labrun.fit import Dataset, FitTrial
from labrun.gap import predict_fresh
from labrun.models import corrected_model_text, load_model, parse_model
from labrun.report.gap_text import fresh_text
from labrun.store import SignalInfo

RATE, RATE_HZ, NOISE_V = 0.8, 100.0, 2e-3
DECAY = """
name = "decay"
states = ["level"]
[parameters]
rate = { value = 0.8, tolerance = 0.1, unit = "1/s" }
[equations]
level = "-rate*level"
[outputs]
level = { equation = "level", unit = "V" }
[initial]
level = "first"
"""
TRUE = parse_model(DECAY, "decay.toml")
WRONG = parse_model(DECAY.replace("value = 0.8", "value = 1.0"), "wrong.toml")


def decays(trials=6, noise=0.0, duration_s=3.0):
    """Exponentials by their formula."""
    rng = np.random.default_rng(1)
    time_s = np.arange(int(duration_s * RATE_HZ) + 1) / RATE_HZ
    none = np.empty((len(time_s), 0))
    made = []
    for index in range(trials):
        level = (1.0 + 0.2 * index) * np.exp(-RATE * time_s) + noise * rng.standard_normal(len(time_s))
        made.append(FitTrial(f"trial {index}", {"trial": float(index)}, 1, time_s, none, level[:, None]))
    return Dataset("decays", Path("decays"), "recording", (), (SignalInfo("level", "V"),), tuple(made))


def predicted(model, dataset, **given):
    return predict_fresh(model, dataset, np.random.default_rng(0), **given)


def test_the_error_of_a_wrong_rate_grows_with_the_horizon_as_its_formula_says():
    data = decays(trials=1)
    predictions = predicted(WRONG, data, horizons_s=(0.5, 1.5)).predictions
    for prediction in predictions[:2]:
        # the state is fitted to the 25 samples before, by a rate that is wrong there, too: their weighted mean
        lag = np.arange(25) / RATE_HZ - 24 / RATE_HZ
        weights = np.exp(-1.0 * lag)
        begin = weights @ np.exp(-RATE * lag) / (weights @ weights)
        relative = np.exp(-RATE * prediction.horizon_s) - begin * np.exp(-1.0 * prediction.horizon_s)
        starts = np.linspace(0, 276 - 50, 40).astype(int) + 24
        starts = starts[starts / RATE_HZ + prediction.horizon_s <= 3.0 + 1e-9]
        expected = abs(relative) * np.sqrt(np.mean(np.exp(-2 * RATE * starts / RATE_HZ)))
        assert prediction.error.value == pytest.approx(expected, rel=1e-3)
        assert prediction.predictions == len(starts)


def test_the_right_model_leaves_the_noise_and_its_interval_holds_it():
    result = predicted(TRUE, decays(noise=NOISE_V))
    whole = result.predictions[-1]
    assert whole.horizon_s is None
    assert whole.error.low < NOISE_V < whole.error.high
    assert all(prediction.error.value < 1.5 * NOISE_V for prediction in result.predictions)
    assert [prediction.horizon_s for prediction in result.predictions] == [0.1, 0.5, 2.0, None]


def test_the_model_it_came_from_is_set_beside_it_on_the_same_predictions():
    result = predicted(TRUE, decays(noise=NOISE_V), before=WRONG)
    far = result.predictions[2]
    assert far.ratio.value == pytest.approx(far.error.value / far.before.value)
    assert far.ratio.high < 1.0
    same = predicted(TRUE, decays(noise=NOISE_V), before=TRUE).predictions[2]
    assert same.ratio.low == pytest.approx(1.0) == same.ratio.high
    text = fresh_text(result)
    assert "2 s" in text
    assert "whole trial" in text
    assert "no significant change" not in text.splitlines()[-2]


def test_a_horizon_that_no_trial_reaches_is_refused_with_the_longest_there_is():
    with pytest.raises(RequestError, match="horizon of 5 s") as refused:
        predicted(TRUE, decays(), horizons_s=(0.1, 5.0))
    assert "2.76 s" in refused.value.hint
    assert "too short for a horizon of 2 s" in " ".join(predicted(TRUE, decays(duration_s=1.0)).notes)


def test_one_trial_says_that_its_intervals_know_nothing_of_how_trials_differ():
    assert any(
        "there is one trial" in note for note in predicted(TRUE, decays(trials=1, noise=NOISE_V)).notes
    )


@pytest.fixture
def corrected(tmp_path):
    (tmp_path / "decay.toml").write_text(DECAY)
    source = tmp_path / "decay.toml"
    text = corrected_model_text(
        load_model(source), source, {"rate": 0.9}, folder=tmp_path, data=str(tmp_path / "run")
    )
    (tmp_path / "corrected.toml").write_text(text)
    return tmp_path / "corrected.toml"


def test_a_corrected_model_knows_the_model_and_the_data_it_came_from(corrected, tmp_path):
    origin = load_model(corrected).origin
    assert load_model(origin.model).parameters[0].value == 0.8
    again = corrected_model_text(load_model(corrected), corrected, {"rate": 0.85}, folder=tmp_path)
    (tmp_path / "again.toml").write_text(again)
    assert load_model(load_model(tmp_path / "again.toml").origin.model).parameters[0].value == 0.9


def recorded(folder, *, trials=2, first=0):
    folder.mkdir()
    dataset = decays(trials=trials, noise=NOISE_V)
    dataset = replace(dataset, trials=dataset.trials[first:])
    lines = ['experiment = "decays"', '[channels.level]\nkind = "output"\nunit = "V"']
    for index, trial in enumerate(dataset.trials):
        table = np.column_stack([trial.time_s, trial.outputs])
        np.savetxt(folder / f"{index}.csv", table, delimiter=",", header="time_s,level", comments="")
        lines.append(f'[[trials]]\nfile = "{index}.csv"\ncondition = {{ trial = {index} }}')
    (folder / "recording.toml").write_text("\n".join(lines))
    return folder


def test_a_file_is_tested_beside_its_origin_but_not_on_the_data_it_was_fitted_to(corrected, tmp_path):
    file = predict_file(corrected, recorded(tmp_path / "fresh", trials=4, first=2), horizons_s=(0.5,))
    assert file.predictions[0].ratio.high > 1.0  # 0.9 is farther from the truth than 0.8
    with pytest.raises(RequestError, match="was fitted to"):
        predict_file(corrected, recorded(tmp_path / "run"))
    with pytest.raises(RequestError, match=r"copy holds 2 trials, which .* was corrected by"):
        predict_file(corrected, recorded(tmp_path / "copy"))
    (tmp_path / "decay.toml").unlink()
    alone = predict_file(corrected, tmp_path / "fresh", horizons_s=(0.5,))
    assert alone.predictions[0].before is None
    assert any("--beside" in note for note in alone.notes)
