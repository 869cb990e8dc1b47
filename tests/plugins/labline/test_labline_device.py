"""A board's rules: watchdog, repeated requests, refusals; as the firmware has them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.labline.board import LineMachine, RefusalError, Word, decimal, whole
from labrun_plugins.labline.codec import LineParser, encode


class Board:
    def __init__(self):
        self.moved: list[str] = []
        self.safe: list[str] = []
        self.is_moving = False
        self.machine = LineMachine(
            "labtest", "1.0", 1, "0500",
            {"MV": Word(self._move, (1, 2), moves=True), "ST": Word(lambda _args, _now: ("0",))},
            moving=lambda: self.is_moving, make_safe=lambda how, _now: self.safe.append(how),
            note=lambda *_args, **_fields: None,
        )  # fmt: skip
        self.machine.boot(0.0)

    def _move(self, args, now_s):
        self.moved.append(args[0])
        return ()

    def ask(self, seq, *fields, now_s=0.0):
        (line,) = LineParser().feed(b"".join(self.machine.take(encode(seq, *fields), now_s)))
        assert line.seq == seq
        return line.fields


def test_the_board_says_what_it_is():
    assert Board().ask(1, "HELLO") == ("OK", "HELLO", "labtest", "1.0", "1", "0500")


def test_nothing_moves_before_the_watchdog_is_armed():
    board = Board()
    assert board.ask(1, "MV", "5") == ("ERR", "WDOG")
    assert board.ask(2, "WD", "100") == ("OK", "WD", "100")
    assert board.ask(3, "MV", "5") == ("OK", "MV")
    assert board.moved == ["5"]


def test_the_watchdog_expires_once_stops_and_keeps_motion_away_until_it_is_armed_again():
    board = Board()
    board.ask(1, "WD", "100")
    assert board.machine.tick(0.100) == []
    (event,) = board.machine.tick(0.1021)
    assert event == b"$0,EV,WDOG*9CA4\n"
    assert board.machine.tick(9.0) == []
    assert board.safe == ["watchdog"]
    assert board.ask(2, "MV", "5", now_s=9.0) == ("ERR", "WDOG")
    board.ask(3, "WD", "100", now_s=9.0)
    assert board.ask(4, "MV", "5", now_s=9.0) == ("OK", "MV")


def test_any_good_line_feeds_the_watchdog_and_a_damaged_one_does_not():
    board = Board()
    board.ask(1, "WD", "100")
    board.ask(2, "ST", now_s=0.09)
    assert board.machine.tick(0.15) == []
    board.machine.take(b"$3,PING*0000\n", 0.18)
    assert board.machine.tick(0.2) != []
    assert board.machine.dropped == 1


def test_a_repeated_request_is_answered_again_without_acting_twice():
    board = Board()
    board.ask(1, "WD", "100")
    assert board.ask(2, "MV", "5") == board.ask(2, "MV", "5") == ("OK", "MV")
    assert board.moved == ["5"]
    assert board.ask(3, "MV", "6") == ("OK", "MV")
    assert board.ask(2, "MV", "5") == ("OK", "MV")  # still remembered, although another came between
    assert board.moved == ["5", "6"]


def test_the_same_number_with_another_request_is_another_request():
    board = Board()
    board.ask(1, "WD", "100")
    board.ask(2, "MV", "5")
    board.ask(2, "MV", "7")
    assert board.moved == ["5", "7"]


def test_a_stop_acts_every_time():
    board = Board()
    board.ask(1, "STOP")
    board.ask(1, "STOP")
    assert board.safe == ["STOP", "STOP"]


@pytest.mark.parametrize(
    ("fields", "answer"),
    [
        (("WHAT",), ("ERR", "WORD")),
        (("PING", "1"), ("ERR", "ARGC")),
        (("MV",), ("ERR", "ARGC")),
        (("WD", "19"), ("ERR", "RANGE", "0")),
        (("WD", "5001"), ("ERR", "RANGE", "0")),
        (("WD", "x"), ("ERR", "RANGE", "0")),
    ],
)
def test_what_the_board_cannot_do_is_refused_with_its_code(fields, answer):
    assert Board().ask(1, *fields) == answer


def test_the_watchdog_cannot_be_turned_off_while_something_moves():
    board = Board()
    board.ask(1, "WD", "100")
    board.is_moving = True
    assert board.ask(2, "WD", "0") == ("ERR", "STATE")
    board.is_moving = False
    assert board.ask(3, "WD", "0") == ("OK", "WD", "0")


def test_a_reset_forgets_watchdog_and_requests():
    board = Board()
    board.ask(1, "WD", "100")
    board.ask(2, "MV", "5")
    assert board.machine.boot(3.0) == b"$0,EV,BOOT,1.0*A50F\n"
    assert board.ask(2, "MV", "5", now_s=3.0) == ("ERR", "WDOG")
    assert board.machine.millis(3.25) == 250


def test_an_unsolicited_number_is_no_request():
    assert Board().machine.take(encode(0, "STOP"), 0.0) == []


@given(st.lists(st.one_of(st.binary(max_size=120), st.just(encode(3, "PING")), st.just(b"\n")), max_size=10))
def test_a_board_survives_anything_and_answers_only_whole_requests(pieces):
    board = Board()
    answers = [line for piece in pieces for line in board.machine.take(piece, 0.0)]
    parsed = LineParser().feed(b"".join(answers))
    assert len(parsed) == len(answers)
    assert len(board.machine._buffer) < 96
    board.machine.take(b"\n", 0.0)
    assert board.ask(10, "PING") == ("OK", "PING")


@pytest.mark.parametrize("text", ["", "-", "1.5", "+1", "1e3", "0x10", " 1", "1234567890", "nan"])
def test_only_plain_whole_numbers_count(text):
    with pytest.raises(RefusalError):
        whole(text)


@pytest.mark.parametrize("text", ["", "-", ".", "nan", "inf", "1e3", "1.2.3", "--1", "١"])
def test_only_plain_decimal_numbers_count(text):
    with pytest.raises(RefusalError):
        decimal(text)
    assert decimal("-0.500") == -0.5
