"""The emulated bench: processes that start and end together, around one scene."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from labrun.devices import Trajectory
from labrun.errors import ExperimentError, PluginError, SpecError
from labrun.runner import EmulatedBench, RealClock
from labrun.runner import resolve as bench_module
from labrun.toml import PluginTable

CLOCK = RealClock()
TANK = PluginTable(plugin="caudal-tank")


def table(plugin, **settings):
    return PluginTable.model_validate({"plugin": plugin, **settings})


WRENCH = table("robotiq-ft300", port="/dev/ttyUSB0")


def gone(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.fixture(scope="module")
def bench():
    """Return one that all tests share which end nothing."""
    with EmulatedBench({"wrench": WRENCH, "rudder": table("servo")}, TANK, seed=3) as made:
        yield made


def test_the_scene_of_another_process_is_moved_and_felt_like_one_of_ones_own(bench):
    scene = bench.scene
    assert scene.joints == ("tail",)
    assert scene.signals["force_x"] == "N"
    now = CLOCK.now()
    goal = Trajectory(("tail",), np.array([0.0, 0.2]), np.array([[0.0], [0.5]]))
    scene.drive("tail", goal, now)
    angle = scene.observe(("tail",), now + np.array([0.0, 0.1, 0.3]))[:, 0]
    # the bench simulates in steps of 10 ms
    assert angle == pytest.approx([0.0, 0.25, 0.5], abs=0.03)


def test_what_the_scene_refuses_is_raised_here_with_its_words(bench):
    with pytest.raises(ExperimentError, match="no joint 'rudder'"):
        bench.scene.drive("rudder", Trajectory(("rudder",), np.zeros(1), np.zeros((1, 1))), CLOCK.now())


def test_a_driver_is_led_to_its_emulator_and_keeps_its_other_keys(bench):
    led = bench.table("wrench")
    assert led.plugin == "robotiq-ft300"
    assert led.settings["port"] != "/dev/ttyUSB0"
    assert Path(led.settings["port"]).exists()
    assert bench.log("wrench")[-1]["event"] == "open"


def test_a_device_without_an_emulator_is_left_to_its_stand_in(bench):
    assert bench.table("rudder").plugin == "simulated-servo"


def test_a_device_that_has_neither_is_named():
    with (
        pytest.raises(PluginError, match="unknown device plugin 'warp-drive'"),
        EmulatedBench({"tail": table("warp-drive")}, TANK, seed=3),
    ):
        pass


def test_a_bench_that_does_not_start_leaves_no_process_behind(capfd):
    with (
        pytest.raises(ExperimentError, match="the simulated bench did not start"),
        EmulatedBench({}, table("caudal-tank", bar_length_m=-1), seed=3) as bench,
    ):
        pass
    bench = EmulatedBench({"wrench": WRENCH}, table("caudal-tank", bar_length_m=-1), seed=3)
    with pytest.raises(ExperimentError):
        bench.open()
    bench.close()
    assert bench._processes == {}


def test_all_processes_end_with_the_bench():
    with EmulatedBench({"wrench": WRENCH}, TANK, seed=3) as bench:
        pids = [process.pid for process in (*bench._processes.values(), bench._scene_process)]
        folder = bench._folder
        assert Path(bench.settings["wrench"]["port"]).parent == folder
    assert all(gone(pid) for pid in pids)
    assert not folder.exists()


@pytest.mark.parametrize("which", ["the scene", "an emulator"])
def test_ctrl_c_while_the_bench_starts_leaves_no_process_and_no_folder_behind(monkeypatch, capfd, which):
    bench = EmulatedBench({"wrench": WRENCH}, TANK, seed=3)
    answer, started = bench_module._answer, []

    def press(process, who):
        started.append(process)
        if ("emulator" in who) == (which == "an emulator"):
            raise KeyboardInterrupt
        return answer(process, who)

    monkeypatch.setattr(bench_module, "_answer", press)
    with pytest.raises(KeyboardInterrupt), bench:
        pass
    assert started
    assert all(process.poll() is not None for process in started)
    assert bench._folder is None
    assert capfd.readouterr().err == ""


def test_a_log_goes_on_in_the_folder_of_the_run(tmp_path):
    with EmulatedBench({"wrench": WRENCH}, TANK, seed=3) as bench:
        bench.keep_logs(tmp_path / "emulated")
        bench.inject("wrench", "silence")
        deadline_s = CLOCK.now() + 5
        while CLOCK.now() < deadline_s and bench.log("wrench")[-1]["event"] != "fault":
            CLOCK.sleep(0.01)
    lines = (tmp_path / "emulated" / "wrench.jsonl").read_text()
    assert '"open"' in lines
    assert '"fault"' in lines


def test_a_fault_for_a_device_that_is_not_there_is_refused(bench):
    with pytest.raises(SpecError, match="no emulator of device 'tail'"):
        bench.inject("tail", "silence")


def test_emulators_outlive_a_killed_runner_for_the_watchdog_and_then_end_by_themselves(tmp_path):
    script = tmp_path / "runner.py"
    script.write_text(
        "import sys, time\n"
        "from labrun.runner import EmulatedBench\n"
        "from labrun.experiment.experiment import PluginTable\n"
        "wrench = PluginTable.model_validate({'plugin': 'robotiq-ft300', 'port': '/dev/ttyUSB0'})\n"
        "bench = EmulatedBench({'wrench': wrench}, PluginTable(plugin='caudal-tank'), seed=1)\n"
        "bench.open()\n"
        "print(bench._folder, bench._scene_process.pid, bench._processes['wrench'].pid, flush=True)\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as runner:
        folder, *pids = runner.stdout.readline().split()
        runner.send_signal(signal.SIGKILL)
    assert not any(gone(int(pid)) for pid in pids)
    deadline_s = CLOCK.now() + 20
    while CLOCK.now() < deadline_s and not all(gone(int(pid)) for pid in pids):
        CLOCK.sleep(0.05)
    assert all(gone(int(pid)) for pid in pids)
    assert not Path(folder).exists()
