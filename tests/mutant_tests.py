"""Which tests could notice a fault in a line: those that ran it when coverage was measured, the fastest first.

    python -m pytest --cov --cov-context=test --junitxml=.coverage_times.xml        or: make coverage

A function that is compiled runs in the first test of a process alone, so that the measurement names one of several
tests: behind those that ran the line stand all tests of their files, and those of the module's own room.
"""

import ast
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

from coverage import CoverageData

ROOT = Path(__file__).parent.parent
# Seconds that the tests of a mutant took when they were measured, beside those that ran its line, which may take four
# times as long: what kills it after them is not seen.
BUDGET = 60.0
_PACKAGE = "pgrssnn_jax"


class Measured(NamedTuple):
    """lines: tests by the number of the line, by the module; seconds: of every test that passed."""

    lines: Mapping[str, Mapping[int, frozenset[str]]]
    seconds: Mapping[str, float]


def measured(data: Path, times: Iterable[Path], there: Iterable[str]) -> Measured:
    """From the files of a measurement, without tests that are no longer there."""
    seconds, kept = dict(_seconds(times)), set(there)
    passed = {name: seconds[name] for name in seconds if name in kept}
    lines: dict[str, dict[int, frozenset[str]]] = {}
    found = CoverageData(str(data))
    found.read()
    for file in found.measured_files():
        of_file = lines.setdefault(f"{_PACKAGE}/{file.rpartition(f'/{_PACKAGE}/')[2]}", {})
        for line, contexts in found.contexts_by_lineno(file).items():
            names = {context.rpartition("|")[0] for context in contexts}
            of_file[line] = of_file.get(line, frozenset()) | (names & passed.keys())
    return Measured(lines, passed)


def _seconds(times: Iterable[Path]) -> Iterator[tuple[str, float]]:
    for path in times:
        for case in ET.parse(path).iter("testcase"):
            if not {child.tag for child in case} & {"failure", "error", "skipped"}:
                name = f"{case.attrib['classname'].replace('.', '/')}.py::{case.attrib['name']}"
                yield name, float(case.attrib["time"])


def tests_for(path: str, line: int, known: Measured) -> list[str]:
    """Names for pytest, in the order in which they are to run; whole files where nothing was measured."""
    lines = known.lines.get(path, {})
    parts = ({name for k in span for name in lines.get(k, ())} for span in _spans(path, line))
    ran = next((names for names in parts if names), set())
    room = set(tests_of(path))
    others = {name for name in known.seconds if _file(name) in room | {_file(one) for one in ran}} - ran
    chosen = [*_within(ran, 4 * BUDGET, known), *_within(others, BUDGET, known)]
    return chosen or sorted(room)


def _within(names: Iterable[str], seconds: float, known: Measured) -> list[str]:
    """The fastest of the tests, as many as end in time, one at least."""
    ordered = sorted(names, key=known.seconds.__getitem__)
    ends = accumulate(known.seconds[name] for name in ordered)
    return [name for k, (name, end) in enumerate(zip(ordered, ends, strict=True)) if not k or end <= seconds]


def _file(name: str) -> str:
    return name.partition("::")[0]


def _spans(path: str, line: int) -> list[range]:
    """The line, the statements around it from the innermost to the outermost, and the whole module."""
    source = (ROOT / path).read_text(encoding="utf-8")
    around = [
        range(min([node.lineno, *(d.lineno for d in getattr(node, "decorator_list", ()))]), (node.end_lineno or 0) + 1)
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.stmt)
    ]
    return [range(line, line + 1), *sorted((s for s in around if line in s), key=len), range(len(source.splitlines()))]


@cache
def tests_of(path: str) -> tuple[str, ...]:
    """Files that import the module: those in the room of the same name, else the others, else all of that room."""
    module = path.removesuffix(".py").replace("/", ".")
    room = ROOT / "tests" / Path(path).relative_to(_PACKAGE).parent
    pattern = re.compile(rf"\bfrom {re.escape(module)} import|\bimport {re.escape(module)}\b")
    tests = sorted((ROOT / "tests").rglob("test_*.py"))
    importing = [one for one in tests if pattern.search(one.read_text(encoding="utf-8"))]
    own = [one for one in importing if one.parent == room]
    return tuple(str(one.relative_to(ROOT)) for one in own or importing or sorted(room.glob("test_*.py")))
