"""Compiling ahead reaches every kernel that Python calls, and no two processes write the same kernel's cache."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from armsight.errors import Cancelled
from armsight.ops.compilation import GROUPS, SHARES, compile_all
from armsight.records import Silent

CODE = """
import importlib, json, os, pkgutil, sys
import armsight
import armsight_sim
from numba.core.dispatcher import Dispatcher
from armsight._numba import InnerKernel
from armsight.ops.compilation import GROUPS
modules = [
    importlib.import_module(module.name)
    for package in (armsight, armsight_sim)
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + ".")
    if "kernels" in module.name.split(".")
]
for share in json.loads(sys.argv[1]):
    if child := os.fork():
        assert os.waitpid(child, 0)[1] == 0
        continue
    for name in share:
        GROUPS[name]()
    used, unused, within = [], [], set()
    for module in modules:
        for name, value in vars(module).items():
            if isinstance(value, Dispatcher) and value.py_func.__module__ == module.__name__:
                within.update(value.py_func.__code__.co_names)  # compiled together with the kernels that call them
                if not isinstance(value, InnerKernel):
                    (used if value.signatures else unused).append(module.__name__ + "." + name)
    print(json.dumps([used, [name for name in unused if name.rsplit(".", 1)[1] not in within]]), flush=True)
    os._exit(0)
"""

SELDOM = {
    "render_pattern",  # overlaid boards
    "place_corners",  # --detector xcorner
    "add_rows",  # calibrate timing: small sums
    "rows_times",
    "add_transposed_times",
}
"""Kernels that are compiled when it comes to it."""


@pytest.mark.timeout(900)
def test_no_kernel_belongs_to_two_processes_and_none_is_left_out() -> None:
    """Each share is compiled in a fork of a process that has imported all, and compiled nothing."""
    rest = [name for name in GROUPS if not any(name in share for share in SHARES)]
    shares = [*map(list, SHARES), rest]
    run = subprocess.run(
        [sys.executable, "-c", CODE, json.dumps(shares)], stdout=subprocess.PIPE, text=True, check=True
    )
    told = [json.loads(line) for line in run.stdout.splitlines() if line.startswith("[[")]
    (first, second, third), unused = (set(used) for used, _ in told), set(told[-1][1])
    assert first & second == set()
    left_out = {name.rsplit(".", 1)[1] for name in unused - first - second}
    assert left_out <= SELDOM, left_out - SELDOM
    assert len(third) > 20


class Heard(Silent):
    """Keeps what it is told; wants to stop after so many groups."""

    def __init__(self, most: float = np.inf) -> None:
        self.notes: list[str] = []
        self.most = most

    def update(self, done: float, total: float, note: str = "") -> None:
        self.notes.append(f"{done:g} of {total:g} {note}")
        self.most -= done > 0

    def cancelled(self) -> bool:
        return self.most <= 0


def test_compiling_tells_each_group_and_can_be_stopped() -> None:
    heard = Heard(most=1)
    with pytest.raises(Cancelled) as stopped:
        compile_all(heard, ("guard", "measure"))
    assert "measure" in str(stopped.value)
    assert heard.notes == ["0 of 2 compiling", "1 of 2 compiling: guard"]
