"""HTML from values: what is not an element already is escaped, so that no name from a file becomes markup."""

import base64
import html
from collections.abc import Iterable, Sequence

_VOID = frozenset({"img", "meta", "br", "hr"})


class Html(str):
    """Text that is markup already; made by `element`, which escapes what it is given."""

    __slots__ = ()


Content = str | Html | None
"""What an element may hold: markup, text that will be escaped, or nothing."""


def escaped(content: Content) -> Html:
    """Return content as markup: markup as it is, text escaped, None as nothing."""
    if content is None:
        return Html("")
    return content if isinstance(content, Html) else Html(html.escape(content))


def element(tag: str, *children: Content, **attributes: str | None) -> Html:
    """Return an element.

    Parameters
    ----------
    tag
        Its name.
    *children
        Text is escaped, markup is not.
    **attributes
        Values are escaped; ``class_`` stands for ``class``, an underscore for a hyphen, None for no attribute.
    """
    written = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{html.escape(value)}"'
        for name, value in attributes.items()
        if value is not None
    )
    if tag in _VOID:
        return Html(f"<{tag}{written}>")
    return Html(f"<{tag}{written}>{joined(children)}</{tag}>")


def joined(parts: Iterable[Content], between: str = "") -> Html:
    """Return parts one after the other, with text between them."""
    return Html(html.escape(between).join(escaped(part) for part in parts))


def paragraph(*children: Content, class_: str | None = None) -> Html:
    """Return a paragraph."""
    return element("p", *children, class_=class_)


def section(anchor: str, title: str, *children: Content) -> Html:
    """Return a section under a heading, which a link can name."""
    return element("section", element("h2", title), *children, id=anchor)


def table(
    columns: Sequence[str],
    rows: Sequence[Sequence[Content]],
    *,
    words: Iterable[int] = (0,),
    marked: Iterable[int] = (),
    caption: str | None = None,
) -> Html:
    """Return a table that scrolls by itself where the screen is narrow.

    Parameters
    ----------
    columns
        Headings.
    rows
        One cell a column.
    words
        Columns of words, set to the left; all others are numbers, set to the right.
    marked
        Rows that stand out.
    caption
        Above the table.
    """
    left, bold = set(words), set(marked)

    def cells(tag: str, row: Sequence[Content]) -> list[Html]:
        scope = "col" if tag == "th" else None
        return [
            element(tag, cell, class_=None if number in left else "n", scope=scope)
            for number, cell in enumerate(row)
        ]

    head = element("thead", element("tr", *cells("th", columns)))
    body = element(
        "tbody",
        *(
            element("tr", *cells("td", row), class_="marked" if n in bold else None)
            for n, row in enumerate(rows)
        ),
    )
    above = element("caption", caption) if caption is not None else None
    return element("div", element("table", above, head, body), class_="scroll")


def picture(data: bytes, kind: str, *, alt: str, caption: Content = None, class_: str | None = None) -> Html:
    """Return a figure with its picture inside the page; `kind` is "png" or "svg+xml"."""
    source = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
    below = element("figcaption", caption) if caption is not None else None
    return element("figure", element("img", src=source, alt=alt), below, class_=class_)


def folded(summary: str, *children: Content) -> Html:
    """Return content that opens when its summary is clicked."""
    return element("details", element("summary", summary), *children)


def share_bar(share: float) -> Html:
    """Return a bar as long as a share of one; its number stands beside it, so readers of the page skip it."""
    width = f"width:{100 * min(max(share, 0.0), 1.0):.2f}%"
    return element("span", element("span", style=width), class_="bar", aria_hidden="true")
