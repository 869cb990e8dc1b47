"""The navigation of mkdocs.yml, as far as its pages are there; ``folder/*`` stands for all pages of a folder."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any


def on_config(config: Any) -> Any:
    """Drop entries without a page, and sections without entries, so that a part of the pages makes a site too."""
    config.nav = list(_there(config.nav, Path(config.docs_dir)))
    return config


def _there(entries: list[Any], docs: Path) -> Iterator[Any]:
    for entry in entries:
        if isinstance(entry, dict):
            ((title, inner),) = entry.items()
            kept = list(_there(inner, docs)) if isinstance(inner, list) else list(_there([inner], docs))
            if kept:
                yield {title: kept if isinstance(inner, list) else kept[0]}
        elif entry.endswith("/*"):
            pages = sorted(
                (docs / entry).parent.glob("*.md"), key=lambda page: (page.name != "index.md", page.name)
            )
            yield from (str(page.relative_to(docs)) for page in pages)
        elif (docs / entry).is_file() or entry.startswith(
            "devices/"
        ):  # those are made by the hook devices.py
            yield entry
