"""Find the file of a model: a path, a shipped model, or none."""

from pathlib import Path

from labrun import registry
from labrun.toml import nearest

GROUP = "labrun.models"
SUFFIXES = (".xml", ".mjcf", ".urdf", ".xacro")
"""Files that are read as a robot; xacro is named as such and refused."""


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
    if path.suffix == ".toml" or is_robot(path) or path.is_file():
        return path
    name = str(source)
    if ":" in name or registry.is_installed(GROUP, name):
        return None
    return shipped_models().get(name)


def is_robot(source: str | Path) -> bool:
    """Tell whether a file is an MJCF or URDF file, by its name."""
    return Path(source).suffix.lower() in SUFFIXES


def model_files_like(path: Path) -> list[str]:
    """Return the files of models and robots that a misspelled one may be; none if it is not written like a file."""
    if not path.suffix and len(path.parts) == 1:
        return []
    there = path.parent.glob("*") if path.parent.is_dir() else ()
    files = [str(file) for file in sorted(there) if file.suffix == ".toml" or is_robot(file)]
    return files if nearest(str(path), files) is not None else []
