"""A journal read while another process writes it."""

import json

from hypothesis import given, settings
from hypothesis import strategies as st

from labrun.store.journal import Journal, JournalTail

EVENTS = [
    {"event": "trial", "index": index, "reason": "é\u2028\x85 odd" * (index % 3)} for index in range(12)
]
CONTENT = "".join(json.dumps(event, ensure_ascii=False) + "\n" for event in EVENTS).encode()


@settings(max_examples=60, deadline=None)
@given(cuts=st.lists(st.integers(0, len(CONTENT)), max_size=20))
def test_every_event_is_seen_once_however_the_bytes_arrive(cuts, tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "journal.jsonl"
    tail = JournalTail(path)
    seen = []
    for end in [*sorted(cuts), len(CONTENT)]:
        path.write_bytes(CONTENT[:end])
        events, anew = tail.read()
        assert not anew
        seen += events
    assert seen == EVENTS
    assert tail.unreadable == 0


def test_a_torn_line_that_a_resumed_run_cuts_off_was_never_seen(tmp_path):
    path = tmp_path / "journal.jsonl"
    journal = Journal(path)
    journal.append("created")
    journal.close()
    tail = JournalTail(path)
    assert len(tail.read()[0]) == 1
    path.write_bytes(path.read_bytes() + b'{"event": "tri')
    assert tail.read() == ([], False)
    journal.append("resumed")  # repairs first
    events, anew = tail.read()
    assert ([event["event"] for event in events], anew) == (["resumed"], False)


def test_zeros_that_a_network_folder_shows_for_what_has_not_arrived_are_waited_for(tmp_path):
    path = tmp_path / "journal.jsonl"
    first, second = CONTENT.splitlines(keepends=True)[:2]
    path.write_bytes(first + b"\0" * (len(second) - 1) + b"\n")
    tail = JournalTail(path)
    assert tail.read() == ([EVENTS[0]], False)
    path.write_bytes(first + second)
    assert tail.read() == ([EVENTS[1]], False)


def test_a_line_that_stays_unreadable_is_counted_and_passed_over(tmp_path):
    path = tmp_path / "journal.jsonl"
    first, second = CONTENT.splitlines(keepends=True)[:2]
    path.write_bytes(first + b"garbage\n" + second)
    tail = JournalTail(path)
    assert tail.read() == (EVENTS[:2], False)
    assert tail.unreadable == 1


def test_a_journal_that_became_shorter_is_read_anew(tmp_path):
    path = tmp_path / "journal.jsonl"
    path.write_bytes(CONTENT)
    tail = JournalTail(path)
    tail.read()
    path.write_bytes(CONTENT.splitlines(keepends=True)[0])
    assert tail.read() == (EVENTS[:1], True)


def test_a_journal_that_is_not_there_has_no_events(tmp_path):
    tail = JournalTail(tmp_path / "journal.jsonl")
    assert tail.read() == ([], False)
    assert tail.changed_utc_s is None
