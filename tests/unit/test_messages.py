"""What a person reads of a refusal, whole: cause, consequence and cure of one real refusal of each class."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from armsight import errors
from armsight.drivers import OpenCvCamera
from armsight.drivers.images import decode_image
from armsight.fitting.problem import Evaluation, Problem
from armsight.fitting.solve import solve
from armsight.geometry import align_points
from armsight.kinematics import Joint
from armsight.ops.robot.recorder import require_recorded
from armsight.records.motion import JointHistory
from armsight.store import tracks
from armsight.store.arm_points import read_arm_points
from armsight.store.atomic import held_outputs, refuse_output
from armsight.store.yamls import parse_yaml

ON_A_LINE = np.outer(np.arange(4), [1.0, 2.0, 3.0])


class Wire:
    """A camera that is not there, or sends one frame and is pulled out."""

    def __init__(self, there: bool) -> None:
        self.frames = int(there)
        self.there = there

    def isOpened(self) -> bool:
        return self.there

    def read(self) -> tuple[bool, np.ndarray]:
        self.frames -= 1
        return self.frames >= 0, np.zeros((4, 6), np.uint8)

    def get(self, key: int) -> float:
        return 0.0

    def set(self, key: int, value: float) -> bool:
        return True

    def release(self) -> None:
        pass


class Impatient:
    """Progress of work that a person stops at once."""

    def update(self, done: float, total: float, note: str = "") -> None: ...

    def cancelled(self) -> bool:
        return True


def look(there: bool) -> None:
    with OpenCvCamera("3", open_capture=lambda _: Wire(there)) as camera:
        list(camera)


def fit(residual: float = 1.0, slope: float = 1.0, progress: Impatient | None = None) -> None:
    def evaluate(shared: np.ndarray, local: np.ndarray) -> Evaluation:
        J = np.full((1, 3, 1), slope)
        return Evaluation(residuals=np.full((1, 3), residual), shared=J, local=np.zeros((1, 3, 0)))

    problem = Problem(names=("hope",), guess=np.zeros(1), evaluate=evaluate, n_residuals=3)
    solve(problem, progress=progress) if progress else solve(problem)


def written_twice() -> None:
    with held_outputs([Path("out")]), held_outputs([Path("out")]):
        pass


def two_sets_of_columns() -> None:
    Path("points.csv").write_text("q1,x_mm,y_mm,z_mm,laser_x_mm,laser_y_mm,laser_z_mm\n0,500,1,2,500,1,2\n")
    read_arm_points(Path("points.csv"))


MESSAGES: dict[type[errors.ArmsightError], tuple[Callable[[], object], Sequence[str]]] = {
    errors.UsageError: (
        lambda: refuse_output(Path("-")),
        (
            "- is the standard output, which cannot hold what is written here.",
            "Nothing was done.",
            "Give a file or a folder (-o).",
        ),
    ),
    errors.BadFile: (
        lambda: parse_yaml(b"", "rig.yaml"),
        ("rig.yaml: the file is empty.", "The file is not used.", "Check the file."),
    ),
    errors.BadImage: (
        lambda: decode_image(b"x", "a.png"),
        (
            "a.png is not a whole image: its head is damaged, or of no known kind.",
            "The frame cannot be used.",
            "Copy it again from where it was recorded, or take it and its partner away.",
        ),
    ),
    errors.NotEnoughData: (
        lambda: tracks.parse_times(b"t_s\n", "times.csv"),
        (
            "times.csv: no row below the header.",
            "There is nothing to do.",
            "Check that the recording ran, and that the file was copied whole.",
        ),
    ),
    errors.Degenerate: (
        lambda: align_points(ON_A_LINE, ON_A_LINE),
        (
            "the points lie on one line.",
            "The turn about that line cannot be known.",
            "Use a target whose spots form a triangle.",
        ),
    ),
    errors.Undetermined: (
        lambda: fit(slope=0.0),
        (
            "the data cannot tell these parameters apart: hope.",
            "No value is given for any of them.",
            "Add data that move them independently, or fix one of each group.",
        ),
    ),
    errors.Ambiguous: (
        two_sets_of_columns,
        (
            "points.csv: the columns 'x_mm' and 'laser_x_mm' may be the same coordinate.",
            "Nobody knows which is meant.",
            "Give --columns with - for those that are not used.",
        ),
    ),
    errors.Inconsistent: (
        lambda: Joint(name="j", lower=1.0, upper=-1.0),
        (
            "the limits of joint j are swapped or equal: lower 1, upper -1.",
            "The joint could not move.",
            "Give the smaller one as lower; leave both out for a joint without limits.",
        ),
    ),
    errors.NotConverged: (
        lambda: fit(residual=np.nan),
        (
            "the model cannot be evaluated at the starting guess.",
            "Nothing was fitted.",
            "Give a starting guess for which every observation is possible.",
        ),
    ),
    errors.DeviceFailed: (
        written_twice,
        (
            "out is in use by process 4711.",
            "Another command is writing its results there; nothing was done.",
            "Wait for its end, or give another place (-o).",
        ),
    ),
    errors.DeviceNotFound: (
        lambda: look(there=False),
        ("camera:3 cannot be opened.", "There are no frames.", "No camera is connected."),
    ),
    errors.DeviceLost: (
        lambda: look(there=True),
        (
            "camera:3 stopped sending after 1 frames.",
            "No frame is measured from here on; those before stay.",
            "Check the plug and the cable, and start again.",
        ),
    ),
    errors.RecordingFailed: (
        lambda: require_recorded("serve.mcap: cannot be written (No space left on device)"),
        (
            "the recording ended before the robot's session: serve.mcap: cannot be written (No space left on device).",
            "What was done after that is not kept; what was written until then can be read.",
            "Make room, or name another disk (--log), before the next session.",
        ),
    ),
    errors.StaleData: (
        lambda: JointHistory(0.01).at(0.0),
        ("fewer than two joint readings have come.", "Where the arm is is not known."),
    ),
    errors.Cancelled: (lambda: fit(progress=Impatient()), ("the fit was stopped.", "No result was kept.")),
}


@pytest.mark.parametrize("kind", MESSAGES, ids=lambda kind: kind.__name__)
def test_a_message_of_each_class_is_whole(
    kind: type[errors.ArmsightError], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("os.getpid", lambda: 4711)
    monkeypatch.setattr("armsight.drivers.live.cameras_there", tuple)
    call, parts = MESSAGES[kind]
    with pytest.raises(kind) as caught:
        call()
    assert type(caught.value) is kind
    assert str(caught.value) == " ".join(parts)


def test_every_class_that_is_raised_has_its_message() -> None:
    every = {one for one in vars(errors).values() if isinstance(one, type) and issubclass(one, errors.ArmsightError)}
    assert set(MESSAGES) == every - {errors.ArmsightError, errors.DataRefused}
