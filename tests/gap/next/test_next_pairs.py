"""Four pairs of causes that slow motion cannot tell apart, each settled by the experiment that is proposed for it."""

from dataclasses import dataclass

import pytest
from diagnosing import diagnose

from labrun.app.next import propose_next as propose
from labrun.app.run import run as execute
from labrun.experiment import load_experiment, load_named
from labrun.gap.diagnose import Options
from labrun.runner import Planner

SEED = 1


@dataclass(frozen=True)
class Pair:
    """What a dry run hides, what it is called, and what must be in doubt at first and ruled out at last.

    Of what one would mend in the same way, such as a lag and a delay, the truth comes first at last, and the other may
    stand beside it: no form is nature's to the last digit.
    """

    experiment: str
    hide: str
    truth: str
    other: str
    mended_alike: bool = False


SETTLED = {
    "a lag, no delay": Pair(
        "driven-joint", "lag@base:time_constant=0.02", "lag at base", "delay at base", mended_alike=True
    ),
    "a delay, no lag": Pair(
        "driven-joint", "delay@base:delay=0.02", "delay at base", "lag at base", mended_alike=True
    ),
    "a bent strip, no false zero": Pair(
        "driven-joint", "rest-offset@hinge:offset=0.05", "rest-offset at hinge", "bias at angle"
    ),
    "a false zero, no bent strip": Pair(
        "driven-joint", "bias@angle:offset=0.04", "bias at angle", "rest-offset at hinge"
    ),
    "a tilt, no friction that differs": Pair(
        "driven-joint-bushing", "tilt=0.03", "parameter tilt", "asymmetric-friction at hinge"
    ),
    "friction that grows with the load": Pair(
        "driven-joint", "load-dependent-friction@hinge:coefficient=0.5",
        "load-dependent-friction at hinge", "coulomb-friction at hinge",
    ),
    "friction that does not": Pair(
        "driven-joint", "coulomb-friction@hinge:torque=5e-3",
        "coulomb-friction at hinge", "load-dependent-friction at hinge",
    ),
}  # fmt: skip


def dry_run(folder, name, hide, seed=None):
    loaded = load_named(name, folder, [])
    return execute(loaded, results=folder / "results", dry_run=True, seed=seed, draw=False, hide=[hide]).run


@pytest.mark.slow
@pytest.mark.parametrize("case", SETTLED)
def test_what_slow_motion_leaves_open_the_proposed_experiment_settles(case, tmp_path):
    pair = SETTLED[case]
    first = dry_run(tmp_path, pair.experiment, pair.hide, SEED)
    proposal = propose(first, workspace=tmp_path)
    assert proposal.doubt
    assert {pair.truth, pair.other} <= set(proposal.rivals)
    assert proposal.file == tmp_path / "experiments" / f"{pair.experiment}-next.toml"
    experiment = load_experiment(proposal.file).experiment
    made = Planner(experiment).plan(experiment.run.conditions)
    made.require_feasible()
    assert 0 < proposal.time_s <= proposal.time_at_most_s
    second = dry_run(tmp_path, proposal.file.stem, f"same-as:{pair.experiment}")
    result = diagnose(first, more=[second], workspace=tmp_path, options=Options(places=False))
    (cause,) = result.causes
    assert str(cause.name) == pair.truth
    left = {str(candidate.name) for candidate in result.candidates if candidate.verdict == "rival"}
    assert pair.mended_alike or pair.other not in left


@pytest.mark.slow
def test_friction_that_differs_by_direction_is_told_from_a_tilt_by_slow_motion_already(tmp_path):
    hide = "asymmetric-friction@hinge:torque=2e-3,asymmetry=0.8"
    run = dry_run(tmp_path, "driven-joint-bushing", hide, SEED)
    (cause,) = diagnose(run, workspace=tmp_path, options=Options(places=False)).causes
    assert str(cause.name) == "asymmetric-friction at hinge"
    assert "parameter tilt" not in map(str, cause.indistinguishable_from)
