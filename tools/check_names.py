#!/usr/bin/env python3
"""Report names that do not say what they hold: variables, parameters, attributes, functions and classes."""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

BANNED = {"one", "found", "place", "told", "said", "begun", "beside"}
CHECKED = ["labrun", "plugins", "tests", "benchmarks", "tools"]
KEYS_OF_FILES = {("labrun/fit/crossing.py", "one"), ("labrun/experiment/search_tables.py", "beside")}
"""Attributes named after a key that users write in their experiments."""


def names_bound_by(node: ast.AST) -> Iterator[str]:
    """Yield the names that a node of the syntax tree introduces."""
    match node:
        case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
            yield name
        case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
            yield name
        case ast.arg(arg=name):
            yield name
        case ast.alias(name=name, asname=alias):
            yield alias or name
        case ast.ExceptHandler(name=str(name)) | ast.MatchAs(name=str(name)) | ast.MatchStar(name=str(name)):
            yield name
        case _:
            pass


def main() -> int:
    """Print every banned name with its file and line; return 1 if any is left."""
    project = Path(__file__).parents[1]
    problems = 0
    for root in CHECKED:
        for source in sorted((project / root).rglob("*.py")):
            file = source.relative_to(project).as_posix()
            for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
                for name in names_bound_by(node):
                    if name in BANNED and (file, name) not in KEYS_OF_FILES:
                        print(f"{file}:{getattr(node, 'lineno', 0)}: rename {name!r} after what it holds")
                        problems += 1
    return int(problems > 0)


if __name__ == "__main__":
    sys.exit(main())
