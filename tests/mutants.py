"""Would the tests notice? Small faults put into the code one at a time, and the tests run that look at it.

    python tests/mutants.py --count 300 --seed 0 --out mutants.json

A mutant is one change by an operator of cosmic-ray (another operator or number, a negated condition, a removed
decorator). They are drawn at random from `ROOMS`, each place at most once; annotations are left alone. A mutant is
killed when a test fails, does not end in time, or the module no longer imports. Every worker has a copy of the tree of
its own; the run goes on where it was interrupted. Needs the extra `mutants`.
"""

import argparse
import ast
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import Queue
from typing import NamedTuple

import cosmic_ray.plugins
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code

ROOT = Path(__file__).parent.parent
ROOMS = (
    *("physics", "effects", "training/metrics.py", "models/rollout.py"),
    *(f"discovery/{name}.py" for name in ("settings", "select", "verdict", "null", "likelihood")),
)
SECONDS = 240  # a mutant whose tests run longer is killed: they take less on the code as it is
_COPIED = ("pgrssnn_jax", "hydra_plugins", "tests", "conf", "pyproject.toml", "train.py", "discover.py", "report.py")


class Mutant(NamedTuple):
    """line and column: of its place; occurrence: of the operator in the file."""

    path: str
    operator: str
    occurrence: int
    line: int
    column: int

    @property
    def name(self) -> str:
        return f"{self.path}:{self.line}:{self.column} {self.operator}#{self.occurrence}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path, default=Path("mutants.json"))
    arguments = parser.parse_args()
    chosen = drawn(arguments.count, arguments.seed)
    done = json.loads(arguments.out.read_text()) if arguments.out.exists() else {}
    folders: Queue[Path] = Queue()
    with tempfile.TemporaryDirectory() as scratch:
        for k in range(arguments.workers):
            folders.put(copied(Path(scratch) / str(k)))

        def judged(mutant: Mutant) -> None:
            folder = folders.get()
            try:
                done[mutant.name] = outcome(mutant, folder)
            finally:
                folders.put(folder)
            arguments.out.write_text(json.dumps(done, indent=1, sort_keys=True))
            print(f"{len(done)}/{len(chosen)} {done[mutant.name]['outcome']:8} {mutant.name}", flush=True)

        with ThreadPoolExecutor(arguments.workers) as pool:
            list(pool.map(judged, [one for one in chosen if one.name not in done]))
    found = [done[one.name] for one in chosen]
    killed = sum(one["outcome"] != "survived" for one in found)
    print(f"{killed} of {len(found)} mutants killed, {100 * killed / max(1, len(found)):.0f} %")


def drawn(count: int, seed: int) -> list[Mutant]:
    """The places at which each of the operators can act, without annotations; one mutant a place."""
    places: dict[tuple[str, int, int], list[Mutant]] = {}
    for path in sorted(path for room in ROOMS for path in files(ROOT / "pgrssnn_jax" / room)):
        source, name = path.read_text(encoding="utf-8"), str(path.relative_to(ROOT))
        tree, skipped = get_ast(source), annotated(source)
        for operator in cosmic_ray.plugins.operator_names():
            kind = cosmic_ray.plugins.get_operator(operator)
            if kind.arguments():
                continue
            positions = ((start, *rest) for node in ast_nodes(tree) for start, *rest in kind().mutation_positions(node))
            for occurrence, (start, *_) in enumerate(positions):
                if not any(first <= start <= last for first, last in skipped):
                    places.setdefault((name, *start), []).append(Mutant(name, operator, occurrence, *start))
    rng = random.Random(seed)
    return [rng.choice(places[place]) for place in rng.sample(sorted(places), min(count, len(places)))]


def files(path: Path) -> list[Path]:
    return [path] if path.is_file() else [one for one in path.rglob("*.py") if one.name != "__init__.py"]


def annotated(source: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Begin and end of every annotation: what they say, type checkers check."""
    found = []
    for node in ast.walk(ast.parse(source)):
        for part in (getattr(node, "annotation", None), getattr(node, "returns", None)):
            if part is not None:
                found.append(((part.lineno, part.col_offset), (part.end_lineno, part.end_col_offset)))
    return found


def copied(folder: Path) -> Path:
    folder.mkdir()
    for name in _COPIED:
        here, there = ROOT / name, folder / name
        shutil.copytree(here, there, ignore=shutil.ignore_patterns("__pycache__")) if here.is_dir() else shutil.copy(
            here, there
        )
    return folder


def tests_of(path: str) -> list[str]:
    """Tests that import the module: those in the room of the same name, else the others, else all of that room."""
    module = path.removesuffix(".py").replace("/", ".")
    room = ROOT / "tests" / Path(path).relative_to("pgrssnn_jax").parent
    pattern = re.compile(rf"\bfrom {re.escape(module)} import|\bimport {re.escape(module)}\b")
    tests = sorted((ROOT / "tests").rglob("test_*.py"))
    importing = [one for one in tests if pattern.search(one.read_text(encoding="utf-8"))]
    own = [one for one in importing if one.parent == room]
    return [str(one.relative_to(ROOT)) for one in own or importing or sorted(room.glob("test_*.py"))]


def outcome(mutant: Mutant, folder: Path) -> dict[str, str]:
    path = folder / mutant.path
    source = path.read_text(encoding="utf-8")
    changed = mutate_code(source, cosmic_ray.plugins.get_operator(mutant.operator)(), mutant.occurrence)
    assert changed is not None, mutant
    before, after = source.splitlines(), changed.splitlines()
    lines = [f"{a.strip()} -> {b.strip()}" for a, b in zip(before, after, strict=False) if a != b][:1]
    path.write_text(changed, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-x", "-n", "0", "-q", "-p", "no:cacheprovider", *tests_of(mutant.path)]
    environment = {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        ended = subprocess.run(command, cwd=folder, env=environment, timeout=SECONDS, capture_output=True, text=True)
        result = "survived" if ended.returncode == 0 else "killed"
    except subprocess.TimeoutExpired:
        result = "timeout"
    finally:
        path.write_text(source, encoding="utf-8")
    return {"outcome": result, "change": lines[0] if lines else ""}


if __name__ == "__main__":
    main()
