"""The generator shares nothing with what it checks."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest
from generating_cases import GENERATOR

SOURCES = sorted(GENERATOR.rglob("*.py"))
ALLOWED = {"numpy", "scipy"}
OWN_START = "f'{_HERE.name}.cli'"
"""How the folder starts itself, whatever it is called."""

BLOCKED = """
import sys

class NoLabrun:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("labrun", "labrun_plugins"):
            raise ImportError(f"{name} is not to be had here")

sys.meta_path.insert(0, NoLabrun())
import runpy
sys.argv = ["cases", "--cases", "1", "--first", "2", "--seed", "12", "--out", sys.argv[1]]
try:
    runpy.run_path(GENERATOR, run_name="__main__")
except SystemExit as done:
    assert not done.code, done.code
assert not [name for name in sys.modules if name.partition(".")[0] in ("labrun", "labrun_plugins")]
"""


def imported(path: Path) -> set[str]:
    """Return the top names of everything a file imports, relative imports inside of the folder left out."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {name.name.partition(".")[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add((node.module or "").partition(".")[0])
        elif isinstance(node, ast.ImportFrom) and node.level > len(path.relative_to(GENERATOR).parts):
            names.add(ast.unparse(node))
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("__import__", "import_module")):
            names.add(ast.unparse(node.args[0]))
    return names


def test_there_are_sources_to_look_at() -> None:
    assert len(SOURCES) > 15


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(GENERATOR)))
def test_nothing_but_the_standard_library_numpy_and_scipy_is_imported(path: Path) -> None:
    allowed = ALLOWED | ({"mujoco"} if path.parent.name == "robots" else set())  # it steps the rigid bodies
    foreign = imported(path) - allowed - set(sys.stdlib_module_names) - {OWN_START}
    assert not foreign


def test_it_runs_where_labrun_cannot_be_imported(tmp_path: Path) -> None:
    code = BLOCKED.replace("GENERATOR", repr(str(GENERATOR)))
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "alone")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "alone" / "cases" / "case-0002" / "recording.toml").is_file()
