"""Find a model by file, plugin name or dotted name."""

from pathlib import Path

from labrun import registry
from labrun.errors import ModelError
from labrun.models.model import Model
from labrun.models.toml_model import parse_model
from labrun.toml import suggest

_GROUP = "labrun.models"


def load_model(source: str | Path) -> Model:
    """Return a model.

    Parameters
    ----------
    source
        A ``.toml`` file, the name of a model that ships with labrun or that a plugin brings (entry point of group
        ``labrun.models``), or ``"package.module:object"``; the object is a `Model`, or a function that returns one.

    Raises
    ------
    ModelError
        The file is not there or does not hold.
    PluginError
        The plugin does not import.
    """
    return load_from(source)


def load_from(source: str | Path, depth: int = 0) -> Model:
    """Do as `load_model`; `depth` counts the files that have referred to this one."""
    path = model_file(source)
    if path is not None:
        return parse_model(_text(path), str(path), depth)
    name = str(source)
    if ":" in name or registry.is_installed(_GROUP, name):
        found = registry.load(_GROUP, name)
        made = found() if callable(found) and not isinstance(found, Model) else found
        if not isinstance(made, Model):
            raise ModelError(f"{name} is no labrun model but {type(made).__name__}")
        return made
    known = [*shipped_models(), *registry.names(_GROUP)]
    raise ModelError(f"there is no model {name!r}", hint=suggest(name, known))


def shipped_models() -> dict[str, Path]:
    """Return the model files that come with labrun, by name."""
    package = Path(__file__).parents[1]
    for folder in (package / "shipped_experiments" / "models", package.parent / "experiments" / "models"):
        if folder.is_dir():
            return {path.stem: path for path in sorted(folder.glob("*.toml"))}
    return {}


def model_file(source: str | Path) -> Path | None:
    """Return the file that `load_model` would read for a source; None where it is no file."""
    path = Path(source)
    if path.suffix == ".toml" or path.is_file():
        return path
    name = str(source)
    if ":" in name or registry.is_installed(_GROUP, name):
        return None
    return shipped_models().get(name)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ModelError(f"there is no model file {path}", hint=f"looked from {Path.cwd()}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"{path} cannot be read: {error}") from None
