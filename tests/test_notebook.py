"""Results in a notebook."""

import base64

from labrun.notebook import as_html
from labrun.search import RunResult


def test_a_result_shows_its_text_and_its_picture(tmp_path):
    figure = tmp_path / "figure.png"
    figure.write_bytes(b"pixels")
    result = RunResult(tmp_path, done=3, rejected=1, failed=0, best=None, figure=figure, finished=True)
    shown = result._repr_html_()
    assert "3 done, 1 rejected, 0 failed" in shown
    assert base64.b64encode(b"pixels").decode() in shown


def test_what_a_result_tells_never_becomes_markup(tmp_path):
    assert as_html("<b>odd", tmp_path / "gone.png") == "<div><pre>&lt;b&gt;odd</pre></div>"
