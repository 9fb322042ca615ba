"""Spots of an image, the target's pose from a pair, and its track over many pairs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.api.results import Result, Row, pose_rows
from armsight.arrays import Array
from armsight.columns import POSE6
from armsight.errors import Inconsistent, NotEnoughData
from armsight.geometry import euler_rad
from armsight.measure import spots as detection
from armsight.measure.consistency.check import RunCheck, finalise
from armsight.measure.consistency.findings import Consistency
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.outcome import Measured, Track
from armsight.measure.poses.pipeline import Setup, measure_pair
from armsight.measure.settings import DEFAULTS, SpotSettings
from armsight.measure.track import PoseTrack
from armsight.ops.arrays import ImageLike, as_frame, as_image
from armsight.ops.checks import speaks_python
from armsight.optics import Rig, RigKind
from armsight.records import (
    PoseStatus,
    Spots,
    Target,
    TargetPose,
    require_count,
    require_kind,
    require_number,
    spot_target,
)
from armsight.records.target import Colour


def LightTarget(
    lights_m: dict[str, tuple[float, float, float]],
    *,
    diameter_m: float | None = None,
    colour: Colour | None = None,
    covariance: Array | None = None,
) -> Target:
    """Return a target of lights.

    Parameters
    ----------
    lights_m
        By name, the place (x, y, z) of each light in m, in the target's own frame.
    diameter_m
        Of flat round lights in m, where known.
    colour
        Of a beacon that is found by its colour.
    covariance
        (3 n, 3 n) in m^2 of the positions, in the order of their names.

    Raises
    ------
    Inconsistent
        The positions are no target.
    """
    require_kind("lights_m", lights_m, Mapping, cure="Give {'A': (x, y, z), ...} in m")
    return spot_target(dict(lights_m), diameter_m=diameter_m, colour=colour, covariance=covariance)


@speaks_python()
def find_spots(image: ImageLike, settings: SpotSettings = DEFAULTS, *, bits: int | None = None) -> Spots:
    """Return all spots of light in an image, searched without prior.

    Parameters
    ----------
    image
        uint8 (h, w) grey or (h, w, 3) BGR, or an image file's path.
    settings
        Threshold, mask, colour and sizes of the search.
    bits
        Of the light in uint16 arrays and 16-bit files, such as 12.

    Returns
    -------
    Spots
        uv_px (n, 2), centres in px, that of the top-left pixel being (0, 0); covariance_px2 (n, 2, 2). What was seen
        and not accepted is in `rejected`, with the reason.

    Raises
    ------
    BadImage
        It is no such image.
    Inconsistent
        The settings' mask has another size.

    Examples
    --------
    >>> image = np.zeros((240, 320), np.uint8)
    >>> image[100:104, 200:204] = 255
    >>> armsight.find_spots(image).uv_px.round(1).tolist()
    [[201.5, 101.5]]
    """
    require_kind("settings", settings, SpotSettings, cure="Give SpotSettings(...)")
    return detection.find_spots(as_image(image, bits=bits), settings)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PoseEstimate(Result):
    """The target's pose in the rig's frame at one moment, or why there is none.

    status: 'ok', 'doubtful' (not to be acted on), 'position_only' or 'lost'; why: the reason where it is not 'ok'. Of a
    lost pose T_rig_target, xyz_m, covariance and std raise NotEnoughData with that reason: ask `ok` before. detail:
    everything that the pose came from.
    """

    status: PoseStatus
    why: str
    t_s: float
    detail: Measured

    @property
    def T_rig_target(self) -> Array:
        """The pose (4, 4); where the position alone is known, only its translation means something."""
        return self._known(self.detail.pose.T_parent_target)

    @property
    def covariance(self) -> Array:
        """(6, 6) of translation (m) and rotation vector (rad) in the rig's axes, (3, 3) of the position alone.

        It holds all that is known of: the spots' noise, and the rig's and the target's own covariance where they have
        one.
        """
        return self._known(self.detail.pose.covariance)

    def _known(self, value: Array | None) -> Array:
        if value is None:
            raise NotEnoughData(
                f"the pose is lost: {self.why}",
                consequence="It has no place and no standard deviation",
                cure="Take it only where `ok` is true",
            )
        return value

    @property
    def ok(self) -> bool:
        """Whether the pose is complete: position and orientation are known."""
        return self.status is PoseStatus.OK

    @property
    def xyz_m(self) -> Array:
        """The target's position (3,) in the rig's frame."""
        return self.T_rig_target[:3, 3]

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations by name: x_m, y_m, z_m and, of a complete pose, rx_rad, ry_rad, rz_rad."""
        return dict(zip(POSE6, np.sqrt(np.diag(self.covariance)).tolist(), strict=False))

    @property
    def lights(self) -> tuple[str, ...]:
        """Names of the lights that the pose rests on."""
        return self.detail.names

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        seen = f" from {', '.join(self.lights)}" if self.lights else ""
        return f"Pose of the target in the rig: {self.status}{seen}" + (f" ({self.why})" if self.why else "")

    def rows(self) -> list[Row]:
        """Return the pose's coordinates in mm and degrees (R = Rz Ry Rx), with standard deviations."""
        values = self._values()
        return pose_rows(values, self.std) if values else []

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers in SI units; None and {} for what a lost pose has not."""
        known = self.detail.pose.T_parent_target is not None
        return {
            "status": str(self.status),
            "why": self.why,
            "t_s": self.t_s,
            "T_rig_target": self.T_rig_target.tolist() if known else None,
            "covariance": self.covariance.tolist() if known else None,
            "std": self.std if known else {},
            "lights": list(self.lights),
        }

    def _values(self) -> dict[str, float]:
        if self.detail.pose.T_parent_target is None:
            return {}
        values = self.T_rig_target[:3, 3].tolist()
        if self.ok:
            values += euler_rad(RigidTransform.from_matrix(self.T_rig_target).rotation).tolist()
        return dict(zip(POSE6, values, strict=False))


@speaks_python()
def estimate_pose(
    left: ImageLike,
    right: ImageLike | None,
    rig: Rig,
    target: Target,
    *,
    settings: SpotSettings = DEFAULTS,
    t_s: float = 0.0,
    bits: int | None = None,
) -> PoseEstimate:
    """Return the target's pose from one pair of images, taken by itself.

    What a good recording may show (a hidden light, a reflection, nothing at all) raises nothing: `status` and `why` say
    it.

    Parameters
    ----------
    left
        uint8 (h, w) grey or (h, w, 3) BGR, or a path: the left camera's image, or a mirror rig's one image of both
        views.
    right
        The right camera's image; None for a mirror rig.
    rig
        The calibrated cameras.
    target
        Its lights, or a printed board.
    settings
        Threshold, mask and sizes of the search for lights.
    t_s
        Time of the exposure in s; it is handed on.
    bits
        Of the light in uint16 arrays and 16-bit files, such as 12.

    Returns
    -------
    PoseEstimate
        T_rig_target (4, 4), in m, with covariance (6, 6) in m and rad, or the reason why there is none.

    Raises
    ------
    BadImage
        An image cannot be read, or is none.
    Inconsistent
        An image has not the size of its camera, or left and right are swapped.
    Degenerate
        The target's lights are on one line.

    Examples
    --------
    >>> cell = armsight.simulate("hand-cell", frames=1)
    >>> frame = next(iter(cell))
    >>> pose = armsight.estimate_pose(frame.left, frame.right, cell.rig, cell.target)
    >>> pose.ok, bool(abs(pose.xyz_m - frame.T_rig_target[:3, 3]).max() < 0.005)
    (True, True)
    """
    require_number("t_s", t_s)
    return _estimate(_measure(_setup(rig, target, settings, right is None), left, right, t_s, None, bits))


@speaks_python()
def estimate_pose_from_spots(left: Spots, right: Spots, rig: Rig, target: Target, *, t_s: float = 0.0) -> PoseEstimate:
    """Return the target's pose from spots that a detector of one's own found in both images.

    Parameters
    ----------
    left, right
        Spots of both images, in any order: Spots.of_centres(uv_px, covariance_px2). Which belong together is found out.
    rig, target
        As estimate_pose takes them; the target is of lights.
    t_s
        Time of the exposure in s; it is handed on.

    Returns
    -------
    PoseEstimate
        As estimate_pose gives it.

    Raises
    ------
    Inconsistent
        Left and right are swapped, or the target is a printed board.

    Examples
    --------
    >>> cell = armsight.simulate("hand-cell", frames=1)
    >>> xyz_m = cell.T_rig_target[0, :3, 3] + cell.target.xyz_m @ cell.T_rig_target[0, :3, :3].T
    >>> left, right = (armsight.Spots.of_centres(uv, 0.01 * np.eye(2)) for uv in cell.rig.project(xyz_m))
    >>> armsight.estimate_pose_from_spots(left, right, cell.rig, cell.target).ok
    True
    """
    require_number("t_s", t_s)
    for name, spots in (("left", left), ("right", right)):
        require_kind(name, spots, Spots, cure="Give Spots.of_centres(uv_px, covariance_px2)")
    setup = _setup(rig, target, DEFAULTS, one_image=False)
    if target.is_board:
        raise Inconsistent("the target is a printed board", cure="Give a target of lights, or images to estimate_pose")
    return _estimate(measure_spots(setup, float(t_s), left, right))


class PoseTracker:
    """Follows a target over pairs of images in order, faster than each by itself, and checks that they agree.

    The lights are looked for where they must be by now, and in the whole image where they are not. Over the run the
    residuals are asked whether rig and target can be right; poses that follow are widened where they cannot.
    """

    def __init__(self, rig: Rig, target: Target, *, settings: SpotSettings = DEFAULTS, bits: int | None = None) -> None:
        _require_setup(rig, target, settings)
        if bits is not None:
            require_count("bits", bits, least=1)
        self._rig, self._target, self._settings, self._bits = rig, target, settings, bits
        self.reset()

    def reset(self) -> None:
        """Forget all that was seen."""
        self._setup: Setup | None = None
        self._track: Track | None = None
        self._check: RunCheck | None = None
        self._poses: list[TargetPose] = []

    def update(self, left: ImageLike, right: ImageLike | None, t_s: float) -> PoseEstimate:
        """Return the pose at t_s.

        Parameters
        ----------
        left
            As estimate_pose takes it.
        right
            Alike; None for a mirror rig.
        t_s
            Time of the exposure in s, growing from call to call.

        Raises
        ------
        Inconsistent
            Time does not grow; else as estimate_pose.
        """
        require_number("t_s", t_s)
        if self._poses and not t_s > self._poses[-1].t_s:
            raise Inconsistent(
                f"the time {t_s:g} s does not come after the one before",
                consequence="The pair cannot be tracked",
                cure="Give the times of the exposures in seconds, in order; reset() for another recording",
            )
        if self._setup is None or self._check is None or self._setup.overlaid != (right is None):
            self._setup = _setup(self._rig, self._target, self._settings, right is None)
            self._check = RunCheck(self._setup)
        measured = _measure(self._setup, left, right, t_s, self._track, self._bits)
        self._track = measured.track
        measured = self._check.add(measured)
        self._poses.append(measured.pose)
        return _estimate(measured)

    @property
    def track(self) -> PoseTrack:
        """The poses so far; all are doubtful once the run is found inconsistent."""
        doubted = self._check is not None and self._check.inconsistent
        return PoseTrack(poses=tuple(finalise(pose, inconsistent=doubted) for pose in self._poses))

    @property
    def consistency(self) -> Consistency | None:
        """Whether the residuals so far fit the rig and the target, and what is likely wrong; None before any pair."""
        return None if self._check is None else self._check.finish()


def _setup(rig: Rig, target: Target, settings: SpotSettings, one_image: bool) -> Setup:
    _require_setup(rig, target, settings)
    if one_image and rig.kind is not RigKind.MIRROR:
        raise Inconsistent(
            "there is no right image, and the rig has two cameras",
            consequence="There is nothing to triangulate with",
            cure="Give both images; one image holds both views only of a mirror rig",
        )
    return Setup(rig, target, settings, overlaid=one_image)


def _require_setup(rig: Rig, target: Target, settings: SpotSettings) -> None:
    require_kind("rig", rig, Rig, cure="Give a Rig: read_rig(path), or that of calibrate_stereo")
    require_kind("target", target, Target, cure="Give a Target: read_target(path), or LightTarget(...)")
    require_kind("settings", settings, SpotSettings, cure="Give SpotSettings(...)")


def _measure(
    setup: Setup, left: ImageLike, right: ImageLike | None, t_s: float, track: Track | None, bits: int | None
) -> Measured:
    at_left = as_frame(left, name="the left image" if right is not None else "the image", t_s=t_s, bits=bits)
    at_right = at_left if right is None else as_frame(right, name="the right image", t_s=t_s, bits=bits)
    return measure_pair(setup, at_left, at_right, track)


def _estimate(measured: Measured) -> PoseEstimate:
    pose = measured.pose
    return PoseEstimate(
        status=pose.status,
        why=pose.why,
        t_s=pose.t_s,
        detail=measured,
    )
