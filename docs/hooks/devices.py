"""The READMEs of the devices as pages of the site: a driver's folder stays whole, and its page is where one looks."""

from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

PLUGINS = Path(__file__).parents[2] / "plugins" / "labrun_plugins"
_AT = "devices"


def readmes() -> dict[str, Path]:
    """Return the devices' READMEs by device; the simulated ones are no device of a bench."""
    found = {path.parent.name: path for path in sorted(PLUGINS.glob("*/README.md"))}
    found.pop("simulated", None)
    return {name.replace("_", "-"): path for name, path in found.items()}


def on_config(config: Any) -> Any:
    """Put the devices where the navigation says ``devices/*``."""
    pages = [f"{_AT}/{name}.md" for name in readmes()]
    for entry in config.nav:
        for title, inner in entry.items():
            if inner == f"{_AT}/*":
                entry[title] = pages
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add one page a device."""
    for name, path in readmes().items():
        files.append(File.generated(config, f"{_AT}/{name}.md", content=path.read_text(encoding="utf-8")))
    return files
