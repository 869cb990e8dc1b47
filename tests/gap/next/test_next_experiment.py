"""Causes that the data cannot tell apart are told apart by the experiment that is proposed for it."""

import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from ambiguous import Bench, sine

from labrun.app.next import propose_next as propose
from labrun.errors import RecordingError, RequestError, StoreError
from labrun.gap.diagnose import Options, diagnose_dataset
from labrun.store import read_recording

DRIVEN = """
name = "driven"
states = ["angle", "rate"]
[inputs]
torque = { unit = "N m" }
[parameters]
inertia   = { value = 0.01, tolerance = 0.02, unit = "kg m^2", lower = 0.001 }
stiffness = { value = 10.0, tolerance = 0.02, unit = "N m/rad", lower = 0.1 }
damping   = { value = 0.4,  tolerance = 0.1, unit = "N m s/rad", lower = 0.0 }
[equations]
angle = "rate"
rate  = "(torque - stiffness*angle - damping*rate)/inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[initial]
angle = 0.0
rate  = 0.0
"""

# gravity pulls the joint back, too, and grows with the payload
HANGING = """
name = "hanging"
states = ["angle", "rate"]
[inputs]
torque = { unit = "N m" }
[parameters]
inertia   = { value = 0.05, tolerance = 0.02, unit = "kg m^2", lower = 0.001 }
stiffness = { value = 2.0,  tolerance = 0.02, unit = "N m/rad", lower = 0.1 }
damping   = { value = 0.4,  tolerance = 0.1,  unit = "N m s/rad", lower = 0.0 }
[equations]
angle = "rate"
rate  = "(torque + force.hinge - stiffness*angle - damping*rate - 9.81*0.2*payload_kg*sin(angle))/inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.hinge]
kind       = "joint"
coordinate = "angle"
rate       = "rate"
stiffness  = "stiffness"
[initial]
angle = "free"
rate  = "free"
"""

TILTED = """
name = "tilted"
states = ["angle", "rate"]
[inputs]
torque = { unit = "N m" }
[parameters]
inertia   = { value = 0.05, tolerance = 0.02, unit = "kg m^2", lower = 0.001 }
stiffness = { value = 2.0,  tolerance = 0.02, unit = "N m/rad", lower = 0.1 }
damping   = { value = 0.4,  tolerance = 0.1,  unit = "N m s/rad", lower = 0.0 }
tilt      = { value = 0.0,  tolerance = 0.002, unit = "rad" }
[equations]
angle = "rate"
rate  = "(torque + force.hinge - stiffness*angle - damping*rate - up*1.0*sin(angle + tilt))/inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.hinge]
kind       = "joint"
coordinate = "angle"
rate       = "rate"
[initial]
angle = 0.0
rate  = 0.0
"""

SLIDING = """
name = "sliding"
states = ["way", "speed"]
[inputs]
push = { unit = "N" }
[parameters]
mass      = { value = 1.0,  tolerance = 0.02, unit = "kg", lower = 0.1 }
spring    = { value = 40.0, tolerance = 0.02, unit = "N/m", lower = 0.1 }
damping   = { value = 2.0,  tolerance = 0.1,  unit = "N s/m", lower = 0.0 }
[equations]
way   = "speed"
speed = "(push + force.rail - spring*way - damping*speed)/(mass + payload_kg)"
[outputs]
way = { equation = "way", unit = "m" }
[sites.rail]
kind       = "joint"
coordinate = "way"
rate       = "speed"
load       = "9.81*(mass + payload_kg)"
[initial]
way   = 0.0
speed = 0.0
"""

PAIRS = {
    "delay or lag": (
        Bench(
            DRIVEN, ("lag", "input", "torque", {"time_constant": 0.04}),
            tuple(({"f": f}, sine(5.0, f)) for f in (0.3, 0.5)), noise=0.02,
        ),
        "lag at torque", {"delay at torque", "delay at angle"},
    ),
    "rest offset or bias": (
        Bench(
            HANGING, ("rest-offset", "joint", "hinge", {"offset": 0.06}),
            tuple(({"payload_kg": 0.5, "f": f}, sine(0.6, f)) for f in (0.5, 0.9)), noise=0.005,
        ),
        "rest-offset at hinge", {"bias at angle"},
    ),
    "tilt or a constant force": (
        Bench(
            TILTED, None, tuple(({"up": 1.0, "f": f}, sine(0.6, f)) for f in (0.5, 0.9)), noise=0.005,
            parameters={"tilt": 0.06},
        ),
        "parameter tilt", {"constant-force at hinge"},
    ),
    "friction that depends on the load, or not": (
        Bench(
            SLIDING, ("load-dependent-friction", "joint", "rail", {"coefficient": 0.05}),
            tuple(({"payload_kg": 0.5, "f": f}, sine(6.0, f)) for f in (0.5, 0.9)), noise=0.002,
        ),
        "load-dependent-friction at rail", {"coulomb-friction at rail"},
    ),
}  # fmt: skip


QUICK = ("friction that depends on the load, or not",)


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(pair_name, marks=() if pair_name in QUICK else pytest.mark.slow) for pair_name in PAIRS
    ],
)
def proposed(request, tmp_path_factory):
    bench, truth, others = PAIRS[request.param]
    workspace = tmp_path_factory.mktemp("bench")
    folder = bench.write(workspace / "recorded")
    return bench, folder, propose(folder, workspace=workspace), truth, others


def test_what_the_data_cannot_tell_apart_is_told_apart_by_the_proposed_trials(proposed):
    bench, folder, proposal, truth, others = proposed
    assert proposal.doubt
    assert truth in proposal.rivals
    assert others & set(proposal.rivals)
    dataset, model = bench.carry_out(proposal, folder)
    diagnosis = diagnose_dataset(dataset, model, Options(places=False))
    (cause,) = diagnosis.causes
    left = {
        str(candidate.name) for candidate in diagnosis.candidates if candidate.verdict in ("cause", "rival")
    }
    assert str(cause.name) in left
    assert truth in left
    # the same effect at another place of the signal's way does the same
    effect = truth.partition(" at ")[0]
    assert not [name for name in others & left if name.partition(" at ")[0] != effect]


def test_the_pair_is_expected_to_be_told_apart_beforehand(proposed):
    _, _, proposal, truth, others = proposed
    expected = [
        evidence for evidence in proposal.outlook if evidence.truth == truth and evidence.rival in others
    ]
    assert expected
    assert all(evidence.ratio > 1.0 and evidence.sigma > 5.0 for evidence in expected)


def test_planned_inputs_stay_within_the_recorded_range(proposed):
    _, folder, proposal, _, _ = proposed
    recorded = np.concatenate([trial.inputs for trial in read_recording(folder).trials])
    for trial in proposal.trials:
        assert np.all(trial.inputs <= recorded.max(axis=0) * (1 + 1e-9))
        assert np.all(trial.inputs >= recorded.min(axis=0) * (1 + 1e-9))


def test_the_written_recording_waits_for_nothing_but_its_outputs(proposed, tmp_path):
    _, _, proposal, _, _ = proposed
    copy = Path(shutil.copytree(proposal.file.parent, tmp_path / "filled"))
    with pytest.raises(RecordingError, match="column"):
        read_recording(copy)
    output = [
        name
        for name, channel in tomllib.loads(proposal.file.read_text())["channels"].items()
        if channel["kind"] == "output"
    ]
    for file in copy.glob("*.csv"):
        head, *rows = file.read_text().splitlines()
        file.write_text("\n".join([f"{head},{output[0]}", *(f"{row},0.0" for row in rows)]) + "\n")
    filled = read_recording(copy)
    assert len(filled.trials) == len(proposal.trials) * proposal.repeats
    assert [dict(trial.condition) for trial in filled.trials[:: proposal.repeats]] == [
        dict(trial.condition) for trial in proposal.trials
    ]


def test_a_proposal_never_overwrites_a_file(tmp_path):
    taken = tmp_path / "mine.toml"
    taken.write_text("")
    with pytest.raises(RequestError, match="there already"):
        propose(tmp_path, out=taken)


def test_a_proposal_that_could_not_be_run_by_its_name_is_not_begun(tmp_path):
    with pytest.raises(RequestError, match=r"does not end in \.toml") as caught:
        propose(tmp_path, out=tmp_path / "mine")
    assert caught.value.hint == f"--out {tmp_path / 'mine'}.toml"


def test_a_place_that_takes_no_file_is_told_before_anything_is_computed(tmp_path, monkeypatch):
    bench, _, _ = PAIRS["delay or lag"]
    recorded = bench.write(tmp_path / "recorded")

    def refused(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refused)
    notes = []
    with pytest.raises(StoreError, match="nothing was computed"):
        propose(recorded, out=tmp_path / "next.toml", note=notes.append)
    assert notes == [f"reading {recorded}"]
