"""Compiling ahead reaches every kernel that Python calls, and no two processes write the same kernel's cache."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from armsight.app.compilation import GROUPS, SHARES

CODE = """
import importlib, json, pkgutil, sys
import armsight
import armsight_sim
from numba.core.dispatcher import Dispatcher
from armsight._numba import InnerKernel
from armsight.app.compilation import GROUPS
for name in sys.argv[1:]:
    GROUPS[name]()
used, unused, within = [], [], set()
for package in (armsight, armsight_sim):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if "kernels" in module.name.split("."):
            for name, value in vars(importlib.import_module(module.name)).items():
                if isinstance(value, Dispatcher) and value.py_func.__module__ == module.name:
                    within.update(value.py_func.__code__.co_names)  # compiled together with the kernels that call them
                    if not isinstance(value, InnerKernel):
                        (used if value.signatures else unused).append(module.name + "." + name)
print(json.dumps([used, [name for name in unused if name.rsplit(".", 1)[1] not in within]]))
"""

SELDOM = {
    "render_pattern",  # overlaid boards
    "place_corners",  # --detector xcorner
    "add_rows",  # calibrate timing: small sums
    "rows_times",
    "transposed_times",
}
"""Kernels that are compiled when it comes to it."""


def kernels_of(*groups: str) -> tuple[set[str], set[str]]:
    run = subprocess.run([sys.executable, "-c", CODE, *groups], stdout=subprocess.PIPE, text=True, check=True)
    used, unused = json.loads(run.stdout.splitlines()[-1])
    return set(used), set(unused)


@pytest.mark.timeout(900)
def test_no_kernel_belongs_to_two_processes_and_none_is_left_out() -> None:
    first, second = (kernels_of(*share)[0] for share in SHARES)
    assert first & second == set()
    rest = [name for name in GROUPS if not any(name in share for share in SHARES)]
    third, unused = kernels_of(*rest)
    left_out = {name.rsplit(".", 1)[1] for name in unused - first - second}
    assert left_out <= SELDOM, left_out - SELDOM
    assert len(third) > 20
