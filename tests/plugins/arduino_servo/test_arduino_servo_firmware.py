"""The sketch itself, run on this machine: a party of its own beside driver and emulator."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from golden_lines import SERVO_TALK
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from labrun_plugins.arduino_servo.emulator import ArduinoServoEmulator
from labrun_plugins.arduino_servo.settings import ArduinoServoSettings
from labrun_plugins.labline.codec import LineParser, encode
from native_sketch import COMPILER, NativeSketch, compile_sketch, running

from labrun.devices.emulation import EmulatorContext, EmulatorLog

pytestmark = pytest.mark.skipif(COMPILER is None, reason="needs g++")


def _sketch() -> Path:
    package = importlib.util.find_spec("labrun_plugins.arduino_servo")
    assert package is not None
    assert package.origin is not None
    return Path(package.origin).parent / "firmware" / "labservo" / "labservo.ino"


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    return compile_sketch(_sketch(), tmp_path_factory.mktemp("sketch"))


@pytest.fixture
def board(program):
    with running(program) as sketch:
        yield sketch


def ask(sketch: NativeSketch, seq: int, *fields: str | int) -> tuple[str, ...]:
    (line,) = LineParser().feed(sketch.receive(encode(seq, *fields)))
    assert line.seq == seq
    return line.fields


def _drive(sketch: NativeSketch, watchdog_ms: int = 1000) -> None:
    ask(sketch, 1, "WD", watchdog_ms)
    ask(sketch, 2, "ATT", 0, 1000, 2000)


def test_the_firmware_compiles_without_a_warning_in_every_variant(tmp_path):
    for number, defines in enumerate(
        (
            ('KIND="labreset"', "PINS=9"),
            ('KIND="labslider"', "PINS=9", "SWITCH_PINS=7,8"),
            ("CURRENT_PIN=0", "SAFE_STATE=DETACH"),
            ("SAFE_STATE=NEUTRAL", "PINS=2,3,4,5,6,7,8,9,10,11,12,13"),
        )
    ):
        (tmp_path / str(number)).mkdir()
        compile_sketch(_sketch(), tmp_path / str(number), *defines)


def test_the_firmware_answers_the_golden_lines_with_the_golden_lines(board):
    for request, reply in SERVO_TALK[:-1]:
        assert board.receive(request + b"\n") == reply + b"\n"


def test_the_firmware_answers_the_golden_status_at_its_time(board):
    board.wait(123_456)
    request, reply = SERVO_TALK[-1]
    assert board.receive(request + b"\n") == reply + b"\n"


def test_switches_are_told_where_there_are_any(board, tmp_path):
    assert ask(board, 1, "SW") == ("OK", "SW")
    program = compile_sketch(_sketch(), tmp_path, 'KIND="labslider"', "PINS=9", "SWITCH_PINS=7,8")
    with running(program) as slider:
        assert ask(slider, 1, "HELLO")[2] == "labslider"
        assert ask(slider, 2, "SW") == ("OK", "SW", "0", "0")
        slider.close_switches(8)
        assert ask(slider, 3, "SW") == ("OK", "SW", "0", "1")


def test_the_firmware_greets_with_its_banner_and_feeds_the_chips_watchdog(board):
    assert board.banner == b"$0,EV,BOOT,1.0*A50F\n"
    setting, fed = board.chip_watchdog()
    board.wait(100)
    setting, later = board.chip_watchdog()
    assert setting == 4  # WDTO_250MS
    assert later - fed >= 100


def test_no_servo_gets_a_pulse_before_it_is_attached_and_then_the_one_that_was_set(board):
    ask(board, 1, "WD", 1000)
    ask(board, 2, "SV", 1200, -1, -1, -1)
    assert board.pins()[0] == (-1, 0)
    ask(board, 3, "ATT", 0, 1000, 2000)
    assert board.pins()[0] == (3, 1200)
    ask(board, 4, "DET", 0)
    assert board.pins()[0][0] == -1


def test_pulses_change_no_faster_than_the_slew_limit(board):
    _drive(board, 5000)
    ask(board, 3, "SV", 2000, -1, -1, -1)
    seen = [board.pins()[0][1]]
    for _ in range(80):
        board.wait(1)
        seen.append(board.pins()[0][1])
    assert seen[-1] == 2000
    assert all(b - a <= 200 for a, b in zip(seen, seen[20:], strict=False))
    assert ask(board, 4, "ST")[2] == "0"


def test_the_watchdog_stops_a_servo_on_its_way_and_says_so(board):
    _drive(board, 20)
    ask(board, 3, "SV", 2000, -1, -1, -1)
    assert board.wait(21) == b"$0,EV,WDOG*9CA4\n"
    held = board.pins()[0][1]
    assert 1500 < held < 2000
    board.wait(200)
    assert board.pins()[0] == (3, held)
    assert ask(board, 4, "SV", 1500, -1, -1, -1) == ("ERR", "WDOG")
    assert ask(board, 5, "ST")[2] == "2"


def test_a_stop_holds_a_servo_on_its_way(board):
    _drive(board)
    ask(board, 3, "SV", 2000, -1, -1, -1)
    board.wait(20)
    ask(board, 4, "STOP")
    held = board.pins()[0][1]
    board.wait(200)
    assert board.pins()[0] == (3, held)
    assert 1500 < held < 2000


def test_over_current_turns_the_outputs_off_until_the_board_restarts(tmp_path):
    program = compile_sketch(_sketch(), tmp_path, "CURRENT_PIN=0")
    with running(program) as board:
        _drive(board, 5000)
        board.read_analog(950)
        sent = board.wait(120)
        assert LineParser().feed(sent)[0].fields == ("EV", "HW", "OVERCURRENT")
        assert board.pins()[0][0] == -1
        assert ask(board, 3, "SV", 1500, -1, -1, -1) == ("ERR", "HW", "OVERCURRENT")
        assert ask(board, 4, "ST")[2] == "3"


class _HandClock:
    poll_s = 0.1

    def now(self) -> float:
        return 0.0

    def sleep(self, duration_s: float) -> None:
        del duration_s


class Emulated:
    """The emulator's board without its port, by the millisecond."""

    def __init__(self, folder: Path) -> None:
        context = EmulatorContext(
            _HandClock(), np.random.default_rng(0), folder, None, log=EmulatorLog(None, _HandClock())
        )
        self._board = ArduinoServoEmulator("tail", ArduinoServoSettings(port="p"), context)
        self._now_ms = 0
        self._board.machine.boot(0.0)

    def receive(self, data: bytes) -> bytes:
        sent = self._board.machine.take(data, self._now_ms / 1000)
        self._board.advance(self._now_ms / 1000)
        return b"".join(sent)

    def wait(self, duration_ms: int) -> bytes:
        sent = []
        for _ in range(duration_ms):
            self._now_ms += 1
            sent += self._board.machine.tick(self._now_ms / 1000)
            self._board.advance(self._now_ms / 1000)
        return b"".join(sent)

    def pulses(self) -> list[int]:
        """Return the pulse width of each channel that gives pulses, 0 of the others."""
        return [0 if channel.limits_us is None else channel.pulse_us for channel in self._board._channels]


def test_firmware_and_emulator_let_the_watchdog_expire_at_the_same_millisecond(board, tmp_path):
    for party in (board, Emulated(tmp_path)):
        party.receive(encode(1, "WD", 20))
        assert party.wait(20) == b""
        assert party.wait(1) == b"$0,EV,WDOG*9CA4\n"


def test_the_emulator_answers_the_golden_lines_with_the_golden_lines(tmp_path):
    emulated = Emulated(tmp_path)
    for request, reply in SERVO_TALK[:-1]:
        assert emulated.receive(request + b"\n") == reply + b"\n"
    emulated = Emulated(tmp_path)
    emulated.wait(123_456)
    request, reply = SERVO_TALK[-1]
    assert emulated.receive(request + b"\n") == reply + b"\n"


NUMBER = st.one_of(
    st.integers(-2, 5), st.integers(400, 2600), st.integers(0, 5100), st.sampled_from(["", "-", "x", "1.5"])
)
PULSE = st.one_of(st.integers(900, 2100), st.integers(900, 2100), st.just(-1))
REQUEST = st.one_of(
    st.tuples(st.just("SV"), PULSE, PULSE, PULSE, PULSE),
    st.tuples(st.just("ATT"), st.integers(0, 3), st.just(1000), st.just(2000)),
    st.tuples(st.just("WD"), st.sampled_from([0, 20, 20, 40, 5000])),
    st.sampled_from([("HELLO",), ("ST",), ("STOP",), ("PING",), ("DET", 0), ("WD", 500)]),
    st.tuples(st.sampled_from(["SV", "ATT", "WD", "DET", "ST", "sv", "MV"])).flatmap(
        lambda word: st.lists(NUMBER, max_size=7).map(lambda args: (*word, *args))
    ),
)
LINE = st.builds(lambda seq, request: encode(seq, *request), st.integers(1, 6), REQUEST)
BYTES = st.one_of(
    st.binary(max_size=30),
    LINE.map(lambda line: line[:-3]),
    LINE.map(lambda line: line.replace(b"1", b"2", 1)),
    st.just(b"$" * 130 + b"\n"),
)
STEP = st.one_of(LINE, LINE, LINE, BYTES, st.integers(1, 130), st.integers(1, 25), st.integers(18, 22))


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(STEP, max_size=30))
def test_firmware_and_emulator_answer_the_same_to_anything(program, tmp_path, steps):
    emulated = Emulated(tmp_path)
    with running(program) as native:
        for step in [encode(1, "WD", 5000), encode(2, "ATT", 0, 1000, 2000), *steps]:
            if isinstance(step, int):
                assert emulated.wait(step) == native.wait(step)
            else:
                assert emulated.receive(step) == native.receive(step)
            assert emulated.pulses() == [pulse_us if pin >= 0 else 0 for pin, pulse_us in native.pins()]
        end = b"\n" + encode(99, "ST")
        assert emulated.receive(end) == native.receive(end)
