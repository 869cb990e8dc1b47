"""The tables of keys.md, made from the pydantic models that check an experiment file.

Below a line ``<!-- keys: TrialTable -->`` stands the table of that model. ``python docs/hooks/keys.py`` writes the page
anew.
"""

import re
from pathlib import Path

from labrun.experiment import key_reference
from labrun.toml import FUNCTIONS

PAGE = Path(__file__).parents[1] / "keys.md"
_MARK = re.compile(r"^<!-- keys: ([\w.:]+) -->\n(?:\n(?:\|.*\n)+)?", re.MULTILINE)
_FUNCTIONS = re.compile(r"^<!-- functions -->\n(?:\n(?:\|.*\n)+)?", re.MULTILINE)


def page(markdown: str) -> str:
    """Return the page with its tables as the models are today."""
    markdown = _FUNCTIONS.sub(lambda mark: f"{mark[0].splitlines()[0]}\n\n{functions()}\n", markdown)
    return _MARK.sub(lambda mark: f"{mark[0].splitlines()[0]}\n\n{table(mark[1])}\n", markdown)


def functions() -> str:
    """Return the functions of expressions as a Markdown table."""
    rows = [f"| `{name}` | {function.meaning} |" for name, function in FUNCTIONS.items()]
    return "\n".join(["| Function | |", "|---|---|", *rows])


def table(name: str) -> str:
    """Return the keys of a model as a Markdown table."""
    rows = [
        f"| `{key.path}` | {key.takes} | {_default(key.default)} | {key.meaning} |"
        for key in key_reference.explained(key_reference.model_of(name))
    ]
    return "\n".join(["| Key | Takes | If not given | |", "|---|---|---|---|", *rows])


def _default(default: str) -> str:
    if default == key_reference.REQUIRED:
        return f"**{default}**"
    return default if default == "its own defaults" else f"`{default}`" if default else "-"


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
