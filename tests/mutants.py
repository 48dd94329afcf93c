"""Would the tests notice? Small faults put into the code one at a time, and the tests run that could see them.

    make coverage                                                            which test runs which line, and how long
    python tests/mutants.py --count 300 --seed 0 --out mutants.json

A mutant is one change by an operator of cosmic-ray (another operator or number, a negated condition, a removed
decorator). They are drawn at random from `ROOMS`, each place at most once; annotations are left alone. A mutant is
killed when a test fails that passes on the code as it is, when the tests do not end in time, or the module no longer
imports. Every worker has a copy of the tree of its own; the run goes on where it was interrupted. Changes that no test
can notice stand in `mutants_equivalent.json`, each with its reason, and are counted apart. Needs the extra `mutants`.
"""

import argparse
import ast
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import Queue
from typing import Any, NamedTuple

import cosmic_ray.plugins
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from mutant_tests import BUDGET, ROOT, Measured, measured, tests_for
from scipy.stats import binomtest

ROOMS = (
    *("physics", "effects", "training/metrics.py", "models/rollout.py"),
    *(f"discovery/{name}.py" for name in ("settings", "select", "verdict", "null", "likelihood")),
)
SECONDS = int(10 * BUDGET)  # of processor time: a mutant whose tests need more is killed
EQUIVALENT = Path(__file__).with_name("mutants_equivalent.json")


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
    parser.add_argument("--minutes", type=float, default=60.0, help="no mutant begins later")
    parser.add_argument("--under", default="", help="of the sample, those in modules whose path begins so")
    parser.add_argument("--coverage", type=Path, default=ROOT / ".coverage")
    parser.add_argument("--times", type=Path, nargs="*", default=[ROOT / ".coverage_times.xml"])
    parser.add_argument("--out", type=Path, default=Path("mutants.json"))
    arguments = parser.parse_args()
    ends = time.monotonic() + 60 * arguments.minutes
    chosen = [one for one in drawn(arguments.count, arguments.seed) if one.path.startswith(arguments.under)]
    done = json.loads(arguments.out.read_text()) if arguments.out.exists() else {}
    folders: Queue[Path] = Queue()
    with tempfile.TemporaryDirectory() as scratch:
        for k in range(arguments.workers):
            folders.put(copied(Path(scratch) / str(k)))
        whole = copied(Path(scratch) / "whole")
        known = measured(arguments.coverage, arguments.times, collected(whole))

        def judged(mutant: Mutant) -> None:
            if time.monotonic() > ends:
                return
            folder = folders.get()
            try:
                done[mutant.name] = outcome(mutant, folder, known)
            finally:
                folders.put(folder)
            arguments.out.write_text(json.dumps(done, indent=1, sort_keys=True))
            print(f"{len(done)}/{len(chosen)} {done[mutant.name]['outcome']:8} {mutant.name}", flush=True)

        with ThreadPoolExecutor(arguments.workers) as pool:
            list(pool.map(judged, [one for one in chosen if one.name not in done]))
        found = {one.name: done[one.name] for one in chosen if one.name in done}
        told(found, len(chosen), unreliable(found, whole))


def told(found: dict[str, dict[str, Any]], planned: int, without: set[str]) -> None:
    """The share of killed mutants, and a table of the others. without: tests that fail on the code as it is."""
    survived = {name: one for name, one in found.items() if one["outcome"] == "survived" or one["by"] in without}
    same = {name: reason for name, one in survived.items() if (reason := equivalent(name, one["change"]))}
    for name, one in survived.items():
        print(
            f"{'equivalent' if name in same else 'survived':10} {name}\n    {one['change']}\n    {same.get(name, '')}"
        )
    killed, late = len(found) - len(survived), sum(one["outcome"] == "timeout" for one in found.values())
    for count, words in ((len(found), "mutants"), (len(found) - len(same), "mutants that are not equivalent")):
        low, high = binomtest(killed, count).proportion_ci(method="wilson") if count else (0.0, 1.0)
        share = killed / max(1, count)
        print(f"{killed} of {count} {words} killed, {share:.1%} (95 % interval {low:.1%} to {high:.1%})")
    print(f"{late} of them by time; {len(same)} equivalent; {planned - len(found)} of {planned} not tried")


def equivalent(name: str, change: str) -> str:
    """Why no test can notice a change; "" for every other one."""
    for one in json.loads(EQUIVALENT.read_text(encoding="utf-8")):
        if name.startswith(one["path"]) and re.fullmatch(one["pattern"], change):
            return one["reason"]
    return ""


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
    """Everything that git keeps, and what is new; tests read documents and configurations too."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    )
    for name in filter(None, listed.stdout.decode().split("\0")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name)
    return folder


def collected(folder: Path) -> list[str]:
    """Names of all tests."""
    found = pytest(folder, ["--collect-only", "tests"], None).stdout
    names = [line for line in found.splitlines() if "::" in line]
    assert names, found
    return names


def pytest(folder: Path, arguments: list[str], seconds: int | None) -> subprocess.CompletedProcess[str]:
    """In one process, which may use so much of the processor. Programs that were compiled before, of this copy, are
    found again."""
    limit = f"resource.setrlimit(resource.RLIMIT_CPU, ({seconds}, {seconds}));" if seconds else ""
    call = f"import resource, sys, pytest; {limit} sys.exit(pytest.main(sys.argv[1:]))"
    options = ["-n", "0", "--tb=no", "-p", "no:cacheprovider"]
    environment = {
        **os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1",
        "JAX_COMPILATION_CACHE_DIR": str(folder / ".jax_cache"),
    }  # fmt: skip
    return subprocess.run(
        [sys.executable, "-c", call, *options, *arguments], cwd=folder, env=environment, capture_output=True, text=True
    )


def unreliable(found: dict[str, dict[str, Any]], whole: Path) -> set[str]:
    """Tests that killed a mutant, and fail on the code as it is too."""
    by = sorted({one["by"] for one in found.values() if one["by"]})
    return set(failed(pytest(whole, by, None).stdout)) if by else set()


def failed(output: str) -> list[str]:
    return [
        line.split(" - ")[0].split(" ", 1)[1] for line in output.splitlines() if line.startswith(("FAILED ", "ERROR "))
    ]


def outcome(mutant: Mutant, folder: Path, known: Measured) -> dict[str, Any]:
    path = folder / mutant.path
    source = path.read_text(encoding="utf-8")
    changed = mutate_code(source, cosmic_ray.plugins.get_operator(mutant.operator)(), mutant.occurrence)
    assert changed is not None, mutant
    before, after = source.splitlines(), changed.splitlines()
    lines = [f"{a.strip()} -> {b.strip()}" for a, b in zip(before, after, strict=False) if a != b][:1]
    change = lines[0] if lines else ""
    if equivalent(mutant.name, change):
        return {"outcome": "survived", "change": change, "by": "", "seconds": 0.0}
    path.write_text(changed, encoding="utf-8")
    started = time.monotonic()
    try:
        ended = pytest(folder, ["-x", *tests_for(mutant.path, mutant.line, known)], SECONDS)
    finally:
        path.write_text(source, encoding="utf-8")
    by = next(iter(failed(ended.stdout)), "")
    if ended.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        result = "timeout"
        shutil.rmtree(folder / ".jax_cache", ignore_errors=True)  # a program may be half written
    else:
        result = "killed" if ended.returncode else "survived"
    return {"outcome": result, "change": change, "by": by, "seconds": round(time.monotonic() - started, 1)}


if __name__ == "__main__":
    main()
