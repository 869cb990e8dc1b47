"""What the doctor says of devices: in front of emulators, one that is out of order among others that are not."""

import numpy as np
import pytest
from forked_labrun import forked_emulators

from labrun.devices import DeviceContext, DeviceError, Identity
from labrun.experiment import Experiment
from labrun.runner import (
    EmulatedBench,
    RealClock,
    Rig,
    doctor,
    examine_rig,
    find_devices,
    resolve_device,
)

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


@pytest.fixture(scope="module")
def bench():
    with forked_emulators(), EmulatedBench(EXPERIMENT.rig.devices, EXPERIMENT.rig.scene, seed=1) as made:
        yield made


def remarks_of(bench):
    rig = Rig.build(EXPERIMENT, clock=CLOCK, seed=1, dry_run=False, emulated=bench, require_ports=False)
    return list(examine_rig(rig))


def port_of(bench, device):
    return bench.table(device).settings["port"]


def test_every_device_is_asked_and_listened_to_and_nothing_moves(bench):
    remarks, log = remarks_of(bench), bench.log("tail")
    assert not [remark for remark in remarks if remark.verdict == "problem"], remarks
    assert any(remark.message.startswith("RC servos on Arduino") for remark in remarks)
    assert any("samples/s, 100 asked for" in remark.message for remark in remarks)
    assert "command" not in {line["event"] for line in log}


def test_one_that_does_not_answer_is_a_problem_and_the_others_are_looked_at_all_the_same(bench):
    bench.inject("tail", "silence")
    remarks = remarks_of(bench)
    bench.clear("tail", "silence")
    (problem,) = [remark for remark in remarks if remark.verdict == "problem"]
    assert problem.subject == "tail"
    assert problem.advice
    assert any(remark.subject == "wrench" and "Robotiq" in remark.message for remark in remarks)


def test_a_device_at_a_port_is_found_by_asking_for_each_kind_in_turn(bench):
    ports = {name: port_of(bench, name) for name in EXPERIMENT.rig.devices}
    remarks = {remark.subject: remark for remark in find_devices(list(ports.values()))}
    assert remarks[ports["tail"]].message.startswith("arduino-servo: labservo")
    assert remarks[ports["wrench"]].message.startswith("robotiq-ft300: Robotiq FT300")


def test_a_kind_whose_library_is_missing_says_what_to_install_and_keeps_no_other_from_asking(monkeypatch):
    def ask(port):
        raise DeviceError(port, "needs a library", hint="pip install 'labrun[robotiq]'")

    class Missing:
        probe = staticmethod(ask)

    class There:
        probe = staticmethod(lambda port: Identity("a thing", firmware="1.0"))

    kinds = {"missing": Missing, "there": There}
    monkeypatch.setattr(doctor, "_probes", lambda: {name: kind.probe for name, kind in kinds.items()})
    monkeypatch.setattr(doctor, "_require_free", lambda port: None)
    missing, result = find_devices(["/dev/ttyUSB7"])
    assert (missing.verdict, missing.subject) == ("warning", "/dev/ttyUSB7, missing")
    assert missing.message == "needs a library"
    assert missing.advice == "pip install 'labrun[robotiq]'"
    assert result.message == "there: a thing, firmware 1.0"


def test_a_machine_without_a_port_is_told_so():
    (remark,) = find_devices([])
    assert "this machine has none" in remark.message
    assert remark.advice


def test_a_port_that_a_run_holds_is_told_as_such(bench):
    item = resolve_device("tail", bench.table("tail"), dry_run=False)
    tail = item.make("tail", item.settings, DeviceContext(CLOCK, np.random.default_rng(1)))
    tail.open()
    (remark,) = find_devices([item.settings.port])
    tail.close()
    assert remark.verdict == "problem"
    assert "another program holds" in remark.message
