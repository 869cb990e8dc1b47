"""The reference of the Python API: readable in the repository, complete on the site.

In the pages of ``docs/api`` a table of what a module has follows a line ``<!-- api: labrun.devices.limits -->``, with
names behind the module if only some are meant. ``python docs/hooks/api.py`` writes the tables anew from the docstrings.
On the site, mkdocstrings puts the whole docstrings in their place.
"""

import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

PAGES = Path(__file__).parents[1] / "api"
_BLOCK = re.compile(r"^<!-- api: (\S+)((?: \w+)*) -->\n(?:.*?^<!-- /api -->\n)?", re.MULTILINE | re.DOTALL)


def page(markdown: str) -> str:
    """Return a page with its tables as the docstrings are today."""
    return _BLOCK.sub(lambda block: _described(block[1], block[2].split()), markdown)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Let mkdocstrings write the whole reference in place of the tables."""
    return _BLOCK.sub(lambda block: _directive(block[1], block[2].split()), markdown)


def _directive(module: str, names: list[str]) -> str:
    options = f"    options:\n      members: [{', '.join(names)}]\n" if names else ""
    return f"::: {module}\n{options}\n"


def _described(name: str, names: list[str]) -> str:
    module = importlib.import_module(name)
    own = f" {' '.join(names)}" if names else ""
    rows = [f"| `{call}` | {words} |" for call, words in _members(module, names)]
    table = ["", "| | |", "|---|---|", *rows] if rows else []
    lines = [
        f"<!-- api: {name}{own} -->",
        f"## `{name}`",
        "",
        _first_line(module),
        *table,
        "<!-- /api -->",
        "",
    ]
    return "\n".join(lines)


def _members(module: ModuleType, names: list[str]) -> Iterator[tuple[str, str]]:
    """Yield how each public class or function of a module is called, and the first line of its docstring."""
    for name, member in vars(module).items():
        known = inspect.isclass(member) or inspect.isfunction(member)
        if not known or name.startswith("_") or member.__module__ != module.__name__ or not member.__doc__:
            continue
        if names and name not in names:
            continue
        if inspect.isclass(member):
            yield name, _first_line(member) + _methods(member)
        else:
            yield f"{name}({', '.join(inspect.signature(member).parameters)})", _first_line(member)


def _methods(of: type) -> str:
    """Return the public methods and properties of a class, `` Has `start`, `read`.``."""
    texts = [
        f"`{name}`"
        for name, member in vars(of).items()
        if not name.startswith("_")
        and (inspect.isfunction(member) or isinstance(member, property | classmethod | staticmethod))
    ]
    return f" Has {', '.join(texts)}." if texts else ""


def _first_line(of: Any) -> str:
    return inspect.getdoc(of).split("\n\n")[0].replace("\n", " ").replace("|", "\\|").replace("``", "`")


if __name__ == "__main__":
    for path in sorted(PAGES.glob("*.md")):
        path.write_text(page(path.read_text(encoding="utf-8")), encoding="utf-8")
