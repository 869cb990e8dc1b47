"""Results that a person types: asked, checked, taken back, journalled."""

import pytest

from labrun.app.resume import resume
from labrun.app.run import run as execute
from labrun.errors import ExperimentError, LabrunError, RequestError, SpecError
from labrun.experiment import load_experiment
from labrun.objectives import Asked
from labrun.runner.asking import Asking
from labrun.store import Journal, open_run

SECONDS = {"question": "Seconds per turn", "least": 1, "most": 99, "value": "360 / answer", "unit": "deg/s"}
CHOICE = {"question": "Does it swim", "choices": ["no", "yes"]}

FILE = """
title = "A turn that a person times"
kind = "run"
[rig]
scene = "caudal-tank"
[rig.devices.tail]
plugin = "arduino-servo"
port = "/dev/ttyACM0"
limits = { angle_deg = [-60, 60], speed_deg_s = 528 }
[gait]
plugin = "sine"
joints.tail = { amplitude_deg = "a", frequency_hz = 1 }
[trial]
cycles = 2
repeats = 2
[run]
conditions = [{ a = 20 }, { a = 40 }]
order = "as-listed"
[objectives.turning]
plugin = "asked"
question = "Seconds per turn"
least = 1
most = 99
value = "360 / answer"
unit = "deg/s"
[objectives.swims]
plugin = "asked"
question = "Does it swim"
choices = ["no", "yes"]
"""


class Typist:
    """Types the lines of a list, and keeps what was asked."""

    def __init__(self, *lines):
        self.lines = list(lines)
        self.asked = []

    def ask(self, text):
        self.asked.append(text)

    def answer(self):
        return self.lines.pop(0)

    def __call__(self, text):
        self.asked.append(text)
        return self.lines.pop(0)


def asking(typist, events, simulated=None):
    def journal(event, **fields):
        events.append((event, fields))

    questions = {"turning": Asked(None, SECONDS), "swims": Asked(None, CHOICE)}
    return Asking(questions, typist, simulated, journal, lambda: None)


def test_answers_become_values_and_who_and_when_are_kept():
    events = []
    values = asking(Typist("12", "y", ""), events).ask(3, "trial 4")
    assert values == {"turning": 30.0, "swims": 1.0}
    event, fields = events[0]
    assert event == "answered"
    assert fields["typed"] == "12"
    assert fields["index"] == 3
    assert fields["who"]
    assert fields["when"].endswith("+00:00")


def test_back_takes_an_answer_back_before_and_after_the_last_one():
    typist = Typist("12", "back", "24", "yes", "back", "no", "")
    events = []
    assert asking(typist, events).ask(0, "trial 1") == {"turning": 15.0, "swims": 0.0}
    assert [(event, entry["typed"], entry["value"]) for event, entry in events] == [
        ("taken_back", "12", 30.0), ("taken_back", "yes", 1.0), ("answered", "24", 15.0), ("answered", "no", 0.0),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("typed", "problem"),
    [
        ("100", "out of range"),
        ("0", "out of range"),
        ("fast", "not a number"),
        ("nan", "out of range"),
        ("", "not a number"),
    ],
)
def test_what_is_no_answer_is_told_and_asked_again(typed, problem):
    typist = Typist(typed, "12", "yes", "")
    assert asking(typist, []).ask(0, "trial 1")["turning"] == 30.0
    assert problem in typist.asked[1]
    assert "a number from 1 to 99" in typist.asked[1]


def test_a_choice_is_one_of_its_words_or_how_one_begins():
    asked = Asked(None, {"question": "Which", "choices": ["slow", "sluggish", "fast"]})
    assert asked.number("F") == 2.0
    assert asked.number("slow") == 0.0
    for typed in ("s", "stop", ""):
        with pytest.raises(ValueError, match="one of slow, sluggish, fast"):
            asked.number(typed)


def test_answers_without_end_that_are_none_end_the_trial():
    with pytest.raises(ExperimentError, match="after 10 attempts"):
        asking(Typist(*["quick"] * 10), []).ask(0, "trial 1")


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        ({**CHOICE, "least": 1}, "a choice is one of its words"),
        ({**SECONDS, "most": 0}, "is not above least"),
        ({**SECONDS, "value": "360 / seconds"}, 'knows "answer" alone'),
    ],
)
def test_keys_that_do_not_hold_are_told(keys, problem):
    with pytest.raises((SpecError, ValueError), match=problem):
        Asked(None, keys)


def run(tmp_path, person, **changes):
    path = tmp_path / "timed.toml"
    path.write_text(FILE)
    return execute(
        load_experiment(path),
        results=tmp_path / "results",
        dry_run=True,
        seed=1,
        draw=False,
        person=person,
        **changes,
    )


def values_of(result):
    with open_run(result.run) as opened:
        return [(o.condition["a"], o.objectives["turning"], o.objectives["swims"]) for o in opened.outcomes]


def test_typed_results_are_stored_beside_the_recording_and_survive_a_stop(tmp_path):
    seconds = {20: "20", 40: "10"}
    lines = [line for a in (20, 40, 20, 40) for line in (seconds[a], "yes", "")]
    whole = run(tmp_path, Typist(*lines))
    assert values_of(whole) == [(20, 18.0, 1.0), (40, 36.0, 1.0)] * 2
    part = run(tmp_path, Typist(*lines[:6]), limit=2)
    ended = resume(part.run, person=Typist(*lines[6:]))
    assert values_of(ended) == values_of(whole)
    kept = [event for event in Journal(ended.run / "journal.jsonl").events() if event["event"] == "answered"]
    assert [event["typed"] for event in kept if event["objective"] == "turning"] == ["20", "10", "20", "10"]


def test_a_trial_of_which_the_answers_never_came_is_kept_and_asked_for_again(tmp_path):
    with pytest.raises(LabrunError, match="after 10 attempts") as caught:
        run(tmp_path, Typist(*["never"] * 10))
    stopped = tmp_path / "results" / "timed"
    (folder,) = stopped.iterdir()
    assert "labrun resume" in str(caught.value.hint)
    ended = resume(folder, person=lambda text: "" if "Enter" in text else ("yes" if "swim" in text else "20"))
    assert values_of(ended) == [(20, 18.0, 1.0), (40, 18.0, 1.0)] * 2


def test_a_scene_that_cannot_answer_is_told_before_anything_moves(tmp_path):
    with pytest.raises(ExperimentError, match="no scene answers"):
        run(tmp_path, None)


def test_without_a_terminal_the_bench_does_not_begin(tmp_path, monkeypatch):
    path = tmp_path / "timed.toml"
    path.write_text(FILE)
    monkeypatch.setattr("sys.stdin", None)
    with pytest.raises(RequestError, match="type turning, swims"):
        execute(
            load_experiment(path),
            results=tmp_path / "results",
            dry_run=False,
            draw=False,
        )


def test_back_at_the_next_question_corrects_the_stored_trial_before(tmp_path):
    lines = ["20", "yes", "", "back", "24", "no", "", "10", "yes", "", "20", "yes", ""]
    part = run(tmp_path, Typist(*lines), limit=3)
    ended = resume(part.run, person=Typist("10", "yes", ""))
    assert values_of(ended) == [(20, 15.0, 0.0), (40, 36.0, 1.0), (20, 18.0, 1.0), (40, 36.0, 1.0)]
    events = list(Journal(ended.run / "journal.jsonl").events())
    assert [event["objectives"] for event in events if event["event"] == "corrected"] == [
        {"turning": 15.0, "swims": 0.0}
    ]
    typed = [event["typed"] for event in events if event["event"] == "answered" and event["index"] == 0]
    assert typed == ["20", "yes", "24", "no"]


def test_a_value_that_a_decision_rests_on_is_not_changed_any_more(tmp_path):
    path = tmp_path / "timed.toml"
    rule = "repeats = { min = 1, max = 2, standard_error = { turning = 0.1 } }"
    path.write_text(FILE.replace("repeats = 2", rule))
    typist = Typist(*["20", "yes", ""] * 2, "back", *["20", "yes", ""] * 2)
    ended = execute(
        load_experiment(path), results=tmp_path / "results", dry_run=True, seed=1, draw=False,
        person=typist,
    )  # fmt: skip
    assert values_of(ended) == [(20, 18.0, 1.0), (40, 18.0, 1.0)] * 2
    assert not [e for e in Journal(ended.run / "journal.jsonl").events() if e["event"] == "corrected"]
