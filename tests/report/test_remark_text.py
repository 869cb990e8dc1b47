from hypothesis import given
from hypothesis import strategies as st

from labrun.devices import Remark
from labrun.report.terminal import remark_text

WORDS = st.lists(st.text("abcdef0123456789=_/.-", min_size=1, max_size=12), min_size=1, max_size=40).map(
    " ".join
)


def test_verdict_subject_message_and_advice_stand_below_one_another():
    text = remark_text(Remark("warning", "wrench", "latency timer 16 ms", "set it to 1"), 80)
    assert text == "warning  wrench: latency timer 16 ms\n         -> set it to 1"


@given(WORDS, WORDS, st.integers(40, 160))
def test_lines_fit_the_terminal_and_no_word_is_cut_or_lost(message, advice, width):
    text = remark_text(Remark("ok", "tail", message, advice), width)
    assert all(len(line) <= width for line in text.splitlines())
    assert text.split() == ["ok", "tail:", *message.split(), "->", *advice.split()]
