"""The READMEs of the devices as pages of the site: a driver's folder stays whole, and its page is where one looks.

A page links to the README in the repository, where the link works as it stands; on the site it leads to the page.
"""

import posixpath
import re
from pathlib import Path
from typing import Any

PLUGINS = Path(__file__).parents[2] / "plugins" / "labrun_plugins"
_AT = "devices"
_README = re.compile(r"\]\((?:\.\./)+(?:plugins/labrun_plugins/)?(\w+)/README\.md")


def readmes() -> dict[str, Path]:
    """Return the devices' READMEs by the names of their pages; those of a device begin with its name as code."""
    return {
        path.parent.name.replace("_", "-"): path
        for path in sorted(PLUGINS.glob("*/README.md"))
        if path.read_text(encoding="utf-8").startswith("# `")
    }


def on_config(config: Any) -> Any:
    """Put the devices where the navigation says ``devices/*``."""
    pages = [f"{_AT}.md", *(f"{_AT}/{name}.md" for name in readmes())]
    config.nav = _with_devices(config.nav, pages)
    return config


def _with_devices(entries: list[Any], pages: list[str]) -> list[Any]:
    filled = []
    for entry in entries:
        if not isinstance(entry, dict):
            filled.append(entry)
            continue
        ((title, inner),) = entry.items()
        if inner == f"{_AT}/*":
            inner = pages
        elif isinstance(inner, list):
            inner = _with_devices(inner, pages)
        filled.append({title: inner})
    return filled


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Let links to a device's README lead to its page."""
    here = posixpath.dirname(page.file.src_uri)

    def to_page(link: re.Match[str]) -> str:
        name = link[1].replace("_", "-")
        return "](" + posixpath.relpath(f"{_AT}/{name}.md", here or ".")

    return _README.sub(to_page, markdown)


def on_files(files: Any, config: Any) -> Any:
    """Add one page a device."""
    from mkdocs.structure.files import File  # noqa: PLC0415  (the tests import this file without mkdocs)

    for name, path in readmes().items():
        files.append(File.generated(config, f"{_AT}/{name}.md", content=path.read_text(encoding="utf-8")))
    return files
