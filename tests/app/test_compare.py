"""`labrun compare`: theory or another run beside data."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import labrun
from labrun.cli.app import app
from labrun.errors import RequestError
from labrun.experiment import shipped_experiments
from labrun.report.comparison import comparison_figure

DRAG = {0.1: (0.05, 0.052), 0.2: (0.2,), 0.4: (0.8,)}
THEORY = """
name = "square-law"
conditions = ["speed"]
[parameters]
drag = { value = 5.0, tolerance = "free", unit = "N s^2/m^2" }
[outputs.drag]
equation = "drag*speed^2"
unit = "N"
"""


def recording(folder, table, *, channel="drag", unit="N", name="towed", condition="speed", water=None):
    folder.mkdir()
    toml = [f'experiment = "{name}"', f"[channels.{channel}]", 'kind = "output"', f'unit = "{unit}"']
    for value, repeats in table.items():
        for number, measured in enumerate(repeats):
            (folder / f"{value}-{number}.csv").write_text(f"time_s,{channel}\n0,{measured}\n")
            more = f', water = "{water}"' if water else ""
            toml += [
                "[[trials]]",
                f'file = "{value}-{number}.csv"',
                f"condition = {{ {condition} = {value}{more} }}",
            ]
    (folder / "recording.toml").write_text("\n".join(toml) + "\n")
    return folder


@pytest.fixture
def towed(tmp_path):
    folder = recording(tmp_path / "towed", DRAG)
    (folder / "model.toml").write_text(THEORY)
    return folder


def command(*arguments, results):
    return CliRunner().invoke(app, ["compare", *map(str, arguments), "--results", str(results)])


def test_the_model_beside_a_recording_is_held_against_it_as_stated(towed, tmp_path):
    result = labrun.compare(towed, results=tmp_path / "results")
    worst = result.comparison.worst
    assert (worst.condition, worst.trials) == ({"speed": 0.1}, 2)
    assert worst.relative == pytest.approx(np.sqrt(0.5 * 0.002**2) / np.sqrt(0.5 * (0.05**2 + 0.052**2)))
    assert result.comparison.conditions == 3
    assert result.figure.is_file()
    assert json.loads(result.numbers.read_text())["worst"]["condition"] == {"speed": 0.1}
    assert not list(towed.glob("compare*"))


@pytest.mark.parametrize(("tolerance", "code"), [("5%", 0), ("0.05", 0), ("1 %", 1)])
def test_the_exit_code_is_1_beyond_the_tolerance(towed, tmp_path, tolerance, code):
    done = command(towed, "--tolerance", tolerance, results=tmp_path / "results")
    assert done.exit_code == code
    assert ("beyond the tolerance of 1 %" if code else "within the tolerance of 5 %") in " ".join(
        done.stdout.split()
    )
    assert done.stdout.index("speed = 0.1") < done.stdout.index("speed = 0.4")


def test_what_is_the_same_in_all_conditions_is_said_once(tmp_path):
    folder = recording(tmp_path / "still", DRAG, name="still", water="still")
    (folder / "model.toml").write_text(THEORY)
    text = labrun.compare(folder, results=tmp_path / "results").to_text(100)
    assert text.count("water = still") == 1
    assert "all at water = still" in text
    assert "worst: drag at speed = 0.1 is off" in text


def test_as_json_everything_is_a_number_and_the_code_is_the_same(towed, tmp_path):
    done = command(towed, "--tolerance", "1%", "--json", results=tmp_path / "results")
    loads = json.loads(done.stdout)
    assert done.exit_code == 1
    assert loads["within"] is False
    assert loads["points"][0]["condition"] == {"speed": 0.1}
    assert set(loads["channels"]) == {"drag"}


@pytest.mark.parametrize("tolerance", ["much", "-5%", "0", "15", "nan"])
def test_what_is_no_tolerance_is_refused_before_anything_is_computed(towed, tmp_path, tolerance):
    done = command(towed, "--tolerance", tolerance, results=tmp_path / "results")
    assert done.exit_code == 2
    assert "%" in done.stderr
    assert not (tmp_path / "results").exists()


def test_two_recordings_are_compared_where_their_conditions_agree(towed, tmp_path):
    other = recording(tmp_path / "again", {0.2: (0.25,), 0.4: (0.8,), 0.8: (3.0,)}, name="again", water="tap")
    comparison = labrun.compare(towed, other, results=tmp_path / "results").comparison
    assert [point.relative for point in comparison.points] == pytest.approx([0.25, 0.0])
    assert "one condition is in towed only" in comparison.notes
    assert "one condition is in again only" in comparison.notes


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"channel": "lift"}, "neither a number nor a signal of the same name"),
        ({"unit": "N m"}, "is in N, drag of other in N m"),
        ({"condition": "pace"}, "conditions of towed differ in speed"),
        ({"table": {0.3: (1.0,)}}, "no condition in common"),
    ],
)
def test_what_cannot_be_compared_is_said(towed, tmp_path, changed, message):
    other = recording(tmp_path / "other", **{"table": DRAG, "name": "other", **changed})
    with pytest.raises(RequestError, match=message):
        labrun.compare(towed, other, results=tmp_path / "results")


def test_a_model_and_a_run_at_once_are_refused(towed, tmp_path):
    with pytest.raises(RequestError, match="cannot both"):
        labrun.compare(towed, towed, model=towed / "model.toml", results=tmp_path)


@pytest.fixture(scope="module")
def swings(tmp_path_factory):
    results = tmp_path_factory.mktemp("results")
    small = ["run.conditions=[{release=30}]", "trial.repeats=2", "trial.duration_s=2.5"]
    return [
        labrun.run("hinge", dry_run=True, seed=seed, overrides=small, results=results).run for seed in (1, 2)
    ]


def test_a_run_is_held_against_the_model_that_its_experiment_names(swings):
    result = labrun.compare(swings[0])
    assert result.numbers.parent == swings[0] / "compare"
    assert result.comparison.worst.channel == "angle"
    assert 0 < result.comparison.worst.relative < 1
    assert "read from the first samples" in result.to_text(100).replace("\n    ", " ")


def test_two_runs_of_an_experiment_are_compared_by_their_objectives_and_told_apart_by_their_start(swings):
    comparison = labrun.compare(*swings).comparison
    assert comparison.worst.channel == "swing"
    assert comparison.data == f"hinge {swings[0].name}"
    assert comparison.prediction == f"hinge {swings[1].name}"


def test_an_experiment_named_twice_is_its_latest_run_beside_the_one_before(swings):
    first, second = swings
    comparison = labrun.compare("hinge", "hinge", results=first.parent.parent).comparison
    assert (comparison.data, comparison.prediction) == (f"hinge {second.name}", f"hinge {first.name}")


def test_a_run_beside_itself_is_refused(swings, towed):
    for data in (swings[0], towed):
        with pytest.raises(RequestError, match="are the same data"):
            labrun.compare(data, data)


def test_a_formula_named_like_an_objective_is_held_against_it(swings, tmp_path):
    formula = tmp_path / "let-go.toml"
    formula.write_text(
        'name = "let-go"\nconditions = ["release"]\n[outputs.swing]\n'
        'equation = "release*3.14159265/180"\nunit = "rad"\n'
    )
    point = labrun.compare(swings[0], model=formula).comparison.worst
    assert point.trials == 2
    assert point.predicted == pytest.approx(np.pi / 6)
    assert point.relative < 0.05


def test_a_run_and_a_recording_of_the_same_signal_are_compared_over_time(swings, tmp_path):
    folder = tmp_path / "seen"
    folder.mkdir()
    signal = labrun.open(swings[0]).signals("cameras", trial=0)["angle"]
    rows = np.column_stack([signal["time_s"], signal.values])
    np.savetxt(folder / "0.csv", rows, delimiter=",", header="time_s,angle", comments="")
    (folder / "recording.toml").write_text(
        'experiment = "seen"\n[channels.angle]\nkind = "output"\nunit = "rad"\n[[trials]]\nfile = "0.csv"\n'
        "condition = { release = 30 }\n"
    )
    comparison = labrun.compare(folder, swings[0], results=tmp_path / "results").comparison
    assert comparison.worst.at_s is not None
    assert comparison.worst.relative < 0.2  # the repeats differ, and their mean is held against the first


def test_a_table_of_numbers_does_not_drive_a_model_and_says_what_it_can_be_held_beside():
    with pytest.raises(
        RequestError, match=r"table-5-2 is a table of numbers, and caudal-thrust .* from tail"
    ) as raises:
        labrun.compare("table-5-2", model="caudal-thrust")
    assert "labrun compare RUN table-5-2" in raises.value.hint


def test_a_models_name_means_the_workspaces_own_copy(tmp_path):
    shelf = tmp_path / "experiments" / "models"
    shelf.mkdir(parents=True)
    shipped = shipped_experiments() / "models" / "six-bar.toml"
    keys = {"model": "six-bar", "results": tmp_path / "results", "workspace": tmp_path}
    before = labrun.compare("table-3-3", **keys).comparison
    (shelf / "six-bar.xml").write_text(shipped.with_suffix(".xml").read_text())
    (shelf / shipped.name).write_text(shipped.read_text().replace("value = 3.58", "value = 7.16"))
    after = labrun.compare("table-3-3", **keys)
    assert after.comparison.worst.relative != before.worst.relative
    assert json.loads(after.numbers.read_text())["against"] == str(shelf / shipped.name)


def test_channels_with_a_point_each_stand_side_by_side_in_one_panel(tmp_path):
    comparison = labrun.compare("table-3-3", model="six-bar", results=tmp_path).comparison
    (panel,) = [
        panel for row in comparison_figure(comparison).rows for stack in row for panel in stack.panels
    ]
    assert panel.ticks == tuple(comparison.units())
    measured, predicted = panel.curves
    assert measured.y == pytest.approx([pair.measured[0] for pair in comparison.pairs])
    assert predicted.y == pytest.approx([pair.predicted[0] for pair in comparison.pairs])


def test_an_axis_of_conditions_has_the_unit_that_their_name_ends_with(tmp_path):
    comparison = labrun.compare("table-7-2", "table-7-2-simulated", results=tmp_path).comparison
    panels = [panel for row in comparison_figure(comparison).rows for stack in row for panel in stack.panels]
    assert {panel.x_label for panel in panels} == {"frequency (Hz)"}


def test_a_misspelt_recording_is_told_its_name():
    with pytest.raises(RequestError) as raises:
        labrun.compare("tabel-5-2")
    assert raises.value.hint == "did you mean the recording 'table-5-2'?"


PULLED = """
name = "slack-spring"
states = ["slack"]
[inputs]
pulled = { unit = "m" }
[parameters]
stiffness = { value = 100.0, tolerance = 0.1, unit = "N/m" }
[equations]
slack = "0"
[outputs.force]
equation = "stiffness*max(pulled - slack, 0)"
unit = "N"
[initial]
slack = "free"
"""


def test_slack_that_first_samples_do_not_tell_is_read_from_the_whole_trial(tmp_path):
    folder, slack_m = tmp_path / "strips", (0.02, 0.05)
    folder.mkdir()
    toml = ['experiment = "strips"', "[channels.pulled]", 'kind = "input"', 'unit = "m"']
    toml += ["[channels.force]", 'kind = "output"', 'unit = "N"']
    pulled = np.linspace(0.0, 0.2, 81)
    for number, slack in enumerate(slack_m):
        force = 105.0 * np.maximum(pulled - slack, 0.0)  # 5 % stiffer than stated
        rows = [
            f"{0.1 * index},{value},{two}"
            for index, (value, two) in enumerate(zip(pulled, force, strict=True))
        ]
        (folder / f"{number}.csv").write_text("\n".join(["time_s,pulled,force", *rows]) + "\n")
        toml += ["[[trials]]", f'file = "{number}.csv"', f"condition = {{ specimen = {number} }}"]
    (folder / "recording.toml").write_text("\n".join(toml) + "\n")
    (folder / "model.toml").write_text(PULLED)
    comparison = labrun.compare(folder, results=tmp_path / "results").comparison
    assert 0.005 < comparison.worst.relative < 0.05
    assert "slack, which does not change in a trial, was read from the whole of it" in comparison.notes[0]
