"""What a file says never becomes markup."""

from html.parser import HTMLParser

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrun.report.html_elements import Html, element, escaped, joined, share_bar, table
from labrun.report.html_page import page
from labrun.report.text import decimal_text, decimals_for, share_text

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
    read = _Read(element("p", words))
    assert [tag for tag, _ in read.tags] == ["p"]
    assert read.text == words


@given(WORDS)
def test_an_attribute_cannot_be_left(words):
    read = _Read(element("img", alt=words))
    assert read.tags == [("img", {"alt": words})]


def test_markup_inside_markup_is_not_escaped_twice():
    assert element("p", element("b", "a & b")) == "<p><b>a &amp; b</b></p>"
    assert isinstance(joined(["<", element("b", "x")]), Html)
    assert escaped(None) == ""


@given(st.lists(st.lists(WORDS, min_size=2, max_size=2), max_size=4))
def test_a_table_has_a_cell_for_every_value(rows):
    read = _Read(table(("one", "two"), rows))
    assert sum(tag == "td" for tag, _ in read.tags) == 2 * len(rows)
    assert read.text == "onetwo" + "".join(cell for row in rows for cell in row)


@pytest.mark.parametrize(("share", "width"), [(-1.0, "0.00"), (0.25, "25.00"), (7.0, "100.00")])
def test_a_bar_never_leaves_its_field(share, width):
    assert f"width:{width}%" in share_bar(share)


def test_a_page_refuses_whatever_comes_from_elsewhere():
    text = page("<b>", element("h1", "x"), [("a", "first", element("p", "y"))])
    assert "default-src 'none'; img-src data:" in text.replace("&#x27;", "'")
    assert "<title>&lt;b&gt;</title>" in text


def test_a_column_of_means_has_two_digits_of_its_typical_error():
    decimals = decimals_for([0.0021, 0.0038, None, 0.0009])
    assert decimal_text(0.51873, decimals) == "0.5187"
    assert decimal_text(-0.000001, decimals) == "-1e-06"
    assert decimals_for([None, 0.0]) is None


@pytest.mark.parametrize(("part", "text"), [(0, "0 %"), (0.0123, "0.012 %"), (4.56, "4.6 %"), (62.1, "62 %")])
def test_a_small_share_is_not_rounded_to_nothing(part, text):
    assert share_text(part, 100) == text
