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
"""


def test_what_a_command_leaves_out_of_scipy_is_there_when_it_is_asked_for() -> None:
    done = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["False", "False", "False", "1", "1", "2.0", "True"], done.stderr
