"""The sketch, compiled for the host with a screw, switches and an amplifier around it."""

import itertools
import shutil
import subprocess
from pathlib import Path

import pytest
from labrun_plugins.labline.codec import LineParser, encode
from labrun_plugins.linear_stage import driver
from labrun_plugins.linear_stage.reception import Flags, parse_sample, parse_state

HERE = Path(__file__).parent
SKETCH = Path(driver.__file__).parent / "firmware" / "labstage" / "labstage.ino"
STEPS_PER_MM = 1600


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    compiler = shutil.which("g++")
    if compiler is None:
        pytest.skip("no g++ here")
    program = tmp_path_factory.mktemp("labstage") / "labstage"
    sources = ["-DSKETCH=" + f'"{SKETCH}"', str(HERE / "firmware_bench.cpp")]
    subprocess.run(
        [compiler, "-std=c++11", "-O1", "-Wall", "-Wextra", "-Werror", *sources, "-o", program], check=True
    )

    def run(*script):
        done = subprocess.run(
            [program], input="\n".join(script) + "\n", capture_output=True, text=True, check=True, timeout=60
        )
        return done.stdout

    return run


def say(seq, *fields):
    return "F " + encode(seq, *fields).decode().strip()


def heard(output):
    return LineParser().feed(output.encode())


def answers(output):
    return [line.fields for line in heard(output) if line.seq]


def samples(output):
    return [parse_sample(line.fields[1:]) for line in heard(output) if line.word == "S"]


HOMED = (say(1, "WD", 5000), say(2, "HOME"), "T 4500", say(3, "PING"), "T 4000")


def test_it_says_what_it_is_as_the_page_has_it(board):
    assert heard(board("T 20"))[0].fields == ("EV", "BOOT", "1.0")
    assert answers(board("F $1,HELLO*7613", "F $2,WD,250*FBE8", "T 5")) == [
        ("OK", "HELLO", "labstage", "1.0", "1", "0080"),
        ("OK", "WD", "250"),
    ]


def test_the_pages_requests_are_carried_out_once_it_is_homed(board):
    page = ("F $2,MV,12.500,1.000*8CEE", "F $3,VEL,-0.500*18DB", "F $4,STR,80*B7C9")
    assert answers(board(say(9, "WD", 5000), "F $1,HOME*5E91", "T 5"))[-1] == ("OK", "HOME")
    assert answers(board(*HOMED, *page, "T 30"))[-3:] == [("OK", "MV"), ("OK", "VEL"), ("OK", "STR")]


def test_nothing_moves_without_watchdog_or_before_it_is_homed(board):
    out = board(say(1, "MV", "10.000", "1.000"), say(2, "WD", 1000), say(3, "MV", "10.000", "1.000"), "T 500")
    assert answers(out) == [("ERR", "WDOG"), ("OK", "WD", "1000"), ("ERR", "STATE", "HOME")]
    assert out.endswith("@ 48000\n")


def test_homing_ends_half_a_millimetre_above_the_switch(board):
    out = board(*HOMED, say(4, "ST"), "T 5")
    state = parse_state(answers(out)[-1][2:])
    assert state.flags == Flags.HOMED
    assert state.position_mm == 0.5
    assert out.endswith("@ 800\n")


def test_a_move_ends_where_it_was_sent_in_the_time_it_was_given(board):
    out = board(*HOMED, say(4, "STR", 80), say(5, "MV", "4.500", "2.000"), "T 2000", say(6, "PING"), "T 200")
    assert out.endswith(f"@ {round(4.5 * STEPS_PER_MM)}\n")
    result = samples(out)
    speeds = [
        (b.position_mm - a.position_mm) / (1e-6 * (b.micros - a.micros))
        for a, b in itertools.pairwise(result)
    ]
    assert sorted(speeds)[len(speeds) // 2] == pytest.approx(2.0, rel=0.004)
    assert (
        max(speeds) < 2.0 * 1.007
    )  # it tells where between two steps it is, of the 40 from sample to sample
    assert [sample.n for sample in result] == list(range(1, len(result) + 1))
    assert {b.micros - a.micros for a, b in itertools.pairwise(result)} <= set(range(12440, 12561, 20))


def test_the_amplifiers_extremes_are_clipped_and_flagged(board):
    for counts, expected in ((8388607, 8388607), (-8388608, -8388608), (83412, 83412), (-1, -1)):
        out = board(f"C {counts}", say(1, "STR", 80), "T 100")
        assert samples(out)[-1].counts == expected
        assert (Flags.SATURATED in samples(out)[-1].flags) is (abs(expected) > 8_000_000)


def test_an_amplifier_that_is_gone_is_flagged(board):
    out = board(say(1, "STR", 80), "T 50", "D 0", "T 200")
    assert Flags.NOT_READY in samples(out)[-1].flags
    assert Flags.NOT_READY not in samples(out)[0].flags


@pytest.mark.parametrize(("most", "stops"), [(8388606, True), (8388607, False)])
def test_without_its_amplifier_it_stops_if_it_has_a_force_to_mind(board, most, stops):
    out = board(
        *HOMED, say(4, "LIM", "0.000", "60.000", most), say(5, "VEL", "2.000"), "T 500", "D 0", "T 500",
    )  # fmt: skip
    started, ended = (int(part.split()[0]) for part in out.rsplit("@", 2)[1:])
    assert (("EV", "LIMIT", "CELL") in [line.fields for line in heard(out)]) is stops
    assert (ended - started < 0.06 * 2 * STEPS_PER_MM) is stops


def test_a_clipped_amplifier_is_beyond_every_limit(board):
    for counts in (8388607, -8388608):
        moved = (
            *HOMED,
            say(4, "LIM", "0.000", "60.000", 8388606),
            f"C {counts}",
            "T 30",
            say(5, "VEL", "2.000"),
        )
        assert ("EV", "LIMIT", "FORCE") in [line.fields for line in heard(board(*moved, "T 100"))]


def test_a_force_limit_stops_first_reports_after_and_lets_back_only(board):
    out = board(
        *HOMED, say(4, "LIM", "0.000", "60.000", 700000), say(5, "STR", 80), "C 0", "K 500",
        say(6, "VEL", "2.000"), "T 1500", say(7, "MV", "40.000", "2.000"), say(8, "MV", "0.600", "5.000"), "T 400",
    )  # fmt: skip
    assert ("EV", "LIMIT", "FORCE") in [line.fields for line in heard(out)]
    stopped_mm = max(sample.position_mm for sample in samples(out))
    # 1400 steps are the limit; a conversion later it has gone on for 12.5 ms at 2 mm/s, at most
    assert 0 <= (stopped_mm - 0.5) * STEPS_PER_MM - 1400 <= 0.0126 * 2 * STEPS_PER_MM
    assert answers(out)[-2:] == [("ERR", "LIMIT", "FORCE"), ("OK", "MV")]
    assert Flags.FORCE_LIMIT not in samples(out)[-1].flags


@pytest.mark.parametrize(("speed", "flag"), [("9.000", Flags.HIGH_LIMIT), ("-9.000", Flags.LOW_LIMIT)])
def test_an_end_switch_stops_at_once(board, speed, flag):
    out = board(*HOMED, say(4, "VEL", speed), "T 4500", say(5, "PING"), "T 3000", say(6, "ST"), "T 5")
    state = parse_state(answers(out)[-1][2:])
    assert flag in state.flags
    assert Flags.MOVING not in state.flags
    assert out.endswith("@ 96000\n" if flag is Flags.HIGH_LIMIT else "@ 0\n")


def test_limits_of_travel_are_kept_for_targets_and_for_speeds(board):
    out = board(
        *HOMED, say(4, "LIM", "0.000", "2.000", 8388607), say(5, "MV", "2.001", "1.000"),
        say(6, "MV", "1.000", "10.001"), say(7, "VEL", "2.000"), "T 2000",
    )  # fmt: skip
    assert answers(out)[-3:] == [("ERR", "RANGE", "0"), ("ERR", "RANGE", "1"), ("OK", "VEL")]
    assert ("EV", "LIMIT", "HIGH") in [line.fields for line in heard(out)]
    assert out.endswith(f"@ {2 * STEPS_PER_MM + 1}\n")


def test_a_silent_host_stops_it_at_once_and_stop_slows_it_down(board):
    moving = (*HOMED, say(4, "WD", 100), say(5, "VEL", "8.000"))
    out = board(*moving, "T 400")
    assert ("EV", "WDOG") in [line.fields for line in heard(out)]
    way_mm = int(out.rsplit("@", 1)[1]) / STEPS_PER_MM - 0.5
    assert 8.0 * 0.1 - 0.2 < way_mm < 8.0 * 0.105
    refused = board(
        *moving, "T 400", say(6, "VEL", "1.000"), say(7, "WD", 100), say(8, "VEL", "1.000"), "T 5"
    )
    assert answers(refused)[-3:] == [("ERR", "WDOG"), ("OK", "WD", "100"), ("OK", "VEL")]
    stopped = board(*moving, "T 90", say(6, "STOP"), "T 1", "T 60")
    at_stop, after = (int(part.split()[0]) for part in stopped.rsplit("@", 2)[1:])
    assert 0.05 < (after - at_stop) / STEPS_PER_MM < 8.0**2 / (2 * 200) + 0.02


def test_a_repeated_request_is_answered_again_and_done_once(board):
    out = board(*HOMED, say(4, "MV", "1.000", "1.000"), "T 700", say(5, "MV", "0.600", "1.000"), "T 600",
                say(4, "MV", "1.000", "1.000"), "T 600")  # fmt: skip
    assert answers(out)[-1] == ("OK", "MV")
    assert out.endswith(f"@ {round(0.6 * STEPS_PER_MM)}\n")


def test_garbage_too_long_lines_and_wrong_checksums_are_dropped_silently(board):
    rubbish = (
        "F $1,PING*0000",
        "F " + "x" * 300,
        "F $$$***",
        "F ,,,*",
        "F $1*F0F0",
        "F $70000,PING*0000",
        "F $",
    )
    assert answers(board(*rubbish, say(7, "NOPE"), say(8, "MV", "1"), say(9, "PING"), "T 50")) == [
        ("ERR", "WORD"),
        ("ERR", "ARGC"),
        ("OK", "PING"),
    ]
    half = say(9, "PING")[2:-3]
    assert answers(board(f"F {half}{say(10, 'PING')[2:]}", "T 5")) == [("OK", "PING")]


def test_the_microseconds_wrap(board):
    out = board(f"U {2**32 - 200_000}", say(1, "STR", 80), "T 400")
    result = samples(out)
    assert result[0].micros > 2**31 > result[-1].micros
