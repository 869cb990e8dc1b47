"""What `labrun doctor` found, in lines that fit the terminal."""

import shutil
import textwrap

from labrun.devices import Remark

_INDENT = " " * 9


def remark_text(remark: Remark, width: int | None = None) -> str:
    """Return a remark and its advice.

    Parameters
    ----------
    width
        Of a line; the terminal's if None.
    """
    columns = shutil.get_terminal_size((120, 24)).columns if width is None else width
    lines = [_wrapped(f"{remark.verdict:<8} {remark.subject}: {remark.message}", columns, _INDENT)]
    if remark.advice:
        lines.append(_wrapped(f"{_INDENT}-> {remark.advice}", columns, f"{_INDENT}   "))
    return "\n".join(lines)


def _wrapped(text: str, columns: int, indent: str) -> str:
    # what is to be typed or looked up stays whole: paths and commands have no blanks to break at
    return textwrap.fill(
        text, columns, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
