from io import StringIO

from rich.console import Console

from labrun.report.live import LiveProgress
from labrun.store import TrialOutcome


def test_trials_and_time_left_are_shown_as_the_most_there_can_be():
    stream = StringIO()
    console = Console(file=stream, force_terminal=True, width=160)
    progress = LiveProgress(console)
    progress.total(2745)
    progress.trial(TrialOutcome(0, {"a": 1.0}, 0, "measure", objectives={"thrust": 1.0}), 1, 2745, 3600.0)
    console.print(progress._render())
    text = Console(file=StringIO()).render_str(stream.getvalue()).plain
    assert "2745" in text
    assert "trials at most" in text
    assert "at most 1 h" in text
