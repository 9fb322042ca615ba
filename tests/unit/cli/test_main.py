"""What the command line sets before anything is imported."""

import os
import subprocess
import sys

import pytest

import armsight.cli
import armsight.cli.commands


@pytest.mark.parametrize(("said", "kept"), [(None, "1"), ("3", "3")])
def test_linear_algebra_has_one_thread_unless_the_user_says_otherwise(
    said: str | None, kept: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    if said is not None:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", said)
    seen: list[str | None] = []
    monkeypatch.setattr(
        armsight.cli.commands, "app", lambda prog_name: seen.append(os.environ.get("OPENBLAS_NUM_THREADS"))
    )
    armsight.cli.main()
    assert seen == [kept]


LACKING = """
import sys
class Once:
    def find_spec(self, name, path=None, target=None):
        if name == "scipy.spatial.transform._rotation_spline":
            sys.meta_path.remove(self)
            raise AttributeError("what another scipy would want of a stand-in")
sys.meta_path.insert(0, Once())
"""
LOADED = """
import sys
from armsight.cli.lazy import load_rotations
load_rotations()
print("scipy.spatial" in sys.modules, "scipy.linalg" in sys.modules, "numpy.f2py" in sys.modules)
import numpy as np, scipy
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation, RotationSpline
turned = Rotation.from_rotvec([[0.0, 0.0, z] for z in (0.0, 0.1, 0.3)])
np.testing.assert_allclose(RotationSpline([0.0, 1.0, 2.0], turned)(1.0).as_rotvec(), [0.0, 0.0, 0.1], atol=1e-12)
print(np.ma.MaskedArray([1]).sum(), cKDTree([[0.0]]).n, scipy.linalg.det([[2.0]]))
print(scipy.spatial.transform.Rotation is Rotation)
import scipy.cluster.hierarchy, scipy.interpolate, scipy.io, scipy.ndimage, scipy.optimize, scipy.signal, scipy.stats
print(scipy.special.chdtri(1, 0.05).round(12), scipy.stats.ttest_rel([1.0, 2.0, 4.0], [1.5, 2.0, 3.0]).pvalue.round(6))
print(scipy.linalg.solve_banded((0, 0), [[2.0]], [4.0])[0], scipy.optimize.brentq(lambda x: x - 3.0, 0.0, 9.0))
"""


@pytest.mark.parametrize("before", ["", LACKING])
def test_what_a_command_leaves_out_of_scipy_is_there_when_it_is_asked_for(before: str) -> None:
    done = subprocess.run([sys.executable, "-c", before + LOADED], capture_output=True, text=True, check=False)
    rest = ["3.841458820694", "0.741801", "2.0", "3.0"]  # chi-squared of 95 %: of any table
    assert done.stdout.split() == ["False", "False", "False", "1", "1", "2.0", "True", *rest], done.stderr


CALIBRATED = """
import sys
from armsight.ops import inputs
from armsight.ops.calibration import cameras, reports
from armsight.ops.measurement import run
print(*sorted(one.removeprefix("armsight.") for one in sys.modules if one.startswith("armsight.")))
"""
LEFT_OUT = (
    "store.recording",
    "store.interpret.read",
    "store.programs",
    "calibrate.cell",
    "verify",
)


def test_a_calibration_and_a_measurement_leave_out_what_other_files_need() -> None:
    done = subprocess.run([sys.executable, "-c", CALIBRATED], capture_output=True, text=True, check=True)
    loaded = done.stdout.split()
    assert "measure.boards" in loaded
    assert [one for one in loaded if any(f"{one}.".startswith(f"{left}.") for left in LEFT_OUT)] == []


COLLECTED = """
import gc, weakref
import armsight.cli, armsight.cli.commands
from armsight.cli import FIRST_OBJECTS, NEW_OBJECTS, _started
class Kept: pass
def start(prog_name):
    first = [[] for _ in range(FIRST_OBJECTS + 1)]
    print(gc.get_threshold()[0], gc.get_freeze_count() > FIRST_OBJECTS, _started in gc.callbacks)
    kept = Kept()
    kept.itself, seen = kept, weakref.ref(kept)
    del kept
    later = [[] for _ in range(2 * NEW_OBJECTS)]
    print(seen() is None)
armsight.cli.commands.app = start
armsight.cli.main()
"""


def test_garbage_is_looked_for_when_a_command_has_begun_and_not_in_what_it_began_with() -> None:
    done = subprocess.run([sys.executable, "-c", COLLECTED], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["10000", "True", "False", "True"]
