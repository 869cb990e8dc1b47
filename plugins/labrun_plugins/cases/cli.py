"""The command line: make sealed cases, or check answers against their seal."""

import argparse
import secrets
import shutil
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

from .case import Asked, make_case
from .mixture import COLOURS, DECK
from .robots.case import make_robot
from .writing import SEAL, seal, verify

ROBOTS = "robot"
"""Kind of cases that are whole robots; never in the mixture."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(prog="labrun_plugins.cases", description=__doc__, allow_abbrev=False)
    parser.add_argument("--cases", type=int, default=60, metavar="N", help="how many cases to make")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="below 1000: development")
    parser.add_argument("--first", type=int, default=1, metavar="K", help="number of the first case, from 1")
    parser.add_argument(
        "--only", choices=(*DECK, ROBOTS), help="make cases of this kind alone, not the mixture"
    )
    parser.add_argument(
        "--repeats", type=int, metavar="N", help="repeats of every condition, not those drawn"
    )
    parser.add_argument("--conditions", type=int, metavar="N", help="how many, not those drawn (4 to 10)")
    parser.add_argument("--noise", choices=tuple(COLOURS), help="the colour of all noise, not one drawn")
    parser.add_argument(
        "--zeros",
        action=argparse.BooleanOptionalAction,
        help="whether each trial has a zero of its own; drawn if not given",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="a folder that is new or empty")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes")
    parser.add_argument(
        "--salt", default="", metavar="HEX", help="of an earlier seal, to get the same one again"
    )
    parser.add_argument(
        "--verify", type=Path, metavar="DIR", help="check the answers in DIR against their seal"
    )
    given = parser.parse_args(arguments)
    if given.verify:
        return _verify(given.verify)
    if given.out is None:
        parser.error("--out DIR is needed (or --verify DIR)")
    if any(number is not None and number < 1 for number in (given.repeats, given.conditions)):
        parser.error("--repeats and --conditions are 1 or more")
    if given.cases < 1 or given.first < 1 or given.workers < 1 or given.seed < 0:
        parser.error("--cases, --first and --workers are 1 or more, --seed is 0 or more")
    if given.out.exists() and any(given.out.iterdir()):
        parser.error(f"{given.out} is not empty; name a new folder")
    return _make(given.out, given.seed, range(given.first - 1, given.first - 1 + given.cases), given)


def _make(folder: Path, seed: int, indices: range, given: argparse.Namespace) -> int:
    # nobody sees a case before its seal: everything is made beside, and moved when the seal is printed
    making = folder.with_name(folder.name + ".making")
    shutil.rmtree(making, ignore_errors=True)
    making.mkdir(parents=True)
    try:
        asked = Asked(given.only, given.repeats, given.noise, given.zeros, given.conditions)
        make = (
            partial(make_robot, seed, folder=making)
            if given.only == ROBOTS
            else partial(make_case, seed, folder=making, asked=asked)
        )
        if given.workers == 1:
            for index in indices:
                _tell(make(index), indices)
        else:
            with ProcessPoolExecutor(given.workers) as pool:
                for name in pool.map(make, indices):
                    _tell(name, indices)
        content = seal(making, given.salt or secrets.token_hex(16))
        if folder.exists():
            folder.rmdir()
        making.rename(folder)
    except BaseException:
        shutil.rmtree(making, ignore_errors=True)
        raise
    kinds = f", {given.only} alone" if given.only else ""
    message = f"{len(indices)} answers, seed {seed}{kinds}; sha256 with salt, one by one in {folder / SEAL}"
    print(f"seal {content['all']}  ({message})", flush=True)
    return 0


def _tell(name: str, indices: range) -> None:
    done = int(name.rpartition("-")[2]) - indices.start
    print(f"made {name} ({done} of {len(indices)})", file=sys.stderr, flush=True)


def _verify(folder: Path) -> int:
    faults = verify(folder)
    for fault in faults:
        print(fault)
    if not faults:
        print(f"{folder}: every answer is the one that was sealed")
    return 1 if faults else 0
