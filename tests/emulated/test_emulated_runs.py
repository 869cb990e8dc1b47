"""Shipped experiments on real drivers in real time: their data is that of the dry run, within noise."""

import functools
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from forked_labrun import run_labrun
from scipy.ndimage import gaussian_filter1d

from labrun.report.timing import command_health
from labrun.store import open_run

RUNS = [
    # experiment, its command, channel, and how far two runs of one seed may differ (root mean square): the noise of
    # two sensors, which is sqrt(2) times that of one, and what the bench itself does not repeat
    # 1.5 mrad a camera; and the release falls between two points of the bench's time grid of 5 ms, at some 2 rad/s
    pytest.param("hinge", "run", "cameras.angle", 8e-3, 2, [], id="hinge"),
    # vortices
    pytest.param(
        "turn-torque", "cmaes", "wrench.torque_z", 6e-3, 6, ["fins"], id="turn-torque", marks=pytest.mark.slow
    ),
    # 5 mN m a sensor, and vortices
    pytest.param("fin-params", "sweep", "wrench.torque_y", 12e-3, 5, ["tail"], id="fin-params"),
]
SOON_AT_REST = ("--set", 'trial.settle={ until = "time", timeout_s = 3 }')
"""What the undisturbed bench is like takes ten seconds of a run to find out, and is not what these tests are about."""
PUNCTUAL_S, ATTEMPTS = 20e-3, 3
"""A set-point that leaves later moves the fin later. Such a run says nothing about drivers: it is made again."""
SMOOTH_S = 0.02
"""Noise that is quicker than this says nothing about how fast a channel changes."""
PATIENT_MS = 2000
"""Watchdogs here are for benches whose computer does not run a whole suite of tests beside."""


def both(
    folder: Path,
    command: str,
    experiment: str,
    limit: int,
    servos: Sequence[str],
    changes: tuple[str, ...] = (),
):
    """Return the run in front of emulators, with its commands on time, and the dry run of the same seed."""
    patient = [
        part for servo in servos for part in ("--set", f"rig.devices.{servo}.watchdog_ms={PATIENT_MS}")
    ]

    def run_of(mode: str):
        messages = ["--limit", str(limit), "--seed", "3", "--results", mode[2:], "--json", *patient, *changes]
        done = run_labrun(command, experiment, mode, *messages, cwd=folder)
        assert done.returncode == 0, done.stderr
        return open_run(folder / json.loads(done.stdout)["run"])

    for _ in range(ATTEMPTS):
        emulated = run_of("--emulate")
        if all(pacing.late_worst_s < PUNCTUAL_S for pacing in command_health(emulated.events).values()):
            break
    return emulated, run_of("--dry-run")


def difference(emulated, simulated, index, channel):
    """Return the root mean square difference of one trial's channel, and that of the channel's rate of change."""
    device, _, name = channel.partition(".")
    curves = []
    for run in (emulated, simulated):
        stream = run.signals(index)[device]
        tare = run.outcomes[index].tare.get(channel, 0.0)
        curves.append((stream.time_s, stream.column(name) - tare))
    (time_a, a), (time_b, b) = curves
    time_s = np.linspace(max(time_a[0], time_b[0]), min(time_a[-1], time_b[-1]), 2000)
    both_at = np.interp(time_s, time_a, a), np.interp(time_s, time_b, b)
    rate = np.gradient(gaussian_filter1d(both_at[1], SMOOTH_S / (time_s[1] - time_s[0])), time_s)
    return float(np.sqrt(np.mean((both_at[0] - both_at[1]) ** 2))), float(np.sqrt(np.mean(np.square(rate))))


def check_agreement(emulated, simulated, channel, bound, limit):
    assert len(emulated.outcomes) == len(simulated.outcomes) == limit
    late_s = max((health.late_worst_s for health in command_health(emulated.events).values()), default=0.0)
    for ours, theirs in zip(emulated.outcomes, simulated.outcomes, strict=True):
        assert ours.condition == theirs.condition
        assert ours.status == theirs.status == "done"
        apart, rate = difference(emulated, simulated, ours.index, channel)
        # a set-point that leaves late shifts what follows in time
        assert apart < bound + late_s * rate, (
            f"{ours.condition}: {apart} apart; set-points up to {late_s} s late, and the channel changes by {rate} "
            "a second"
        )
    assert emulated.provenance["emulated"]
    assert not simulated.provenance["emulated"]


@pytest.fixture(scope="module")
def first_trial(tmp_path_factory):
    """Return what gives an experiment's workspace and both runs of its first trial; each is measured once."""

    @functools.cache
    def measured(command, experiment, *servos):
        folder = tmp_path_factory.mktemp(experiment)
        return folder, *both(folder, command, experiment, 1, servos, SOON_AT_REST)

    return measured


@pytest.mark.parametrize(("experiment", "command", "channel", "bound", "limit", "servos"), RUNS)
def test_one_trial_in_front_of_emulators_agrees_with_the_dry_run_of_its_seed(
    first_trial, experiment, command, channel, bound, limit, servos
):
    _, emulated, simulated = first_trial(command, experiment, *servos)
    check_agreement(emulated, simulated, channel, bound, 1)


@pytest.mark.slow
@pytest.mark.parametrize(("experiment", "command", "channel", "bound", "limit", "servos"), RUNS)
def test_several_trials_in_front_of_emulators_agree_with_the_dry_run_of_their_seed(
    tmp_path, experiment, command, channel, bound, limit, servos
):
    emulated, simulated = both(tmp_path, command, experiment, limit, servos)
    check_agreement(emulated, simulated, channel, bound, limit)


def test_a_run_says_that_emulators_stood_behind_its_drivers_and_how_evenly_commands_went_out(first_trial):
    folder, emulated, _ = first_trial("sweep", "fin-params", "tail")
    run = emulated.path
    assert json.loads((run / "provenance.json").read_text())["devices"]["tail"]["firmware"].startswith(
        "labservo"
    )
    assert "emulated" in run_labrun("show", run, cwd=folder).stdout
    report = run_labrun("report", run, cwd=folder)
    assert report.returncode == 0, report.stderr
    page = (run / "report.html").read_text()
    assert "It was emulated: the real drivers" in page
    assert "<h3>Commands</h3>" in page
    assert {line["event"] for line in map(json.loads, (run / "emulated" / "tail.jsonl").open())} >= {
        "open",
        "command",
    }


def test_emulation_and_dry_run_exclude_each_other(tmp_path):
    done = run_labrun("run", "hinge", "--emulate", "--dry-run", cwd=tmp_path)
    assert done.returncode == 2
    assert "--dry-run and --emulate exclude each other" in done.stderr


def test_doctor_asks_every_emulated_device_of_an_experiment_and_moves_none(tmp_path):
    done = run_labrun("doctor", "--hardware", "fin-params", "--emulate", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "ok       tail: RC servos on Arduino" in done.stdout
    assert "ok       wrench: Robotiq FT300" in done.stdout
    assert "samples/s, 100 asked for" in done.stdout
