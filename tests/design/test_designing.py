import csv
import html
import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import labrun
from labrun.app.design import design
from labrun.app.report import read_findings, write_report
from labrun.design.constraints import Margin
from labrun.design.handing_on import written_experiment
from labrun.errors import PlanError, RequestError, SpecError
from labrun.experiment import load_experiment, shipped_experiments
from labrun.models import load_model
from labrun.report import print_findings
from labrun.runner import SilentProgress
from labrun.search import read_generations
from labrun.store import open_run


def design_of(path: Path, **keys):
    return design(
        path, dry_run=True, seed=keys.pop("seed", 3), workers=keys.pop("workers", 1), draw=False, **keys
    )


class Notes(SilentProgress):
    """Keep what is told."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        """Keep it."""
        self.notes.append(text)


def generations(result) -> list[dict]:
    return read_generations(result.run / "search")


def test_a_design_finds_the_length_that_the_constraints_leave_best(paddle):
    result = design_of(paddle())
    # 30 L s (0.3 - L) with L s <= 0.08 (s in rad): the load is the bound, and the smaller L at it the better, until the
    # stroke is at its end of 60 deg, where L = 0.08 / 1.047
    best = result.best
    assert best.parameters["stroke"] == pytest.approx(60, abs=1.5)
    assert best.parameters["length"] == pytest.approx(76.4, abs=2)
    assert any(line.startswith("active") and "peak_load < 0.08" in line for line in result.more)
    assert any(line.startswith("active") and "stroke at its upper bound" in line for line in result.more)


def test_the_same_seed_gives_the_same_design_whatever_the_number_of_workers(paddle):
    path = paddle(("iterations = 25", "iterations = 3"))
    alone, parallel = design_of(path), design_of(path, workers=2)
    assert generations(alone) == generations(parallel)
    assert alone.best == parallel.best


def test_a_stopped_design_goes_on_to_the_same_result_without_simulating_anything_again(paddle, monkeypatch):
    path = paddle(("iterations = 25", "iterations = 6"))
    whole = design_of(path)
    stopped = design_of(path, limit=30)
    assert not stopped.finished
    assert len(generations(stopped)) == 3  # 12 candidates each; the next would begin with 36 simulated
    from labrun.design.simulator import Simulator

    monkeypatch.setattr("labrun.app.design.cores", lambda: 1)
    counted = []
    call = Simulator.__call__
    monkeypatch.setattr(
        Simulator, "__call__", lambda self, some, **keys: counted.extend(some) or call(self, some, **keys)
    )
    resumed = labrun.resume(stopped.run, draw=False)
    assert resumed.best == whole.best
    assert generations(resumed) == generations(whole)
    in_search = len({json.dumps(c["condition"]) for g in generations(whole)[3:] for c in g["candidates"]})
    copies, nominal = 2 * 5 + 5, 1
    assert len(counted) == in_search + copies + nominal


def test_candidates_are_ranked_by_how_many_constraints_they_break_and_then_by_how_far(paddle):
    path = paddle(("iterations = 25", "iterations = 8"), ("peak_load < 0.08", "peak_load < 0.03"))
    infeasible, feasible = [], []
    for state in generations(design_of(path)):
        for candidate in state["candidates"]:
            (feasible if candidate["feasible"] else infeasible).append((state["generation"], candidate))
    assert infeasible
    assert feasible
    for number, condition in infeasible:
        same = [two for at, two in feasible if at == number]
        assert all(condition["cost"] > two["cost"] for two in same)
        for at, two in infeasible:
            if at != number:
                continue
            if (
                len(condition["violations"]) == len(two["violations"])
                and condition["violated_by"] < two["violated_by"]
            ):
                assert condition["cost"] < two["cost"]


def test_the_best_is_what_copies_within_the_tolerance_do(paddle):
    path = paddle(("tolerance = 0.5", "tolerance = 20"))
    result = design_of(path)
    with open_run(result.run) as run:
        confirming = [outcome for outcome in run.outcomes if outcome.role == "confirm"]
        assert {tuple(outcome.condition.items()) for outcome in confirming} == {
            tuple(result.best.parameters.items())
        }
        values = np.array([outcome.objectives["distance"] for outcome in confirming])
    assert len(values) == 5
    assert values.std() > 0
    assert result.best.value == pytest.approx(values.mean())
    journal = [json.loads(line) for line in (result.run / "journal.jsonl").read_text().splitlines()]
    built = [line["built"]["length"] for line in journal if line["event"] == "copy"]
    assert np.ptp(built) > 5
    assert any(re.match(r"copies +\d of 5 within the tolerances break", line) for line in result.more)


@pytest.mark.rendered
def test_a_design_is_handed_on_as_model_sheet_and_drawing(paddle):
    result = design_of(paddle(("iterations = 25", "iterations = 3")))
    length = result.best.parameters["length"]
    model = load_model(result.run / "model.toml")
    assert model.values[0] == pytest.approx(length / 1000)
    with (result.run / "dimensions.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == ["length", "stroke", "f"]
    assert float(rows[0]["value"]) == pytest.approx(length, rel=1e-5)
    assert (rows[0]["tolerance"], rows[0]["unit"]) == ("0.5", "mm")
    svg = (result.run / "drawing.svg").read_text()
    # to scale: the rectangle of the paddle is its length long on paper, 72 points to 25.4 mm
    width_pt = float(re.search(r'width="([\d.]+)pt"', svg)[1])
    assert width_pt > length / 25.4 * 72
    widths = []
    for outline in re.findall(r'd="M ([^"]*?)z', svg):
        along = [float(x) for x in re.findall(r"(-?[\d.]+) -?[\d.]+", outline)]
        widths.append(max(along) - min(along))
    assert any(width == pytest.approx(length / 25.4 * 72, rel=1e-3) for width in widths)


def test_a_design_is_refused_on_a_bench(paddle):
    with pytest.raises(RequestError, match="nothing of it runs on a bench") as raises:
        design(paddle(), seed=1)
    assert "--dry-run" in raises.value.hint
    assert not Path("results").exists()


def test_bounds_that_exclude_each_other_are_told_before_anything_is_written(paddle):
    path = paddle(("length + 0.5 * stroke < 220", "length + 0.5 * stroke < 15"))
    with pytest.raises(PlanError, match="nothing of the design space can be built") as raises:
        design_of(path)
    assert "100 % break: length + 0.5 * stroke < 15" in str(raises.value)
    assert not Path("results").exists()


def test_a_design_that_cannot_be_simulated_is_told_with_its_reason(paddle):
    path = paddle(("length / 1000", "-length / 1000"))
    with pytest.raises(
        PlanError, match=r"the design cannot be simulated: (.|\n)*x length = .* is outside 0.01"
    ) as raises:
        design_of(path)
    assert str(raises.value).count("is outside") == 3  # each is another length
    assert "5 others like these" in str(raises.value)


def test_a_candidate_that_cannot_be_simulated_costs_a_violation_and_ends_nothing(paddle):
    # below 70 mm the parameter is out of the model's bounds
    path = paddle(("length / 1000", "(length - 60) / 1000"), ("iterations = 25", "iterations = 3"))
    result = design_of(path)
    texts = [text for g in generations(result) for c in g["candidates"] for text in c["violations"]]
    assert any(text.startswith("cannot be simulated: length =") for text in texts)
    assert result.finished


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("parameters.length", "parameters.lenght", "design.parameters.lenght: model paddle has no such name"),
        ("peak_load", "peak_laod", 'peak_laod is of no channel'),
        ("joints.angle", "joints.angel", "the model's input angle is not a joint of the gait"),
    ],
)  # fmt: skip
def test_names_that_the_model_does_not_have_are_told_with_the_nearest(paddle, old, new, message):
    with pytest.raises(SpecError, match=message):
        design_of(paddle((old, new)))


def test_a_constraint_in_unknown_names_is_told_with_its_place(paddle):
    with pytest.raises(SpecError, match=r'paddle.toml:\d+:\d+: .*unknown name "lenght"'):
        design_of(paddle(("length + 0.5", "lenght + 0.5")))


def test_devices_and_carriages_have_no_place_in_a_design(paddle):
    path = paddle(("[trial]", '[rig.devices.a]\nplugin = "arduino-servo"\nport = "x"\n[trial]'))
    with pytest.raises(SpecError, match="a design is simulated and has no devices"):
        design_of(path)


def test_a_bound_of_zero_is_stood_at_by_what_comes_near_it_for_its_range():
    near = Margin("min_tip > 0", 1e-4, 0.0, span=0.1)
    far = Margin("min_tip > 0", 0.01, 0.0, span=0.1)
    assert near.active
    assert not far.active
    assert not Margin("d0 > 0", 1e-4, 0.0).active  # nothing says what is near


@pytest.mark.parametrize(("changed", "replaced"), [("", True), ("\n# mine", False)])
def test_an_untouched_copy_gives_way_to_the_rig_of_the_design_and_a_file_of_yours_does_not(
    tmp_path, changed, replaced
):
    from labrun.app.design import _place_of

    copy = tmp_path / "experiments" / "rowing.toml"
    copy.parent.mkdir()
    copy.write_text((shipped_experiments() / "rowing.toml").read_text() + changed)
    assert _place_of("rowing", tmp_path) == (copy, not replaced)


def with_rig(paddle, *changes: tuple[str, str], initial: str) -> Path:
    """Return the paddle's file, which also writes a rig whose search begins at `initial`."""
    table = f'[design.writes.rowing]\ntemplate = "rowing"\nvalues."cmaes.variables.f.initial" = "{initial}"\n'
    return paddle(("iterations = 25", "iterations = 2"), ("[leaders]", f"{table}[leaders]"), *changes)


def test_a_rig_that_was_written_twice_says_once_which_design_it_is_of(paddle, tmp_path):
    path = with_rig(paddle, initial="0.7 + 0.1 * f")
    design_of(path)
    result = design_of(path, seed=4)
    text = (tmp_path / "rowing.toml").read_text()
    assert text.count("# Written by labrun design") == text.count("# A later design") == 1
    assert str(result.run) in text.splitlines()[0]


def test_a_rig_that_would_be_refused_is_kept_with_the_run_and_the_file_in_use_stays(paddle, tmp_path):
    design_of(with_rig(paddle, initial="0.7 + 0.1 * f"))
    before = (tmp_path / "rowing.toml").read_text()
    notes = Notes()
    # at the start of the range, which is looked at beforehand, it would do; rowing's own range ends at 1.2
    path = with_rig(paddle, initial="0.7 + 5 * (f - 0.5)")
    result = design_of(path, progress=notes)
    assert result.finished
    assert (tmp_path / "rowing.toml").read_text() == before
    assert f"({result.run})" in (result.run / "rowing.toml").read_text()
    assert any(
        "rowing.toml stays as it is" in line and "is outside 0.6 ... 1.2" in line for line in notes.notes
    )
    assert any(line.startswith("rig") and str(result.run) in line for line in result.more)
    assert design_of(path, seed=5).finished  # and the next design has a template to go by


def test_show_and_page_of_a_design_tell_what_holds_it_back_and_nothing_of_a_bench(paddle, capsys):
    result = design_of(paddle(("iterations = 25", "iterations = 3")))
    with open_run(result.run) as run:
        findings = read_findings(run)
        print_findings(findings)
        page = write_report(findings).read_text(encoding="utf-8")
    message = " ".join(capsys.readouterr().out.split())
    for line in result.more:
        assert html.escape(line.split(maxsplit=1)[1]) in page
        assert " ".join(line.split()) in message
    assert "Drawing to scale" in page
    for words in ("bench time", "Repeatability", "repeatability", "Drift", "jitter", "come to rest"):
        assert words not in page
        assert words not in message


def test_the_rig_of_a_design_keeps_to_the_servos_power_and_the_sides_of_that_design():
    experiments = shipped_experiments()
    swimmer = load_experiment(experiments / "swimmer.toml").experiment.design
    design = {"d0": 60.0, "d1": 120.0, "d2": 30.0, "d3": 110.0, "alpha": 40.0, "beta": -55.0, "f": 0.8}
    text = written_experiment(
        swimmer.writes["rowing"],
        (experiments / "rowing.toml").read_text(),
        "design.writes.rowing",
        design,
        title="A swimmer",
        run="results/swimmer/1",
        model="model.toml",
    )
    rig = tomllib.loads(text)
    assert rig["cmaes"]["where"] == ["alpha * f < 300 / (2 * pi)", "alpha * f <= 32.032"]
    assert rig["trial"]["within"]["cameras.link_y"] == [0.015, 0.5]
    assert rig["trial"]["reference"]["condition"] == {"alpha": 40.0, "beta": -55.0, "f": 0.8}


def test_braces_that_hold_no_expression_are_told_at_their_place(paddle):
    table = '[design.writes.rowing]\ntemplate = "rowing"\ntexts."cmaes.where.1" = "f <= {2 *}"\n'
    with pytest.raises(SpecError, match=r"design\.writes\.rowing\.texts"):
        load_experiment(paddle(("[leaders]", f"{table}[leaders]")))
