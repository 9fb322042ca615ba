"""Plants the faults of mutants.yaml one at a time in a copy of this checkout, and runs the tests that should find them.

    python tools/mutants.py [--table FILE] [--only NAME ...] [--list] [--json FILE]

The oracle of a change of the tests: what they found before it they must find after it. Prints a table of the faults
with the first test that fails, or MISSED. All tests named run once without a fault first, and must pass. Exits 1 where
a fault is missed, 2 where the table does not fit the source. Half an hour; nothing here is changed.

--table tools/ablation.yaml switches branches of the measuring and calibrating code off in the same way: one that is
missed and has no reason to stay changes nothing that anyone sees, and can go.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parent.parent
FAULTS = Path(__file__).with_suffix(".yaml")
SOURCES = ("src", "sim/src", "plant/src", "lab/src")
LIMIT_S = 300.0
"""A fault after which the tests do not end within this is found: it hangs."""
PYTEST = ("-m", "pytest", "-x", "-q", "-p", "no:xdist", "-p", "no:cacheprovider", "--hypothesis-seed=0")
FIRST = re.compile(r"^(?:FAILED|ERROR) (tests/.+?)(?: - |$)", re.MULTILINE)
PASSED, FAILED, INTERRUPTED = 0, 1, 2
"""Exit codes of pytest; all others mean that it was asked for something that is not there."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """A text of a file that is there once, what stands in its place, what that breaks, and the tests to find it.

    found_by: the test that found it last. stays: why what it switches off stays, where no test finds it.
    """

    name: str
    file: str
    old: str
    new: str
    breaks: str
    tests: tuple[str, ...]
    found_by: str = ""
    stays: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What became of a run of tests: the first that failed, or that they hang; nothing where all passed."""

    found_by: str
    took_s: float


def read_faults(path: Path = FAULTS) -> list[Fault]:
    """Return the faults of a table, branches that are gone left out.

    Raises TypeError for a fault that lacks a key or has one more.
    """
    rows = yaml.safe_load(path.read_text(encoding="utf-8"))
    return [Fault(**{**row, "tests": tuple(row["tests"])}) for row in rows if "gone" not in row]


def misfits(faults: Sequence[Fault], root: Path = ROOT) -> list[str]:
    """Return what of a table does not fit the checkout: cause, consequence, cure."""
    found = []
    names = [fault.name for fault in faults]
    for fault in faults:
        file = root / fault.file
        count = file.read_text(encoding="utf-8").count(fault.old) if file.is_file() else 0
        if count != 1:
            where = f"stands {count} times in {fault.file}" if file.is_file() else f"has no file {fault.file}"
            found.append(
                f"{fault.name}: the text to replace {where}. It is not planted. Write it anew as it stands now."
            )
        found += [
            f"{fault.name}: {test} is not there. Nothing would find it. Name the tests that should."
            for test in fault.tests
            if not (root / test.split("::")[0]).exists()
        ]
        if fault.old == fault.new or not fault.tests or names.count(fault.name) > 1:
            found.append(f"{fault.name}: changes nothing, has no tests, or is there twice. Correct its row.")
    return found


def copied(source: Path, goal: Path) -> Path:
    """Copy a checkout with the caches of its kernels, which stay valid as the times of files are kept; return it."""

    def hidden(folder: str, names: list[str]) -> set[str]:
        return {name for name in names if Path(folder) == source and name.startswith(".") and name != ".ci"}

    return Path(shutil.copytree(source, goal, symlinks=True, ignore=hidden))


def plant(fault: Fault, tree: Path, importers: Callable[[str], Iterable[str]]) -> None:
    """Put a fault into a copy; the compiled kernels of all that imports the file go, as they hold it compiled in.

    numba looks only at a kernel's own file to tell whether it is compiled anew.
    """
    file = tree / fault.file
    file.write_text(file.read_text(encoding="utf-8").replace(fault.old, fault.new), encoding="utf-8")
    for name in importers(fault.file):
        path = tree / name
        for cache in (path.parent / "__pycache__").glob(f"{path.stem}.*.nb[ic]"):
            cache.unlink()


def imports(root: Path) -> dict[str, set[str]]:
    """Return what each source file imports of the others, by their places below root."""
    files = {}
    for source in SOURCES:
        for path in sorted((root / source).rglob("*.py")):
            parts = path.relative_to(root / source).with_suffix("").parts
            files[".".join(parts).removesuffix(".__init__")] = path
    found: dict[str, set[str]] = {}
    for path in files.values():
        named = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                named |= {str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names)}
            elif isinstance(node, ast.Import):
                named |= {alias.name for alias in node.names}
        found[str(path.relative_to(root))] = {str(files[name].relative_to(root)) for name in named if name in files}
    return found


def importers_of(file: str, graph: Mapping[str, set[str]]) -> set[str]:
    """Return the files that import a file, directly or through others, and itself."""
    reached, left = {file}, [file]
    while left:
        one = left.pop()
        new = {name for name, of in graph.items() if one in of} - reached
        reached |= new
        left += sorted(new)
    return reached


def run_tests(tree: Path, tests: Iterable[str], limit_s: float | None) -> Outcome:
    """Run tests in a copy until the first fails. Raises ValueError where pytest could not run them."""
    paths = os.pathsep.join(str(tree / source) for source in SOURCES)
    # Python takes a compiled file for that of a source of the same second and size, which a fault may be
    env = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    env |= {"PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1"}
    began = time.monotonic()
    with subprocess.Popen(
        [sys.executable, *PYTEST, *tests],
        cwd=tree,
        env=env,
        start_new_session=True,
        text=True,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    ) as running:
        try:
            told, _ = running.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired:
            return Outcome(found_by=f"hangs: not done after {limit_s:g} s", took_s=time.monotonic() - began)
        finally:
            if running.poll() is None:
                os.killpg(running.pid, signal.SIGKILL)
    first = FIRST.search(told)
    if running.returncode not in (PASSED, FAILED, INTERRUPTED) or (running.returncode and first is None):
        raise ValueError(f"pytest ended with {running.returncode}: {told[-2000:]}")
    return Outcome(found_by=first[1] if first and running.returncode else "", took_s=time.monotonic() - began)


def try_faults(faults: Sequence[Fault], folder: Path, root: Path = ROOT) -> Iterable[tuple[Fault, Outcome]]:
    """Yield what became of each fault. Raises ValueError where a test fails without one."""
    graph = imports(root)
    sound = copied(root, folder / "sound")
    if (root.parent / "shared").exists():  # the real data that lie beside the checkout
        (folder / "shared").symlink_to((root.parent / "shared").resolve())
    tests = sorted({test for fault in faults for test in fault.tests})
    without = run_tests(sound, tests, None)
    if without.found_by:
        raise ValueError(f"{without.found_by} fails without a fault. What it finds means nothing. Mend it first.")
    print(f"\n{len(tests)} places of tests pass without a fault, in {without.took_s:.0f} s\n", flush=True)
    for fault in faults:
        tree = copied(sound, folder / fault.name)
        plant(fault, tree, lambda file: importers_of(file, graph))
        yield fault, run_tests(tree, fault.tests, LIMIT_S)
        shutil.rmtree(tree)


def main() -> int:
    """Plant the faults and print what became of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--table", type=Path, metavar="FILE", default=FAULTS, help="the faults to plant")
    parser.add_argument("--only", metavar="NAME", nargs="+", help="plant these faults alone")
    parser.add_argument("--list", action="store_true", help="print the faults and plant none")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the outcomes as well")
    asked = parser.parse_args()
    faults = [fault for fault in read_faults(asked.table) if not asked.only or fault.name in asked.only]
    wrong = misfits(faults) or sorted(set(asked.only or ()) - {fault.name for fault in faults})
    if wrong:
        print("\n".join(wrong), file=sys.stderr)
        return 2
    if asked.list:
        print("\n".join(f"{fault.name}: {fault.breaks} ({fault.file})" for fault in faults))
        return 0
    outcomes: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        for fault, outcome in try_faults(faults, Path(folder)):
            if not outcomes:
                print("| fault | file | found by | s |\n|---|---|---|---|")
            told = outcome.found_by or (f"missed, and stays: {fault.stays}" if fault.stays else "MISSED")
            print(f"| {fault.name} | {fault.file} | {told} | {outcome.took_s:.0f} |", flush=True)
            outcomes.append({"name": fault.name, "file": fault.file, "stays": fault.stays, **asdict(outcome)})
    found = sum(bool(outcome["found_by"] or outcome["stays"]) for outcome in outcomes)
    print(f"\nfound {found} of {len(outcomes)}")
    if asked.json:
        asked.json.write_text(json.dumps(outcomes, indent=1) + "\n", encoding="utf-8")
    return 0 if found == len(outcomes) else 1


if __name__ == "__main__":
    raise SystemExit(main())
