"""A conversation with a board in another process."""

import itertools
import os
import pty
import threading
import tty

import numpy as np
import pytest
from emulated import emulated
from hypothesis import given
from hypothesis import strategies as st
from labrun_plugins.labline.codec import encode
from labrun_plugins.labline.handshake import probe, stop_from_scratch
from labrun_plugins.labline.session import Hello, LineRefusedError, LineSession, StoppedError

from labrun.devices import SerialPort
from labrun.devices.clock import RealClock
from labrun.errors import DeviceError


@pytest.fixture(scope="module")
def board():
    with emulated("arduino-servo", {"port": "p"}, name="tail") as bench:
        yield bench


@pytest.fixture
def session(board):
    events = []
    session = LineSession(
        "tail", _port(board), board.clock, boot_wait_s=0.0, on_event=lambda f, _: events.append(f)
    )
    session.events = events
    session.hello = session.open("labservo")
    yield session
    session.stop()
    session.close()


def _port(board):
    return str(board.bench.settings["tail"]["port"])


def test_opening_returns_what_the_board_says(session):
    assert session.hello == Hello("labservo", "1.0", 4, 500.0)


def test_a_request_returns_what_stands_behind_ok_and_its_word(session):
    assert session.request("WD", 500) == ("500",)
    assert session.request("PING") == ()


def test_a_refusal_says_why_and_what_to_do(session):
    with pytest.raises(LineRefusedError, match=r"device tail: does not know JUMP.*ERR,WORD") as caught:
        session.request("JUMP")
    assert caught.value.code == "WORD"
    assert "flash" in str(caught.value.hint)
    session.arm(0)
    with pytest.raises(LineRefusedError, match="watchdog"):
        session.request("SV", 1500, 1500, 1500, 1500)
    session.request("PING")  # a request that was refused ends nothing


def test_a_lost_answer_is_asked_for_again_and_the_board_acts_once(session, board):
    session.arm(5000)
    begun_s = board.clock.now()
    board.inject("half-frame", 1)
    session.request("ATT", 0, 1000, 2000)
    events = [x["event"] for x in board.log() if x["time_s"] >= begun_s]
    assert events.count("attached") == 1
    assert events.count("repeated") == 1


def test_an_answer_that_comes_after_its_repetition_does_no_harm(session, board):
    board.inject("late", 0.15)
    assert session.request("WD", 900) == ("900",)
    board.clear("late")
    assert session.request("WD", 901) == ("901",)


def test_a_stop_makes_older_tokens_void(session):
    session.arm(5000)
    token = session.motion_token()
    assert session.post("SV", 1500, 1500, 1500, 1500, token=token)
    assert session.stop()
    assert not session.post("SV", 1500, 1500, 1500, 1500, token=token)
    with pytest.raises(StoppedError):
        session.request("SV", 1500, 1500, 1500, 1500, token=token)
    assert session.post("SV", 1500, 1500, 1500, 1500, token=session.motion_token())


def test_a_set_point_that_was_not_sent_is_not_waited_for(session, board):
    token = session.motion_token()
    session.stop()
    assert not session.post("SV", 1500, 1500, 1500, 1500, token=token)
    board.clock.sleep(0.7)
    session.check()


def test_set_points_that_nobody_answers_end_the_conversation(session, board):
    session.arm(5000)
    board.inject("silence")
    session.post("PING")
    board.wait_until(lambda: session._failure is not None)
    board.clear("silence")
    with pytest.raises(DeviceError, match="device tail: does not answer its set-points"):
        session.check()


def test_a_stop_that_nobody_answers_is_written_twice_and_says_so(session, board):
    board.inject("silence")
    begun_s = board.clock.now()
    assert not session.stop()
    board.clear("silence")
    assert len([x for x in board.events("stop") if x["time_s"] >= begun_s]) == 2


def test_a_stop_goes_out_although_another_thread_holds_the_line(session, board):
    begun_s = board.clock.now()
    with session._writing:
        session._port.write(b"$77,SV,15")  # cut short in the midst of a line
        session.stop()
    assert board.wait_for("stop", after_s=begun_s)["time_s"] - begun_s < 0.1


def test_feeding_keeps_the_watchdog_quiet_and_ending_it_does_not(session, board):
    begun_s = board.clock.now()
    session.arm(300)
    while board.clock.now() < begun_s + 0.9:
        session.feed()
        board.clock.sleep(0.01)
    assert not [x for x in board.events("watchdog") if x["time_s"] >= begun_s]
    board.wait_for("watchdog", after_s=begun_s)
    board.wait_until(lambda: ("WDOG",) in session.events)
    with pytest.raises(LineRefusedError, match="its watchdog has expired"):
        session.check()
    with pytest.raises(LineRefusedError):
        session.request("PING")


def test_numbers_go_round(session):
    session._answers._numbers = itertools.count(65_533)
    for _ in range(4):
        session.request("PING")


def test_a_board_of_another_kind_is_refused_and_the_port_closed(board):
    session = LineSession("stage", _port(board), board.clock, boot_wait_s=0.0)
    with pytest.raises(DeviceError, match=r"device stage: the board at .* is a 'labservo'"):
        session.open("labstage")
    assert not session.is_open


def test_opening_waits_for_the_banner_of_a_board_that_restarts(board):
    session = LineSession("tail", _port(board), board.clock, boot_wait_s=3.0)
    board.inject("restart")
    begun_s = board.clock.now()
    session.open("labservo")
    session.check()
    session.close()
    assert board.clock.now() - begun_s < 4.0
    assert board.events("booted")


def test_a_silent_port_is_no_board(board):
    board.inject("silence")
    session = LineSession("tail", _port(board), board.clock, boot_wait_s=0.0)
    with pytest.raises(DeviceError, match="does not answer HELLO"):
        session.open("labservo")
    assert not session.is_open
    board.clear("silence")


def test_a_probe_for_another_kind_finds_nothing_and_a_port_is_asked_once_for_all_kinds(board):
    assert probe(_port(board), "labstage") is None
    board.inject("silence")  # nobody would answer now
    identity = probe(_port(board), "labservo")
    board.clear("silence")
    assert identity is not None
    assert identity.model == "labservo"


def test_a_stop_from_scratch_tries_again_and_tells_if_nobody_answers(board):
    begun_s = board.clock.now()
    board.inject("half-frame", 1)
    stop_from_scratch("tail", _port(board))
    assert len([x for x in board.events("stop") if x["time_s"] >= begun_s]) == 2
    board.inject("silence")
    with pytest.raises(DeviceError, match=r"device tail: STOP stays unanswered"):
        stop_from_scratch("tail", _port(board))
    board.clear("silence")


def test_a_stop_from_scratch_waits_for_a_dying_program_to_let_go_of_the_port(board):
    holder = SerialPort("dying", _port(board), 115_200)
    holder.open()
    dying = threading.Timer(0.3, holder.close)
    dying.start()
    begun_s = board.clock.now()
    stop_from_scratch("tail", _port(board))
    dying.join()
    assert board.wait_for("stop", after_s=begun_s)


FIELD = st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E, exclude_characters="$*,"), max_size=8)
WORDS = st.sampled_from(["OK", "ERR", "EV", "S", "STOP", "BOOT", "WDOG", ""])
LINE = st.builds(
    lambda seq, fields: encode(seq, *fields),
    st.integers(0, 5),
    st.lists(st.one_of(WORDS, FIELD), min_size=1, max_size=6),
)


@given(st.lists(st.one_of(LINE, st.binary(max_size=60)), max_size=20))
def test_whatever_a_board_says_harms_nothing_but_the_conversation(heard):
    clock = RealClock()
    samples = []
    session = LineSession("tail", "p", clock, on_sample=lambda fields, _: samples.append(fields))
    for _ in range(3):
        session._answers.expect("STOP", posted=True)
    for data in heard:
        for line in session.counts.feed(data):
            session._hear(line, 0.0)
    assert len(session._answers._awaited) <= 3
    if session._failure is not None:
        assert str(session._failure).startswith("device tail: ")


def test_something_else_that_talks_is_left_alone():
    master, slave = pty.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    ending = threading.Event()
    noise = np.random.default_rng(1).bytes(64)

    def talk():
        while not ending.wait(0.01):
            os.write(master, noise)

    thread = threading.Thread(target=talk)
    thread.start()
    os.set_blocking(master, False)
    try:
        assert probe(os.ttyname(slave), "labservo") is None
    finally:
        ending.set()
        thread.join()
    with pytest.raises(BlockingIOError):
        os.read(master, 100)  # it was sent nothing
    os.close(master)
    os.close(slave)
