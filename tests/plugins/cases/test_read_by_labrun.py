"""What the generator writes is what labrun reads; and without anything hidden labrun's simulation is its truth."""

import json
from pathlib import Path

import numpy as np
import pytest
from generating_cases import Done
from labrun_plugins.cases.bench import Bench
from labrun_plugins.cases.forms import FORMS
from labrun_plugins.cases.plants import PLANTS
from labrun_plugins.cases.robots.hidden import EFFECTS
from labrun_plugins.cases.simulate import adaptive
from labrun_plugins.cases.writing import write_model, write_recording

from labrun.effects import effects
from labrun.models import parse_model, simulate
from labrun.store import read_recording

QUIETEST_SHARE = 1.4e-4
"""The least noise of any case, as a share of the signal."""


def test_labrun_reads_every_recording_and_every_model(made: tuple[Path, Done]) -> None:
    folder, _ = made
    for part in ("cases", "fresh"):
        for path in sorted((folder / part).iterdir()):
            recording = read_recording(path)
            model = parse_model((path / "model.toml").read_text(), str(path / "model.toml"))
            answer = json.loads((folder / "sealed" / f"{path.name}.json").read_text())
            assert [signal.name for signal in recording.inputs] == [signal.name for signal in model.inputs]
            assert [(output.name, output.unit) for output in recording.outputs] == [
                (output.name, output.unit) for output in model.outputs
            ]
            conditions = answer["conditions"] if part == "cases" else 3
            repeats = answer["repeats"] if part == "cases" else 3
            assert len(recording.trials) == conditions * repeats
            assert {parameter.name: parameter.value for parameter in model.parameters} == answer[
                "stated_parameters"
            ]
            assert model.notes == ()


def test_fresh_conditions_are_not_among_the_recorded_ones(made: tuple[Path, Done]) -> None:
    folder, _ = made
    for path in sorted((folder / "cases").iterdir()):
        recorded = [dict(trial.condition) for trial in read_recording(path).trials]
        for trial in read_recording(folder / "fresh" / path.name).trials:
            assert dict(trial.condition) not in recorded


def test_causes_are_named_as_labrun_names_them() -> None:
    library = {(effect.kind, effect.id) for effect in effects()}
    assert set(FORMS) <= library
    # The cases' plants have springs, one clock and no whole turns: what is looked for without them is not hidden there.
    not_hidden = {"gravity-tilt", "payload", "added-stiffness", "early-clock", "late-clock", "imbalance"}
    # Play is hidden behind a drive, at the link; viscous damping in joints, not on bodies.
    not_hidden |= {"gear-play", "viscous-damping"}
    assert {name for _, name in library - set(FORMS)} <= {*EFFECTS, *not_hidden}


def test_a_hidden_site_is_a_place_of_the_model(made: tuple[Path, Done]) -> None:
    folder, _ = made
    for path in sorted((folder / "sealed").glob("case-*.json")):
        model = parse_model((folder / "cases" / path.stem / "model.toml").read_text(), "model.toml")
        for hidden in json.loads(path.read_text())["hidden"]:
            model.site_named(hidden["site"], hidden["site_kind"])


@pytest.mark.parametrize("kind", PLANTS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_controls_are_controls_labrun_simulates_the_same_from_the_true_parameters(
    kind: type, seed: int, tmp_path: Path
) -> None:
    rng = np.random.default_rng(seed)
    plant = kind(rng)
    programme = plant.programme(rng, 2)
    truth = adaptive(Bench(plant, programme, plant.truth))
    trials = [
        (condition, 1, programme.inputs[:, :, index], truth[:, :, index])
        for index, condition in enumerate(programme.conditions)
    ]
    write_recording(plant, plant.name, tmp_path, programme.time_s, trials)
    write_model(plant, plant.truth, tmp_path / "model.toml")
    recording = read_recording(tmp_path)
    model = parse_model((tmp_path / "model.toml").read_text(), "model.toml")
    model = model.with_between({signal.name: signal.between for signal in recording.inputs})
    noise = QUIETEST_SHARE * np.std(truth, axis=(1, 2))
    for index, trial in enumerate(recording.trials):
        start = plant.start(programme.conditions)[:, index]
        ours = simulate(
            model, trial.time_s, trial.inputs, condition=trial.condition, initial_state=start, substeps=16
        )
        difference = np.sqrt(np.mean((ours.outputs - truth[:, :, index].T) ** 2, axis=0))
        # what is left is rounding in the files, to eight digits, and both integrators' errors
        assert np.all(difference < 2e-3 * noise)
