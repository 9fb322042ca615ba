"""The first minute: what compiling costs on a machine where nothing is compiled yet.

Each group of kernels in a process of its own with an empty cache, then all in one process, then all as `make install`
and `make demo` do, in two; then what is left to wait for with everything compiled. --worst N lists the kernels that
cost most: without and with what they call, seconds, signatures.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from numba.core import event

import bench
from armsight.ops.compilation import GROUPS

PAIRS, RUNS = 10, 5
AHEAD = {"all in two processes (make install)": (), "what the demo runs, in two (make demo)": ("demo",)}


class Compilations(event.Listener):
    """Seconds of processor time of each kernel, without and with its callees, by signature."""

    def __init__(self) -> None:
        self.open: list[list[Any]] = []
        self.kernels: dict[str, list[list[float]]] = {}

    def on_start(self, e: event.Event) -> None:
        function = e.data["dispatcher"].py_func
        name = f"{function.__module__.removeprefix('armsight.')}.{function.__name__}"
        self.open.append([name, time.process_time(), 0.0])

    def on_end(self, _: event.Event) -> None:
        name, start, inner = self.open.pop()
        seconds = time.process_time() - start
        self.kernels.setdefault(name, []).append([seconds - inner, seconds])
        if self.open:
            self.open[-1][2] += seconds


def compile_here(names: list[str]) -> None:
    """Compile groups in this process and print what it cost as JSON."""
    compilations = Compilations()
    event.register("numba:compile", compilations)
    for name in names:
        GROUPS[name]()
    print(json.dumps(compilations.kernels))


def cold(names: list[str]) -> tuple[list[float], dict[str, list[list[float]]]]:
    """Return processor and wall seconds of a process with an empty cache, seconds of compiling, number; the kernels."""
    with tempfile.TemporaryDirectory() as cache:
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        text = subprocess.run(
            [sys.executable, __file__, "--here", *names],
            env=os.environ | {"NUMBA_CACHE_DIR": cache},
            stdout=subprocess.PIPE,
            check=True,
            text=True,
        ).stdout
        wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    kernels = json.loads(text)
    own = sum(times[0] for signatures in kernels.values() for times in signatures)
    number = sum(map(len, kernels.values()))
    return [after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall, own, number], kernels


def seconds(*words: object, cache: str | None = None) -> list[float]:
    """Return processor and wall seconds of `python words`."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(
        [sys.executable, *map(str, words)],
        env=os.environ | ({"NUMBA_CACHE_DIR": cache} if cache else {}),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=True,
    )
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return [after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall]


def ahead(*words: str) -> list[float]:
    """Return processor and wall seconds of compiling ahead with an empty cache."""
    with tempfile.TemporaryDirectory() as cache:
        return seconds("-m", "armsight.ops.compilation", *words, cache=cache)


def compiled() -> list[list[object]]:
    """Return what commands take where they have run before, in turn, the best of RUNS each."""
    with tempfile.TemporaryDirectory() as name:
        cell, out, cache = Path(name) / "cell", Path(name) / "out", f"{name}/cache"
        seconds("-m", "armsight.ops.compilation", "demo", cache=cache)
        seconds("-m", "armsight", "simulate", "hand-cell", "--frames", PAIRS, "-o", cell, cache=cache)
        files = [f"--{what}={cell / what}.yaml" for what in ("rig", "target")]
        views = [f"--{side}={cell / side}/*.png" for side in ("left", "right")]
        commands = {
            "armsight --help": ["--help"],
            f"armsight measure, {PAIRS} pairs": ["measure", *files, *views, "-o", out, "--overwrite"],
        }
        runs = {name: ["-m", "armsight", *words] for name, words in commands.items()}
        runs["importing numpy, scipy, numba, OpenCV"] = ["-c", "import numpy, scipy.spatial.transform, numba, cv2"]
        found: dict[str, list[list[float]]] = {name: [] for name in runs}
        for _ in range(RUNS):
            for name, words in runs.items():
                found[name].append(seconds(*words, cache=cache))
        return [[name, *map(min, zip(*times, strict=True))] for name, times in found.items()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worst", type=int, default=0, help="list so many kernels")
    parser.add_argument("--quick", action="store_true", help="only all groups in one process")
    parser.add_argument("--here", nargs="+", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.here:
        compile_here(arguments.here)
        return
    print(bench.machine())
    rows: list[list[object]] = []
    if not arguments.quick:
        rows += [[name, *cold([name])[0]] for name in GROUPS]
    whole, kernels = cold(list(GROUPS))
    rows.append(["all in one process", *whole])
    if not arguments.quick:
        rows += [[what, *ahead(*words), "", ""] for what, words in AHEAD.items()]
    bench.table("Cold start", ("group", "processor s", "wall s", "of it compiling s", "compilations"), rows)
    if not arguments.quick:
        bench.table("With everything compiled", ("command", "processor s", "wall s"), compiled())
    if arguments.worst:
        worst = sorted(kernels.items(), key=lambda item: -sum(times[0] for times in item[1]))[: arguments.worst]
        bench.table(
            "Kernels that cost most",
            ("kernel", "own s", "with callees s", "signatures"),
            [[name, sum(t[0] for t in times), sum(t[1] for t in times), len(times)] for name, times in worst],
        )


if __name__ == "__main__":
    main()
