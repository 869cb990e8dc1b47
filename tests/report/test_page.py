"""What a file says never becomes markup, whatever page it stands on."""

from html.parser import HTMLParser

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun.report.page import PageFigure, PageTable, drawn, part

WORDS = st.text(alphabet=st.characters(blacklist_categories=("Cs", "Cc")), min_size=1)


class _Read(HTMLParser):
    """A page as a browser takes it: tags, attributes, text."""

    def __init__(self, markup: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(markup)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text += data


@given(WORDS)
def test_text_comes_back_as_text_whatever_it_holds(words):
    read = _Read(part("sentences", [words]))
    assert [tag for tag, _ in read.tags] == ["ul", "li"]
    assert read.text == words


@given(WORDS)
def test_an_attribute_cannot_be_left(words):
    read = _Read(part("drawing", PageFigure.of_png(b"", words)))
    assert [tag for tag, _ in read.tags] == ["figure", "img"]
    assert read.tags[1][1]["alt"] == words


@given(st.lists(st.lists(WORDS, min_size=2, max_size=2), max_size=4))
def test_a_table_has_a_cell_for_every_value(rows):
    read = _Read(part("table", PageTable(("one", "two"), rows)))
    assert sum(tag == "td" for tag, _ in read.tags) == 2 * len(rows)
    assert "".join(read.text.split()) == "".join(
        ("onetwo" + "".join(cell for row in rows for cell in row)).split()
    )


@pytest.mark.parametrize(("share", "width"), [(-1.0, "0.00"), (0.25, "25.00"), (7.0, "100.00")])
def test_a_bar_never_leaves_its_field(share, width):
    assert f"width:{width}%" in part("bar", share)


def test_a_picture_that_cannot_be_drawn_costs_only_itself():
    def fails():
        raise ValueError("<b>no axes")

    drawing = drawn(fails, "result", "the result")
    assert "could not be drawn: ValueError: &lt;b&gt;no axes" in part("drawing", drawing)
    assert drawn(lambda: None, "result", "the result") is None
