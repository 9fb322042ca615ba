"""Shared by the benchmarks: interleaved timing, and tables in Markdown with the machine they ran on."""

from __future__ import annotations

import importlib.util
import os
import platform
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import ModuleType

import numpy as np

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
"""Real recordings by other people; benchmarks skip what is not there, and say so."""


def interleaved_ms(runs: Mapping[str, Callable[[], object]], repeats: int, warm_up: int = 3) -> dict[str, np.ndarray]:
    """Return the times in ms of each function, run in turn A B A B so that a drifting machine hits all alike."""
    for function in runs.values():
        for _ in range(warm_up):
            function()
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repeats):
        for name, function in runs.items():
            start = time.perf_counter()
            function()
            times[name].append((time.perf_counter() - start) * 1e3)
    return {name: np.array(values) for name, values in times.items()}


def table(title: str, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a Markdown table."""
    print(f"\n### {title}\n")
    print("| " + " | ".join(header) + " |")
    print("|" + "---|" * len(header))
    for row in rows:
        print("| " + " | ".join(f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row) + " |")


def machine() -> str:
    """Return one line on the machine and the date."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line.split(":")[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")]
        model = names[0] if names else model
    return f"{time.strftime('%Y-%m-%d')}, {model}, {os.cpu_count()} cores, Python {platform.python_version()}"


def test_scene(name: str) -> ModuleType:
    """Return the module of tests/truth with this name, whose recordings are made there."""
    path = Path(__file__).resolve().parents[1] / "tests" / "truth" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(f"{name}_scene", path)
    if spec is None or spec.loader is None:
        raise SystemExit(f"no {path}")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    sys.path += [str(path.parents[1]), str(path.parent)]  # what the tests share
    spec.loader.exec_module(module)
    return module
