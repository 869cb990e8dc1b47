"""A run that was cut and resumed is the run that was never cut, whatever its file looks like."""

import tempfile
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

import labrun
from labrun.store import RunFolder

BENCH = """
title = "Hold"
kind = "{kind}"
[rig.devices.tail]
plugin = "simulated-servo"
[gait]
plugin = "hold"
joints.tail = {{ angle_deg = "{angle}" }}
[trial]
duration_s = 0.05
repeats = {repeats}
[{kind}]
{table}
"""
NAMES = ("a", "b", "c")
RANGE = st.sampled_from(["{ from = 1, to = 3, step = 1 }", "{ step = 0.5, to = 1, from = 0 }"])
LIST = st.sampled_from(["[0.7, 1.4]", "[1, 2, 3]", "[2]"])
INTERVAL = st.sampled_from(["{ from = 0, to = 3 }", "{ to = 1, from = -1 }"])
GRID_AXIS = st.one_of(RANGE, LIST)


@st.composite
def experiments(draw):
    """Return an experiment file and the options it is run with."""
    names = draw(st.permutations(NAMES))[: draw(st.integers(1, 3))]
    overrides = []
    kind = draw(st.sampled_from(["grid", "sobol", "random", "run"]))
    nested = draw(st.booleans())
    over = draw(st.sampled_from(["", "over = { v = [1, 2] }\n"])) if kind != "sobol" else ""
    if kind == "run":
        conditions = [
            {name: draw(st.integers(0, 9)) for name in draw(st.permutations(names))} for _ in range(4)
        ]
        rows = ["{" + ", ".join(f"{k} = {v}" for k, v in condition.items()) + "}" for condition in conditions]
        table = f"conditions = [{', '.join(rows)}]\n{over}"
    else:
        axis = GRID_AXIS if kind == "grid" else INTERVAL
        axes = {name: draw(axis) for name in names}
        samples = "" if kind == "grid" else "samples = 5\n"
        written = (
            "[sweep.axes]\n" + "".join(f"{name} = {axis}\n" for name, axis in axes.items())
            if nested
            else "axes = { " + ", ".join(f"{name} = {axis}" for name, axis in axes.items()) + " }\n"
        )
        table = f'design = "{kind}"\n{samples}{over}order = "{draw(ORDERS)}"\n{written}'
        if draw(st.booleans()):
            overrides.append(f"sweep.axes.{draw(st.sampled_from(names))}={draw(axis)}")
    if draw(st.booleans()):
        overrides.append("trial.repeats.max=2")
    text = BENCH.format(
        kind="run" if kind == "run" else "sweep", table=table, angle=" + ".join(names), repeats=draw(REPEATS)
    )
    return text, overrides


ORDERS = st.sampled_from(["shuffled", "as-listed"])
REPEATS = st.sampled_from(["1", "{ max = 2, min = 1 }"])


def measured(run: Path) -> list[tuple]:
    outcomes = RunFolder(run).outcomes()
    return [(list(outcome.condition.items()), outcome.repeat, outcome.role) for outcome in outcomes.values()]


@given(experiment=experiments(), cut=st.integers(1, 6))
@settings(max_examples=12, deadline=None)
def test_a_run_cut_after_any_trial_resumes_to_the_run_that_was_never_cut(experiment, cut):
    text, overrides = experiment
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "hold.toml")
        path.write_text(text)
        wanted = {"dry_run": True, "seed": 3, "overrides": overrides, "draw": False, "results": folder}
        whole = labrun.run(path, **wanted)
        part = labrun.run(path, **wanted, limit=cut)
        assert measured(labrun.resume(part.run, draw=False).run) == measured(whole.run)
