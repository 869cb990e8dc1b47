"""The emulated board in this process: whatever stands on its lines, it answers in kind and keeps its limits."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labrun_plugins.labline.board import sealed
from labrun_plugins.labline.codec import LineParser
from labrun_plugins.linear_stage.emulator import LinearStageEmulator
from labrun_plugins.linear_stage.reception import Reception
from labrun_plugins.simulated.linear_stage import SimulatedLinearStageSettings

from labrun.devices.emulation import EmulatorContext, EmulatorLog
from labrun.runner import SimulatedClock

ARGUMENTS = st.one_of(
    st.floats(-100, 100).map(lambda value: f"{value:.3f}"),
    st.integers(-(10**10), 10**10).map(str),
    st.sampled_from(["", "-", ".", "1e3", "nan", "0x10", "1.2.3", "+5", "5."]),
    st.text("0123456789.-+eE x", max_size=14),
)
WORDS = st.sampled_from(["MV", "VEL", "LIM", "STR", "ST", "HOME", "STOP", "WD", "PING", "HELLO", "TARE", ""])


class StillBench:
    """Feels nothing, and remembers how it was driven."""

    def __init__(self):
        self.signals = {"force": "N", "position": "m"}
        self.joints = ("pusher",)

    def observe(self, signals, time_s):
        return np.zeros((len(time_s), len(signals)))

    def drive(self, joint, trajectory, start_s):
        assert np.isfinite(trajectory.angle_rad).all()


def board():
    clock = SimulatedClock(start_s=100.0)
    context = EmulatorContext(
        clock, np.random.default_rng(0), Path(), StillBench(), log=EmulatorLog(None, clock)
    )
    made = LinearStageEmulator("stage", SimulatedLinearStageSettings(port="p", zero_mm=5), context)
    made._ready_s = clock.now()
    made.machine.boot(clock.now())
    return made, clock


def run(made, clock, duration_s):
    for _ in range(round(duration_s / 0.01)):
        clock.sleep(0.01)
        made.machine.take(sealed("1,PING"), clock.now())
        made.advance(clock.now())


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(WORDS, st.lists(ARGUMENTS, max_size=4)), max_size=12))
def test_no_line_breaks_it_or_takes_it_beyond_its_limits(lines):
    made, clock = board()
    for setting in ("1,WD,5000", "2,HOME"):
        made.machine.take(sealed(setting), clock.now())
    run(made, clock, 2.5)
    made.machine.take(sealed("3,LIM,0.000,9.000,8388607"), clock.now())
    parser = LineParser()
    for seq, (word, arguments) in enumerate(lines, start=10):
        if word == "LIM":
            continue
        body = ",".join((str(seq), word, *arguments))
        answers = made.machine.take(sealed(body), clock.now())
        for line in parser.feed(b"".join(answers)):
            assert line.fields[0] in {"OK", "ERR"}
        run(made, clock, 0.1)
        assert -0.1 <= made._axis.true_mm <= 9.0 + 0.02
    assert parser.rejected == 0


@settings(max_examples=100, deadline=None)
@given(st.lists(st.binary(max_size=40), max_size=10))
def test_no_bytes_break_it(pieces):
    made, clock = board()
    for piece in pieces:
        for answer in made.machine.take(piece, clock.now()):
            assert answer.endswith(b"\n")
    assert made.machine.take(b"\n" + sealed("7,PING"), clock.now()) == [sealed("7,OK,PING")]


@given(st.lists(st.lists(ARGUMENTS, max_size=7), max_size=20))
def test_no_fields_break_the_reception_and_every_row_is_finite(lines):
    faults = []
    received = Reception("stage", None, 5.0, None, faults.append)
    for number, fields in enumerate(lines):
        received.sample(tuple(fields), float(number))
        received.event(tuple(fields), float(number))
    try:
        assert np.isfinite(received.take().values).all()
    except Exception as error:
        assert "HX711" in str(error)


@pytest.mark.parametrize("word", ["HOME", "MV,10.000,1.000", "VEL,1.000"])
def test_nothing_moves_while_the_watchdog_is_off(word):
    made, clock = board()
    (answer,) = made.machine.take(sealed(f"1,{word}"), clock.now())
    assert b"ERR,WDOG" in answer
    run(made, clock, 0.2)
    assert made._axis.true_mm == 5.0
