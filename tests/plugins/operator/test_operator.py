"""A person at a terminal, who is a pseudo-terminal here: asked, awaited without waiting, and told when to let go."""

import io
import os
import pty
import select
import signal
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from labrun_plugins.operator.driver import Operator, OperatorSettings

from labrun.devices import Actuator, DeviceContext, Terminal, Trajectory
from labrun.errors import DeviceError, LimitExceededError
from labrun.interrupts import Interrupts
from labrun.runner import Bench, Interrupted, RealClock, Rig
from labrun.runner.resolve import ResolvedDevice

KEYS = {"instruction": "Hold {joint} at {angle_deg} deg {and still}", "limits": {"angle_deg": [-90, 90]}}


def _move(to_deg, joint="hinge"):
    return Trajectory((joint,), np.array([0.0, 1.0]), np.radians([[0.0], [to_deg]]))


def _release(at_deg):
    return Trajectory(("hinge",), np.array([0.0, 5.0]), np.radians([[at_deg], [at_deg]]))


@pytest.fixture
def person():
    """Return a driver, what the person sees, and the person's keyboard."""
    master, slave = pty.openpty()
    keys, screen = os.fdopen(slave, "r"), os.fdopen(os.dup(slave), "w")
    clock = RealClock()
    seen = []

    def sees(what, within_s=5.0):
        deadline_s = clock.now() + within_s
        while what not in "".join(seen) and (left_s := deadline_s - clock.now()) > 0:
            if select.select([master], [], [], left_s)[0]:
                seen.append(os.read(master, 4096).decode())
        return what in "".join(seen)

    def make(**keys_of):
        settings = OperatorSettings.model_validate({**KEYS, **keys_of})
        context = DeviceContext(clock, np.random.default_rng(0))
        driver = Operator("hinge", settings, context, Terminal(keys, screen))
        driver.open()
        return driver

    def hangs_up():
        nonlocal master
        os.close(master)
        master = -1

    yield SimpleNamespace(
        make=make, sees=sees, types=lambda text: os.write(master, text), clock=clock, hangs_up=hangs_up
    )
    keys.close()
    screen.close()
    if master >= 0:
        os.close(master)


def _arrives(driver, clock, within_s=5.0):
    deadline_s = clock.now() + within_s
    while clock.now() < deadline_s:
        if driver.arrived():
            return True
        clock.sleep(0.005)
    return False


def test_the_instruction_is_filled_in_and_enter_ends_the_move(person):
    driver = person.make()
    assert isinstance(driver, Actuator)
    assert driver.arrived()
    driver.follow(_move(30), person.clock.now())
    assert person.sees("Hold hinge at 30 deg {and still}")
    assert not driver.arrived()
    person.types(b"x")
    assert not _arrives(driver, person.clock, 0.1)
    person.types(b"\n")
    assert _arrives(driver, person.clock)
    assert driver.pose() == {"hinge": pytest.approx(np.radians(30))}


def test_the_person_is_told_what_the_trial_varies(person):
    driver = person.make(instruction="Hang the body of {area_cm2} cm2.")
    driver.arrange({"area_cm2": 30.0, "skin": "smooth"})
    driver.follow(_move(-12.5), person.clock.now())
    assert person.sees("Press Enter when hinge is at -12.5 deg.")
    assert person.sees("Hang the body of 30 cm2.")
    assert person.sees("Trial: area_cm2 = 30, skin = smooth")


def test_enter_pressed_before_the_question_is_no_answer(person):
    driver = person.make()
    person.types(b"\n\n")
    assert person.sees("\n")
    driver.follow(_move(30), person.clock.now())
    assert not _arrives(driver, person.clock, 0.1)


def test_a_release_rings_when_it_starts_and_the_body_hangs_afterwards(person):
    driver = person.make()
    start_s = person.clock.now() + 0.3
    driver.follow(_release(30), start_s)
    assert not person.sees("\a", within_s=max(0.0, start_s - person.clock.now() - 0.1))
    assert person.sees("\a")
    assert person.clock.now() >= start_s
    assert driver.pose() == {"hinge": 0.0}
    assert driver.arrived()


def test_a_stop_withdraws_the_question_and_silences_the_bell_from_any_thread(person):
    driver = person.make()
    driver.follow(_release(30), person.clock.now() + 0.2)
    stop = threading.Thread(target=driver.safe_stop)
    stop.start()
    stop.join()
    assert not person.sees("\a", within_s=0.4)
    driver.follow(_move(30), person.clock.now())
    driver.safe_stop()
    driver.safe_stop()
    with pytest.raises(DeviceError, match="was stopped while"):
        driver.arrived()
    driver.follow(_move(30), person.clock.now())
    person.types(b"\n")
    assert _arrives(driver, person.clock)


def test_a_person_who_does_not_answer_is_not_awaited_for_ever(person):
    driver = person.make(patience_s=0.05)
    driver.follow(_move(30), person.clock.now())
    with pytest.raises(DeviceError, match="nobody pressed Enter") as caught:
        _arrives(driver, person.clock)
    assert "resume" in caught.value.hint


def test_a_terminal_that_is_closed_meanwhile_is_told(person):
    driver = person.make()
    driver.follow(_move(30), person.clock.now())
    person.hangs_up()
    with pytest.raises(DeviceError, match="cannot be asked any more"):
        _arrives(driver, person.clock)
    assert not driver.health().ok


def test_nobody_is_asked_to_leave_a_limit_or_to_move_another_joint(person):
    driver = person.make()
    with pytest.raises(LimitExceededError, match="the person was not asked"):
        driver.follow(_move(95), person.clock.now())
    with pytest.raises(DeviceError, match="got a motion of tail"):
        driver.follow(_move(10, "tail"), person.clock.now())
    assert not person.sees("Hold", within_s=0.1)


def test_without_a_terminal_it_does_not_open():
    settings = OperatorSettings.model_validate(KEYS)
    context = DeviceContext(RealClock(), np.random.default_rng(0))
    driver = Operator("hinge", settings, context, Terminal(io.StringIO(), io.StringIO()))
    with pytest.raises(DeviceError, match="needs a person at a terminal") as caught:
        driver.open()
    assert "--emulate" in caught.value.hint
    assert not driver.health().ok
    with pytest.raises(DeviceError, match="not open"):
        driver.follow(_move(1), 0.0)


def test_it_says_what_the_person_is_told(person):
    driver = person.make()
    assert driver.identify().details["instruction"] == KEYS["instruction"]
    assert driver.health().ok
    Operator.emergency_stop("hinge", OperatorSettings())
    driver.close()
    driver.close()
    assert not driver.health().ok


def test_the_runner_keeps_looking_at_the_bench_until_the_person_says_that_the_body_is_there(person):
    driver = person.make()
    item = ResolvedDevice("hinge", "operator", lambda *_: driver, OperatorSettings.model_validate(KEYS))
    rig = Rig([item], clock=person.clock, seed=1, scene=None, dry_run=True)
    looks = []
    bench = Bench(rig, person.clock, check_stop=lambda: None, beat=lambda: looks.append(person.clock.now()))
    move = threading.Thread(target=bench.move, args=({"hinge": 0.5}, 100.0), daemon=True)
    move.start()
    assert person.sees("Press Enter")
    move.join(0.2)
    assert move.is_alive()
    assert len(looks) > 2
    person.types(b"\n")
    move.join(5.0)
    assert not move.is_alive()


def test_a_run_that_is_interrupted_does_not_wait_for_the_person(person):
    driver = person.make()
    item = ResolvedDevice("hinge", "operator", lambda *_: driver, OperatorSettings.model_validate(KEYS))
    rig = Rig([item], clock=person.clock, seed=1, scene=None, dry_run=True)
    stop = Interrupts()
    bench = Bench(rig, person.clock, check_stop=stop.check, beat=lambda: None)
    ended = []

    def move():
        try:
            bench.move({"hinge": 0.5}, 100.0)
        except Interrupted as error:
            ended.append(error)

    thread = threading.Thread(target=move, daemon=True)
    thread.start()
    assert person.sees("Press Enter")
    stop.number = signal.SIGINT
    rig.safe_stop()
    thread.join(5.0)
    assert ended
