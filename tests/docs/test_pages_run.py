"""Every command line and every piece of Python in README and docs does what the page says."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from forked_labrun import forked_programs
from pages import Block, Command, blocks, commands, unlike

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]

# The pages show experiments of hours on the bench, half a minute in a dry run. Here they get fewer conditions.
SMALLER = {
    "fin-params": (
        "--set sweep.axes.b=[0] --set sweep.axes.a=[30,45,60] --set sweep.axes.f=[1.0,1.4] "
        "--set trial.reference.every=4 --set leaders={count=2,repeats=2}"
    ),
    "turn-torque": (
        "--set cmaes.population=6 --set cmaes.parents=3 --set cmaes.reevaluate=1 --set cmaes.stop.trials=24 "
        "--set trial.repeats=2 --set leaders={count=2,repeats=2}"
    ),
    "force-control": (
        "--set trial.repeats=1 --set trial.duration_s=20 --set objectives.first_cycle.to_s=10 "
        "--set objectives.later.from_s=10 --set objectives.later.to_s=20"
    ),
    "tail-sweep": (
        "--set sweep.axes.alpha=[60] --set sweep.axes.beta=[0] --set sweep.axes.f=[1.4] --set trial.repeats=3 "
        "--set leaders={count=1,repeats=2}"
    ),
    "swimmer": "--set design.stop.iterations=4 --set leaders={count=1,repeats=3}",
    "rowing": (
        "--set cmaes.population=4 --set cmaes.stop.iterations=2 --set leaders={count=1,repeats=2} "
        "--set gap.until_s=0.8 --set gap.rate_hz=40"
    ),
    "fin-step": "--set trial.repeats=4",
    "level": "--set trial.duration_s=18",
    "stabilise": "--set trial.duration_s=5 --set trial.repeats=1",
}
HIDING = "--set trial.repeats=2 --set trial.duration_s=3 --set run.conditions=[{release=20},{release=45}]"
"""Fewer and shorter trials of `hinge` for what a page hides at random: a diagnosis follows."""
ENDINGS = {
    "labrun: no trial was accepted": 1,
    "is not tracked": 1,
    "labrun: mine.toml: 4 errors": 2,
    "conditions leave a limit": 2,
    "is above the limit of": 2,
    "has changed since this run began": 2,
}
"""Output by which a page shows that a command ends badly, with its exit code; all others must end well."""
RUNS = ("run", "sweep", "cmaes", "track", "design")
SLOW = (
    "buckling-fins.md",
    "camera-stabiliser.md",
    "closed-chains.md",
    "closed-loop.md",
    "compare-with-data.md",
    "design-a-robot.md",
    "diagnose-the-gap.md",
    "fit.md",
    "learned-controllers.md",
    "simulate-your-bench.md",
    "specimen-tests.md",
    "step-response.md",
)
"""Pages that take long as a whole; of what the README shows, too, its own lines are enough."""
MOST_NOT_RUN = 21
"""A block that is marked and could run is a page nobody checks: whoever adds one must raise this number."""


def runnable(path: Path) -> list[Block]:
    return [
        block
        for block in blocks(path)
        if block.file is not None or block.language in ("console", "sh", "python")
    ]


def _as_parameters():
    """Yield each page to be run, without its slow blocks, and again with them where it has any."""
    for path in PAGES:
        page = runnable(path)
        slow = any(block.slow for block in page)
        if path.name in SLOW or slow:
            yield pytest.param(path, True, id=path.name + "-whole" * slow, marks=pytest.mark.slow)
        if path.name not in SLOW and not all(block.slow for block in page):
            yield pytest.param(path, False, id=path.name)


def test_what_is_not_run_says_why_and_is_little():
    marked = [block for path in PAGES for block in runnable(path) if block.reason is not None]
    listing = "\n".join(f"  {block.where}: {block.reason}" for block in marked)
    print("not run:\n" + listing)
    assert all(len(block.reason.split()) >= 3 for block in marked), f"a reason is a sentence:\n{listing}"
    assert len(marked) <= MOST_NOT_RUN, listing


@pytest.mark.parametrize(("path", "whole"), list(_as_parameters()))
def test_what_the_page_says_works(path, whole, tmp_path):
    reader = Reader(tmp_path)
    if path.name == "README.md":
        reader.prepare_readme()
    for block in runnable(path):
        if block.reason is None and (whole or not block.slow):
            reader.do(block)
    reader.run_python()


class Reader:
    """Somebody who types what a page says, in a fresh folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.site = folder / ".site"
        self.python: list[str] = []
        self.smaller: set[str] = set()

    def prepare_readme(self) -> None:
        """Make the files the README speaks of: one with four mistakes, and a run.h5 to open."""
        text = (ROOT / "experiments" / "fin-params.toml").read_text(encoding="utf-8")
        for right, wrong in (
            ('offset_deg = "b"', 'offset_rad = "b"'),
            ("repeats = 3\n", "repeat = 3\n"),
            ('channel = "wrench.torque_y"\ndivide', 'channel = "wrench.torque_yy"\ndivide'),
        ):
            assert right in text
            text = text.replace(right, wrong, 1)
        (self.folder / "mine.toml").write_text(text, encoding="utf-8")

    def do(self, block: Block) -> None:
        if block.file is not None:
            file = self.folder / block.file
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(block.body, encoding="utf-8")
        elif block.language == "python":
            self.python.append(block.body)
        else:
            self.run_python()
            for command in commands(block):
                self.type(block, command)

    def type(self, block: Block, command: Command) -> None:
        line = self._as_tested(command.line)
        wanted = next((code for words, code in ENDINGS.items() if words in "\n".join(command.shown)), 0)
        done = self._bash(line)
        message = f"{block.where}: $ {line}\n{done.stdout}\n{done.stderr}"
        assert done.returncode == wanted, message
        missing = unlike(command.shown, done.stdout + "\n" + done.stderr)
        assert not missing, "shown but not printed:\n" + "\n".join(missing) + "\n\n" + message

    def run_python(self) -> None:
        """Run the Python that has come up since the last command, as one program."""
        if not self.python:
            return
        program, self.python = "\n".join(self.python), []
        if '"run.h5"' in program and not (self.folder / "run.h5").exists():
            shutil.copy(next(self.folder.glob("results/fin-params/*/run.h5")), self.folder)
        (self.folder / ".page.py").write_text(program, encoding="utf-8")
        done = self._bash("forked-python .page.py")
        assert done.returncode == 0, f"{program}\n{done.stderr}"

    def _as_tested(self, line: str) -> str:
        words = line.split()
        if words[:2] == ["pip", "install"]:
            return f"python -m pip install -q --no-deps --no-build-isolation --target {self.site} {words[-1]}"
        parts = line.split(" && ")
        return " && ".join(self._smaller(part) for part in parts)

    def _smaller(self, line: str) -> str:
        words = line.split()
        if line == "labrun run hinge --dry-run --hide random":
            return f"{line} {' '.join(repr(word) for word in HIDING.split(' '))}"
        if line == "labrun run hinge --emulate --limit 1":
            return f"{line} --set trial.duration_s=2"
        if words[0] != "labrun" or words[1] not in RUNS or words[2] not in SMALLER or "sweep.axes" in line:
            return line
        return f"{line} {' '.join(word if word == '--set' else repr(word) for word in SMALLER[words[2]].split(' '))}"

    def _bash(self, line: str) -> subprocess.CompletedProcess[str]:
        environment = {
            **os.environ,
            "PATH": os.pathsep.join(
                map(str, [forked_programs(), Path(sys.executable).parent, os.environ["PATH"]])
            ),
            "PYTHONPATH": os.pathsep.join([str(self.site), os.environ.get("PYTHONPATH", "")]),
            "MPLBACKEND": "Agg",
            "COLUMNS": "100",
        }
        return subprocess.run(
            ["bash", "-euo", "pipefail", "-c", line],
            cwd=self.folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
