"""Hand-eye and tool tip."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from armsight.api.results import Result, Row, pose_rows
from armsight.app.calibrate.handeye import Solved, solve_handeye
from armsight.app.requests.calibrate_robot import HandEyeJob
from armsight.arrays import Array
from armsight.calibrate.handeye import (
    HandEye,
    PosePairs,
    Proposal,
    Setup,
    calibrate_eye_in_hand,
    calibrate_eye_to_hand,
    propose,
)
from armsight.errors import Inconsistent
from armsight.geometry import euler_rad
from armsight.ops.arrays import Poses, as_poses
from armsight.ops.checks import speaks_python
from armsight.ops.given import Given, PathText, Source, TableLike
from armsight.optics import Camera
from armsight.records import Progress, Target, one_of, real_array, require_count, require_texts
from armsight.report.plots import error_figure
from armsight.store.handeye_file import write_handeye
from armsight.store.interpret import TableFormat
from armsight.store.saving import YAML, file_to_write

if TYPE_CHECKING:
    import plotly.graph_objects as go


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class HandEyeResult(Result):
    """Where the camera is on the arm (or beside it), and how far to believe it. detail: everything else.

    solved: the files and images that it came from, where it came from some.
    """

    detail: HandEye
    solved: Solved | None = None

    @property
    def T_flange_camera(self) -> Array:
        """Pose of the camera on the flange (4, 4). Raises Inconsistent for a camera that is not on the arm."""
        return self._pose(Setup.EYE_IN_HAND, "T_flange_camera")

    @property
    def T_base_target(self) -> Array:
        """Pose of the target in the base (4, 4). Raises Inconsistent for a target that is on the arm."""
        return self._pose(Setup.EYE_IN_HAND, "T_base_target")

    @property
    def T_base_camera(self) -> Array:
        """Pose of the camera in the base (4, 4). Raises Inconsistent for a camera that is on the arm."""
        return self._pose(Setup.EYE_TO_HAND, "T_base_camera")

    @property
    def T_flange_target(self) -> Array:
        """Pose of the target on the flange (4, 4). Raises Inconsistent for a target that is not on the arm."""
        return self._pose(Setup.EYE_TO_HAND, "T_flange_target")

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations of the camera's pose: x_m, y_m, z_m, rx_rad, ry_rad, rz_rad."""
        return self.detail.std("camera")

    @property
    def rejected(self) -> tuple[tuple[str, str], ...]:
        """(row, why) of the pairs that were left out."""
        return tuple((one.name, one.why) for one in self.detail.rejected_pairs)

    @property
    def left_out_rms_m(self) -> float:
        """Error of the target's place in pairs that were left out of the fit, RMS, m."""
        return self.detail.loo_rms_m

    @property
    def left_out_rms_rad(self) -> float:
        """Error of its rotation in pairs left out, RMS, rad."""
        return self.detail.loo_rms_rad

    @property
    def camera(self) -> Camera | None:
        """The camera that was freed and kept; None where none was."""
        return None if self.solved is None else self.solved.freed

    @property
    def time_offset_s(self) -> float | None:
        """Of two streams: what turns the camera's times into the robot's; None else."""
        return self.detail.time_offset_s

    def propose(self, n: int, reachable: Callable[[RigidTransform], bool] | None = None) -> tuple[Proposal, ...]:
        """Return the n next poses to drive to: T_base_flange, and the standard deviation to expect after it.

        reachable: tells whether the robot can go to a T_base_flange. Raises Inconsistent where no pose is left.
        """
        require_count("n", n, least=1)
        return propose(self.detail, n, reachable)

    @property
    def verdict(self) -> str:
        """Whether the result can be trusted."""
        return self.detail.verdict

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        where = "T_flange_camera" if self.detail.setup is Setup.EYE_IN_HAND else "T_base_camera"
        return f"Hand-eye ({self.detail.setup}): {where} from {self.detail.n_used} of {len(self.detail.pairs)} pairs"

    def rows(self) -> list[Row]:
        """Return the camera's pose with standard deviations, residuals and the verdict."""
        found = self.detail
        T = found.T_parent_camera
        values = [*np.asarray(T.translation).tolist(), *euler_rad(T.rotation).tolist()]
        return [
            *pose_rows(dict(zip(self.std, values, strict=True)), self.std),
            ("left-out error", f"{1e3 * found.loo_rms_m:.3g} mm, {np.rad2deg(found.loo_rms_rad):.3g} deg RMS"),
            *((f"rejected {name}", why) for name, why in self.rejected[:5]),
            ("verdict", self.verdict),
            *(("advice", text) for text in found.advice),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as `armsight calibrate handeye --json` gives them."""
        return self.detail.to_dict()

    def save(self, path: str | PathLike[str]) -> Path:
        """Write handeye.yaml and return its path."""
        file = file_to_write(path, *YAML)
        write_handeye(file, self.detail)
        return file

    def plot(self) -> go.Figure:
        """Return a plotly figure of each pair's error of place, mm."""
        return error_figure(self.title, np.linalg.norm(self.detail.residuals[:, :3], axis=1), self.detail.pairs.names)

    def _pose(self, setup: Setup, name: str) -> Array:
        if self.detail.setup is not setup:
            raise Inconsistent(
                f"{name} belongs to {setup}, and this calibration is {self.detail.setup}",
                cure="Give setup='eye-to-hand' for a camera beside the arm, 'eye-in-hand' for one on it",
            )
        camera = name.endswith("camera")
        return np.asarray((self.detail.T_parent_camera if camera else self.detail.T_parent_target).as_matrix())


@speaks_python(HandEyeJob)
def calibrate_hand_eye(
    T_base_flange: Poses,
    T_camera_target: Poses,
    *,
    setup: Literal["eye-in-hand", "eye-to-hand"] | Setup = "eye-in-hand",
    names: Sequence[str] | None = None,
    camera_covariance: ArrayLike | None = None,
) -> HandEyeResult:
    """Return where the camera is, from poses of the robot and of the target at the same moments, row by row.

    Parameters
    ----------
    T_base_flange
        N poses (n, 4, 4) in m, or RigidTransform: the flange in the robot's base, as its controller says.
    T_camera_target
        N poses alike: the target in the camera's frame.
    setup
        The camera is on the arm ('eye-in-hand') or beside it ('eye-to-hand').
    names
        Of the rows, for messages.
    camera_covariance
        Of T_camera_target (n, 6, 6), translation (m) then rotation vector (rad) in the camera's axes: pairs are weighed
        by it, as far as their residuals bear it out.

    Raises
    ------
    NotEnoughData
        Fewer rows than the answer has directions.
    Degenerate
        Too little turning, or about one axis only.
    Inconsistent
        Wrong units, inverted poses, or rows that do not belong together.
    NotConverged
        The fit found no answer.

    Examples
    --------
    >>> turn = Rotation.from_rotvec(np.random.default_rng(1).normal(0.0, 0.5, (12, 3)))
    >>> T_base_flange = RigidTransform.from_components(np.random.default_rng(2).normal(0.0, 0.2, (12, 3)), turn)
    >>> T_flange_camera = RigidTransform.from_translation([0.0, 0.05, 0.1])
    >>> T_camera_target = (T_base_flange * T_flange_camera).inv() * RigidTransform.from_translation([0.5, 0.0, 0.0])
    >>> armsight.calibrate_hand_eye(T_base_flange, T_camera_target).T_flange_camera[1:3, 3].round(6).tolist()
    [0.05, 0.1]
    """
    robot, camera = as_poses(T_base_flange, "T_base_flange"), as_poses(T_camera_target, "T_camera_target")
    rows = require_texts("names", names) if names is not None else tuple(f"row {i}" for i in range(len(robot)))
    covariance = None if camera_covariance is None else real_array("camera_covariance", camera_covariance)
    pairs = PosePairs(T_base_flange=robot, T_camera_target=camera, names=rows, camera_covariance=covariance)
    calibrate = calibrate_eye_in_hand if one_of(Setup, "setup", setup) is Setup.EYE_IN_HAND else calibrate_eye_to_hand
    return HandEyeResult(detail=calibrate(pairs))


@speaks_python(HandEyeJob)
def calibrate_hand_eye_from_images(
    images: Source,
    T_base_flange: TableLike,
    camera: Camera | PathText,
    board: str | Target,
    *,
    setup: Literal["eye-in-hand", "eye-to-hand"] | Setup = "eye-in-hand",
    free_camera: bool = False,
    bits: int | None = None,
    strict: bool = False,
    workers: int | None = None,
    table: TableFormat | None = None,
    progress: Progress | None = None,
) -> HandEyeResult:
    """Return where the camera is, from its images of a printed board at known poses of the robot.

    Parameters
    ----------
    images
        As calibrate_camera takes them.
    T_base_flange
        Poses (n, 4, 4) in the order of the images, or robot_poses.csv.
    camera
        The camera that took them.
    board
        As calibrate_camera takes it.
    free_camera
        Refine the camera too, where images left out get better by it: `camera` of the result.

    Raises
    ------
    NotEnoughData, Degenerate, Inconsistent, NotConverged
        As calibrate_hand_eye; too few images with the board, or other counts of images and poses.
    """
    with Given(name="handeye.yaml") as given:
        job = given.job(HandEyeJob, locals(), robot=T_base_flange, setup=one_of(Setup, "setup", setup))
        solved = solve_handeye(job, progress)
        return HandEyeResult(detail=solved.result, solved=solved)


@speaks_python(HandEyeJob)
def calibrate_hand_eye_from_streams(
    robot_stream: TableLike,
    camera_stream: TableLike,
    *,
    setup: Literal["eye-in-hand", "eye-to-hand"] | Setup = "eye-in-hand",
    clocks_within_s: float | None = None,
    table: TableFormat | None = None,
) -> HandEyeResult:
    """Return where the camera is, from two streams of poses on clocks of their own.

    Parameters
    ----------
    robot_stream
        T_base_flange over time: (t_s, T), a PoseTrack or a file.
    camera_stream
        T_camera_target over time, alike.
    clocks_within_s
        By how much the clocks differ at most; else any offset is looked for.

    Raises
    ------
    NotEnoughData, Degenerate, Inconsistent, NotConverged
        As calibrate_hand_eye; streams that do not show one motion.

    Examples
    --------
    >>> t_s = np.linspace(0.0, 6.0, 200)
    >>> turn = Rotation.from_rotvec(0.5 * np.sin(np.outer(t_s, [1.0, 1.3, 1.7])))
    >>> T_base_flange = RigidTransform.from_components(0.2 * np.sin(np.outer(t_s, [0.9, 1.1, 1.4])), turn)
    >>> T_flange_camera = RigidTransform.from_translation([0.0, 0.05, 0.1])
    >>> T_camera_target = (T_base_flange * T_flange_camera).inv() * RigidTransform.from_translation([0.5, 0.0, 0.0])
    >>> done = armsight.calibrate_hand_eye_from_streams((t_s, T_base_flange), (t_s + 0.1, T_camera_target))
    >>> round(abs(done.time_offset_s), 3)
    0.1
    """
    with Given(name="handeye.yaml") as given:
        solved = solve_handeye(given.job(HandEyeJob, locals(), setup=one_of(Setup, "setup", setup)))
        return HandEyeResult(detail=solved.result, solved=solved)
