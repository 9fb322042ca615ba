"""The examples in the docstrings of public names run, and every public function has one, or says why not."""

import doctest
import inspect
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import armsight

NEEDS_MORE = {
    **dict.fromkeys(
        ("calibrate_camera", "calibrate_cameras", "calibrate_stereo", "calibrate_mirrors", "check_mirrors"),
        "needs many images of a board: the guides have them",
    ),
    **dict.fromkeys(("calibrate_target", "calibrate_timing", "calibrate_pivot"), "needs a recorded wave or turn"),
    **dict.fromkeys(("calibrate_zoom_rig",), "needs calibrations at several zooms"),
    **dict.fromkeys(("servo", "play", "supervise", "identify_arm_live"), "takes seconds of a robot's time: the guides"),
    **dict.fromkeys(("reproduce",), "takes minutes: the guide"),
    **dict.fromkeys(("connect",), "needs a server: the guide, and test_remote.py"),
}
"""Public functions without an example that could run here, and why."""

FUNCTIONS = [name for name in dir(armsight) if inspect.isfunction(getattr(armsight, name)) and name[0].islower()]


def _examples(name: str) -> list[doctest.Example]:
    return doctest.DocTestParser().get_examples(inspect.getdoc(getattr(armsight, name)) or "")


def test_every_public_function_has_an_example_or_a_reason() -> None:
    assert {name for name in FUNCTIONS if not _examples(name)} == set(NEEDS_MORE)


IN_REAL_TIME = ("jog",)
"""A loop that a busy computer keeps waiting for 0.09 s stops its robot."""

ELSEWHERE = ("calibrate_cell", "design")
"""Take seconds: docs/guide/cell.md runs the first one's two lines as commands, tests/truth the function;
docs/guide/design.md has the second one's call."""

HERE = [
    pytest.param(name, marks=pytest.mark.alone) if name in IN_REAL_TIME else name
    for name in FUNCTIONS
    if name not in (*NEEDS_MORE, *ELSEWHERE)
]


@pytest.mark.parametrize("name", HERE)
def test_the_example_runs(name: str, tmp_path: Path) -> None:
    names = {"armsight": armsight, "np": np, "folder": tmp_path, "Rotation": Rotation, "RigidTransform": RigidTransform}
    test = doctest.DocTest(_examples(name), names, name, None, 0, None)
    told: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    runner.run(test, out=told.append)
    assert runner.failures == 0, "".join(told)
