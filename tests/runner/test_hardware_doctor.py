"""What the doctor says of devices: in front of emulators, one that is out of order among others that are not."""

import numpy as np

from labrun.devices import DeviceContext
from labrun.runner.clock import RealClock
from labrun.runner.emulated.bench import EmulatedBench
from labrun.runner.hardware_doctor import examine_rig, find_devices
from labrun.runner.resolving import resolve
from labrun.runner.rig import Rig
from labrun.spec.experiment import Experiment

EXPERIMENT = Experiment.model_validate(
    {
        "title": "Tail",
        "kind": "run",
        "rig": {
            "scene": "caudal-tank",
            "devices": {
                "tail": {"plugin": "arduino-servo", "port": "/dev/ttyACM0"},
                "wrench": {"plugin": "robotiq-ft300", "port": "/dev/ttyUSB0"},
            },
        },
        "gait": {"plugin": "hold", "joints": {"tail": {"angle_deg": 0}}},
        "trial": {"duration_s": 1},
        "run": {"conditions": [{"number": 1}]},
    }
)
CLOCK = RealClock()


def remarks_of(faults=None):
    with EmulatedBench(EXPERIMENT.rig.devices, EXPERIMENT.rig.scene, seed=1, faults=faults) as bench:
        rig = Rig.build(EXPERIMENT, clock=CLOCK, seed=1, dry_run=False, emulated=bench, require_ports=False)
        found = list(examine_rig(rig))
        return found, bench.log("tail")


def test_every_device_is_asked_and_listened_to_and_nothing_moves():
    found, log = remarks_of()
    assert not [remark for remark in found if remark.verdict == "problem"], found
    assert any(remark.message.startswith("RC servos on Arduino") for remark in found)
    assert any("samples/s, 100 asked for" in remark.message for remark in found)
    assert "command" not in {line["event"] for line in log}


def test_one_that_does_not_answer_is_a_problem_and_the_others_are_looked_at_all_the_same():
    found, _ = remarks_of({"tail": {"silence": True}})
    (problem,) = [remark for remark in found if remark.verdict == "problem"]
    assert problem.subject == "tail"
    assert problem.advice
    assert any(remark.subject == "wrench" and "Robotiq" in remark.message for remark in found)


def test_a_device_at_a_port_is_found_by_asking_for_each_kind_in_turn():
    with EmulatedBench(EXPERIMENT.rig.devices, EXPERIMENT.rig.scene, seed=1) as bench:
        ports = {name: bench.table(name).settings["port"] for name in EXPERIMENT.rig.devices}
        found = {remark.subject: remark for remark in find_devices(list(ports.values()))}
    assert found[ports["tail"]].message.startswith("arduino-servo: labservo")
    assert found[ports["wrench"]].message.startswith("robotiq-ft300: Robotiq FT300")


def test_a_port_that_a_run_holds_is_told_as_such():
    with EmulatedBench(EXPERIMENT.rig.devices, EXPERIMENT.rig.scene, seed=1) as bench:
        item = resolve("tail", bench.table("tail"), dry_run=False)
        tail = item.make("tail", item.settings, DeviceContext(CLOCK, np.random.default_rng(1)))
        tail.open()
        (remark,) = find_devices([item.settings.port])
        tail.close()
    assert remark.verdict == "problem"
    assert "another program holds" in remark.message
