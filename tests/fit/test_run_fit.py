"""A fit from what a person names to numbers, picture and text."""

import json
from pathlib import Path

import numpy as np
import pytest
from swings import dataset_of, swing

from labrun.app.fit import fit
from labrun.errors import RequestError
from labrun.estimate import Estimate, rounded
from labrun.fit.result import FitSummary, FittedData
from labrun.store import import_recording

MODEL = """
name = "pendulum"
states = ["angle", "rate"]
[parameters]
inertia = { value = 1.2e-3, tolerance = 0.0, unit = "kg m^2" }
gravity_torque = { value = 0.05, tolerance = "free", unit = "N m" }
stiffness = { value = 0.0686, tolerance = 0.0, unit = "N m/rad" }
damping = { value = 2e-4, tolerance = "free", unit = "N m s/rad" }
[equations]
angle = "rate"
rate = "(-stiffness*angle - damping*rate - gravity_torque*sin(angle)) / inertia"
[outputs]
angle = "angle"
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recordings") / "pendulum"
    folder.mkdir()
    tables = ['experiment = "pendulum"', '[channels.angle]\nkind = "output"\nunit = "rad"']
    rng = np.random.default_rng(0)
    for number, release_rad in enumerate((0.3, 0.5, 0.7, 0.9, 1.1, 1.3, 1.5)):
        time_s, angle = swing(release_rad, duration_s=4.0, rate_hz=120.0)
        rows = np.column_stack([time_s, angle + 1e-3 * rng.normal(size=len(angle))])
        np.savetxt(
            folder / f"{number}.csv", rows, delimiter=",", header="time_s,angle", comments="", fmt="%.7f"
        )
        tables.append(f'[[trials]]\nfile = "{number}.csv"\ncondition = {{ release = {release_rad} }}')
    (folder / "recording.toml").write_text("\n".join(tables))
    (folder / "model.toml").write_text(MODEL)
    return folder


def snapshot(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_recording_is_fitted_into_the_results_and_left_untouched(recording: Path, tmp_path: Path) -> None:
    before = snapshot(recording)
    result = fit(recording, results=tmp_path / "results")
    assert snapshot(recording) == before
    assert result.figure is not None
    assert result.figure.read_bytes().startswith(b"\x89PNG")
    assert result.figure.parent.parent == tmp_path / "results" / "pendulum"
    loads = json.loads(json.dumps(result.to_json(), allow_nan=False))
    assert set(loads) == {"parameters", "rmse", "figure", "warnings"}
    assert set(loads["parameters"]) == {"gravity_torque", "damping"}
    gravity = loads["parameters"]["gravity_torque"]
    assert set(gravity) == {"value", "ci95", "unit"}
    assert gravity["ci95"][0] <= gravity["value"] <= gravity["ci95"][1]
    assert gravity["value"] == pytest.approx(0.06, rel=1e-3)
    assert loads["rmse"]["angle"] == pytest.approx(1e-3, rel=0.1)
    assert (
        json.loads((result.figure.parent / "pendulum.json").read_text())["parameters"] == loads["parameters"]
    )


def test_a_run_is_fitted_inside_its_own_folder(recording: Path, tmp_path: Path) -> None:
    run = import_recording(recording, tmp_path / "results")
    result = fit(run, model=recording / "model.toml", starts=1)
    assert result.figure == run / "fit" / "pendulum.png"
    packed = fit(run / "run.h5", model=recording / "model.toml", starts=1)
    assert packed.figure == result.figure
    assert packed.parameters == result.parameters


def test_the_hinge_method_gives_both_ways(recording: Path, tmp_path: Path) -> None:
    result = fit(recording, method="hinge", results=tmp_path, starts=1)
    assert {"stiffness", "damping", "stiffness_fourier", "damping_fourier"} <= set(
        result.to_json()["parameters"]
    )


def test_an_experiment_lends_its_way_of_fitting_to_a_recording(recording: Path, tmp_path: Path) -> None:
    result = fit("hinge", str(recording), results=tmp_path, workspace=tmp_path, starts=1)
    assert result.method == "hinge"
    # the body is the recording's own, not the one of the experiment
    assert result.fixed["inertia"] == 1.2e-3


def test_the_text_tells_everything_the_numbers_do(recording: Path, tmp_path: Path) -> None:
    text = fit(recording, results=tmp_path, starts=1).to_text()
    for expected in (
        "7 trials",
        "gravity_torque",
        "N m",
        "95 % interval",
        "angle:",
        "rad",
        "as given",
        "pendulum.png",
    ):
        assert expected in text


def test_sentences_are_wrapped_at_the_width_of_the_terminal() -> None:
    dataset = dataset_of([swing(0.5, duration_s=1.0, rate_hz=50.0)])
    data = FittedData.of(dataset)
    result = FitSummary(
        "hinge", "hinge", data, {}, {"angle": 0.01}, warnings=("long " * 40,), findings=("also " * 30,)
    )
    lines = result.to_text(60).split("\n")
    assert max(map(len, lines)) <= 60
    assert sum("long" in line for line in lines) > 2
    assert (
        sum(line.startswith("  ! ") for line in lines) == sum(line.startswith("  - ") for line in lines) == 1
    )


def test_a_recording_without_a_model_says_how_to_name_one(recording: Path, tmp_path: Path) -> None:
    bare = tmp_path / "bare"
    bare.mkdir()
    for name, content in snapshot(recording).items():
        if name != "model.toml":
            (bare / name).write_bytes(content)
    with pytest.raises(RequestError, match="--model"):
        fit(bare, results=tmp_path)


def test_a_target_that_is_not_there_and_a_method_unknown_are_refused(recording: Path, tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="cannot find the run"):
        fit(tmp_path / "nothing")
    with pytest.raises(RequestError, match="unknown fit plugin"):
        fit(recording, method="spline")


@pytest.mark.parametrize(
    ("estimate", "expected"),
    [
        (Estimate(0.213398, (0.213309, 0.213503), ""), ("0.213398", "0.213309", "0.213503")),
        (Estimate(138.2, (126.0, 151.0), ""), ("138", "126", "151")),
        (Estimate(1.89e-4, (1.72e-4, 1.98e-4), ""), ("1.89e-04", "1.72e-04", "1.98e-04")),
        (Estimate(2.0, (2.0, 2.0), ""), ("2", "2", "2")),
    ],
)
def test_numbers_are_printed_with_the_digits_their_interval_supports(
    estimate: Estimate, expected: tuple[str, str, str]
) -> None:
    assert rounded(estimate) == expected


@pytest.mark.parametrize(
    ("name", "message"),
    [("hinge-map", "did you mean 'hinge-maps'"), ("nonsense", "fits: .*fopdt.*models: .*hinge-pendulum")],
)
def test_a_name_that_is_neither_fit_nor_model_is_told_both(
    recording: Path, tmp_path: Path, name: str, message: str
) -> None:
    with pytest.raises(RequestError, match=rf"unknown fit or model '{name}'\n.*{message}"):
        fit(recording, model=name, results=tmp_path)
