"""The loops of chapter 4 with compiled steps: what comes of them is what comes of the loops in Python."""

import json
import shutil
import warnings
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from labrun_plugins.rigs.spherical_mechanism.spiral import Spiral
from typer.testing import CliRunner

from labrun.app.run import run
from labrun.cli.app import app
from labrun.errors import LabrunError
from labrun.learned import Network, Scaling, files_of, read_learned
from labrun.store import open_run

pytestmark = pytest.mark.xdist_group("compiled loops")  # a loop is compiled once, by one worker

EXPERIMENTS = Path(__file__).parents[3] / "experiments"
TRANSFER = EXPERIMENTS / "spm-transfer.toml"
CONDITION = 'track.conditions=[{ controller = "mlp-ik", history_s = 1.0, load_g = 100, load_from_s = 1.5 }]'


def tracked(folder, rate_hz, *changes, duration_s=3.0):
    overrides = [
        f"trial.duration_s={duration_s}",
        "objectives={}",
        CONDITION,
        f"track.rate_hz={rate_hz}",
        "track.compiled=true",
        *changes,
    ]
    return run(TRANSFER, dry_run=True, seed=1, overrides=overrides, results=folder).run


def columns(folder, device, *names):
    with h5py.File(folder / "run.h5") as file:
        return np.column_stack([file[device][name][:] for name in names])


@pytest.mark.parametrize("controller", ["ik", "mlp-ik", "mlp-error"])
def test_the_end_effector_goes_where_the_loop_in_python_takes_it(tmp_path, controller):
    changes = ["trial={ duration_s = 3 }", "objectives={}", "track.rate_hz=125", "rig.scene.noise=0"]
    names = [f"pose_feedback_{part}" for part in ("qw", "qx", "qy", "qz")]
    ways = []
    for way in ("true", "false"):
        condition = f'track.conditions=[{{ controller = "{controller}", load_g = 100 }}]'
        overrides = [*changes, condition, f"track.compiled={way}"]
        file = EXPERIMENTS / "spm-pretrained.toml"
        found = run(file, dry_run=True, seed=1, overrides=overrides, results=tmp_path / way)
        ways.append(columns(found.run, "loop", *names))
    apart_rad = 2.0 * np.abs(ways[0][60:] - ways[1][60:]).max(axis=1)
    moved_rad = 2.0 * np.abs(ways[1][-1] - ways[1][60]).max()
    assert np.median(apart_rad) < 0.003  # the cameras' noise is 0.0015 rad, and each way draws its own
    assert moved_rad > 0.02


def test_a_thousand_steps_a_second_learn_from_every_frame(tmp_path):
    folder = tracked(
        tmp_path, 1000, "rig.devices.servos.command_hz=1000",
        "track.loops.pose.controllers.mlp-ik.learn.every=1", "track.loops.pose.controllers.mlp-error.learn.every=1",
    )  # fmt: skip
    found = columns(folder, "loop", "pose_trainings", "pose_weights_age_s", "missed", "time_s")
    assert len(found) == 3000
    assert np.diff(found[:, 3]) == pytest.approx(np.full(2999, 1e-3), abs=1e-9)
    assert found[-1, 0] == pytest.approx(3.0 * 160, abs=10)
    assert found[100:, 1].max() < 0.03
    assert not found[:, 2].any()


def test_the_same_seed_gives_the_same_run(tmp_path):
    first, second = (
        columns(tracked(tmp_path / name, 500, duration_s=1.0), "loop", "pose_drive_theta_1") for name in "ab"
    )
    assert (first == second).all()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            ["track.rate_hz=160"],
            r"160 steps a second on this scene(.|\n)*track.rate_hz = 125, 200 or 1000 would do",
        ),
        (['rig.devices.servos.feedback=["angle", "speed"]'], "servos streams more than angles"),
        (["gait.joints.servo_1.angle_deg='theta_1*theta_2'"], "a gait that moves by itself, or bends"),
        (
            ['rig.scene={ plugin = "spm-load", hide = [{ effect = "coulomb-friction", site = "axis_1" }] }'],
            "effects that are hidden in this scene have no compiled form",
        ),
    ],
)
def test_what_cannot_be_compiled_is_refused_before_anything_moves(tmp_path, changes, said):
    with pytest.raises(LabrunError, match=said):
        tracked(tmp_path, 500, *changes)
    assert not list(tmp_path.rglob("run.h5"))


@pytest.mark.parametrize("compiled", ["true", "false"])
def test_a_network_that_returns_no_number_ends_the_run_by_the_name_of_its_drive_and_without_other_noise(
    tmp_path, compiled
):
    shutil.copyfile(TRANSFER, tmp_path / "spm-transfer.toml")
    shutil.copytree(EXPERIMENTS / "models", tmp_path / "models")
    model = read_learned(EXPERIMENTS / "models" / "mlp-ik.toml")
    # finite, and beyond what a float holds as soon as it is multiplied: the file is taken, its answers are no numbers
    beyond = tuple(np.full_like(one, 1e308) for one in model.network.weights)
    for name, content in files_of(
        replace(model, network=replace(model.network, weights=beyond)), "mlp-ik"
    ).items():
        (tmp_path / "models" / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    overrides = [
        CONDITION,
        "trial.duration_s=1",
        "objectives={}",
        "track.rate_hz=125",
        f"track.compiled={compiled}",
    ]
    file = tmp_path / "spm-transfer.toml"
    with warnings.catch_warnings(), pytest.raises(LabrunError, match="asks for theta_1 = "):
        warnings.simplefilter("error")
        run(file, dry_run=True, seed=1, overrides=overrides, results=tmp_path / "results")


def test_a_loop_that_fails_later_says_when(tmp_path):
    """Its blocks of 0.2 s are nobody's times: told is the time of the trial."""
    shutil.copyfile(TRANSFER, tmp_path / "spm-transfer.toml")
    shutil.copytree(EXPERIMENTS / "models", tmp_path / "models")
    model = read_learned(EXPERIMENTS / "models" / "mlp-ik.toml")
    weight, fine, most = np.zeros((4, 2)), 1e-3, 0.018
    weight[1] = np.finfo(float).max * fine / most  # beyond what a float holds once qx leaves +-most
    network = Network(
        (weight,), (np.zeros(2),), "identity", Scaling(np.zeros(4), np.full(4, fine)), Scaling(np.zeros(2), np.ones(2))
    )  # fmt: skip
    for name, content in files_of(replace(model, network=network), "mlp-ik").items():
        (tmp_path / "models" / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    time_s = np.arange(0, 3, 1 / 125)
    qx = np.array([Spiral({}, {})(one)[1] for one in time_s])
    expected = time_s[np.argmax(np.abs(qx) > most)]
    assert expected > 0.4
    changes = ["trial.duration_s=3", "objectives={}", "track.rate_hz=125", "track.compiled=true", CONDITION]
    changes.append('track.loops.pose.controllers.mlp-ik={ plugin = "network", model = "models/mlp-ik.toml" }')
    with pytest.raises(LabrunError, match=rf"controller mlp-ik asks for theta_1 = .* at {expected:.3f} s"):
        run(
            tmp_path / "spm-transfer.toml",
            dry_run=True,
            seed=1,
            overrides=changes,
            results=tmp_path / "results",
        )


@pytest.mark.parametrize("fault", ["lose_after_s", "stop_answering_after_s"])
def test_cameras_that_are_to_fail_are_no_part_of_a_compiled_dry_run_and_it_says_so(tmp_path, fault):
    changes = ["track.compiled=true", "track.rate_hz=125", f"rig.devices.cameras.faults={{ {fault} = 2 }}"]
    with pytest.raises(LabrunError, match="cameras is to have faults"):
        run(TRANSFER, dry_run=True, seed=1, overrides=[CONDITION, *changes], results=tmp_path)
    assert not list(tmp_path.rglob("journal.jsonl"))


def test_cameras_that_lose_the_body_end_the_run_safely_and_the_data_stay(tmp_path):
    lost = "rig.devices.cameras.faults={ lose_after_s = 2 }"
    changes = ["trial.duration_s=3", "objectives={}", CONDITION, lost]
    arguments = [part for one in changes for part in ("--set", one)]
    told = CliRunner().invoke(
        app, ["track", str(TRANSFER), "--dry-run", "--seed", "1", *arguments, "--results", str(tmp_path)]
    )
    assert told.exit_code == 1
    said = " ".join(told.output.split())
    assert "cameras: body effector is not tracked" in said
    assert "1 trial is kept in" in said
    (journal,) = tmp_path.rglob("journal.jsonl")
    events = [json.loads(line) for line in journal.read_text().splitlines()]
    stopped = next(place for place, one in enumerate(events) if one["event"] == "stopped")
    assert events[stopped]["failures"] == []
    assert events[stopped]["clock_s"] == pytest.approx(2.25, abs=0.05)
    stored = next(place for place, one in enumerate(events) if one["event"] == "trial")
    assert stopped < stored
    with open_run(journal.parent) as stored_run:
        seen_s = stored_run.measured(0)["cameras"].time_s
    assert 1.9 < seen_s[-1] <= 2.0
