"""Spots of an image, and the target's pose from images or spots of one moment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.api.results import Result, Row, pose_rows
from armsight.arrays import Array
from armsight.columns import POSE6
from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.geometry import euler_rad
from armsight.measure import spots as detection
from armsight.measure.poses.moments import measure_chosen, measure_moment, require_views
from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.setup import Setup, rig_slack_px
from armsight.measure.settings import DEFAULTS, SpotSettings
from armsight.ops.arrays import ImageLike, as_frame, as_image
from armsight.ops.checks import speaks_python
from armsight.optics import Rig, RigKind
from armsight.records import (
    Frame,
    PoseStatus,
    Spots,
    Target,
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


Cameras: TypeAlias = Mapping[str, Any]
"""Images or spots by the camera's name in the rig, None where a camera has none."""


@speaks_python()
def estimate_pose(
    left: ImageLike | None = None,
    right: ImageLike | None = None,
    rig: Rig | None = None,
    target: Target | None = None,
    *,
    cameras: Cameras | None = None,
    settings: SpotSettings = DEFAULTS,
    t_s: float = 0.0,
    bits: int | None = None,
) -> PoseEstimate:
    """Return the target's pose from the images of one moment, taken by itself.

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
    cameras
        Instead of left and right, of a rig of one to eight cameras: the images by the cameras' names in the rig, None
        where one has none.
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
    UsageError
        Cameras that the rig has not, or one of it that is not named.
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
    setup = setup_of(rig, target, settings, one_image=right is None and cameras is None)
    frames = frames_of(setup, views_of(setup, left, right, cameras), t_s, bits)
    return estimate_of(measure_moment(setup, frames))


@speaks_python()
def estimate_pose_from_spots(
    left: Spots | None = None,
    right: Spots | None = None,
    rig: Rig | None = None,
    target: Target | None = None,
    *,
    cameras: Cameras | None = None,
    t_s: float = 0.0,
) -> PoseEstimate:
    """Return the target's pose from spots of one moment that another detector found.

    Parameters
    ----------
    left, right
        Spots of both images, in any order: Spots.of_centres(uv_px, covariance_px2). Which belong together is found out.
    rig, target
        As estimate_pose takes them; the target is of lights.
    cameras
        Instead of left and right, of a rig of one to eight cameras: the spots by the cameras' names.
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
    UsageError
        Cameras that the rig has not, or one of it that is not named.

    Examples
    --------
    >>> cell = armsight.simulate("hand-cell", frames=1)
    >>> xyz_m = cell.T_rig_target[0, :3, 3] + cell.target.xyz_m @ cell.T_rig_target[0, :3, :3].T
    >>> left, right = (armsight.Spots.of_centres(uv, 0.01 * np.eye(2)) for uv in cell.rig.project(xyz_m))
    >>> armsight.estimate_pose_from_spots(left, right, cell.rig, cell.target).ok
    True
    """
    require_number("t_s", t_s)
    setup = setup_of(rig, target, DEFAULTS, one_image=False)
    seen = views_of(setup, left, right, cameras)
    for name, spots in zip(setup.rig.names, seen, strict=True):
        if spots is not None or cameras is None:
            require_kind(name, spots, Spots, cure="Give Spots.of_centres(uv_px, covariance_px2)")
    if setup.target.is_board:
        raise Inconsistent("the target is a printed board", cure="Give a target of lights, or images to estimate_pose")
    return estimate_of(measure_chosen(setup, float(t_s), [Spots.none() if one is None else one for one in seen]))


def setup_of(rig: Rig | None, target: Target | None, settings: SpotSettings, *, one_image: bool) -> Setup:
    """Return what measuring needs; one_image: it holds both views of a mirror rig. Raises UsageError, Inconsistent."""
    seen_by, shown = require_setup(rig, target, settings)
    if not seen_by.is_pair:
        return Setup(seen_by, shown, settings, slack_px=rig_slack_px(seen_by))
    if one_image and seen_by.kind is not RigKind.MIRROR:
        raise Inconsistent(
            "there is no right image, and the rig has two cameras",
            consequence="There is nothing to triangulate with",
            cure="Give both images; one image holds both views only of a mirror rig",
        )
    return Setup(seen_by, shown, settings, overlaid=one_image)


def require_setup(rig: Rig | None, target: Target | None, settings: SpotSettings) -> tuple[Rig, Target]:
    """Return rig and target. Raises UsageError for what is none."""
    require_kind("rig", rig, Rig, cure="Give a Rig: read_rig(path), or that of calibrate_stereo")
    require_kind("target", target, Target, cure="Give a Target: read_target(path), or LightTarget(...)")
    require_kind("settings", settings, SpotSettings, cure="Give SpotSettings(...)")
    return rig, target  # type: ignore[return-value]  # checked


def views_of(setup: Setup, left: Any, right: Any, cameras: Cameras | None) -> tuple[Any, ...]:
    """Return what is given of each camera, in the rig's order. Raises UsageError where that is not of its cameras."""
    names = setup.rig.names
    require_views(setup, len(names))
    if cameras is None and setup.rig.is_pair:
        return left, left if setup.overlaid else right
    if cameras is not None:
        require_kind("cameras", cameras, Mapping, cure="Give {'left': ..., 'top': ...}, by the rig's names")
    given = {str(name): view for name, view in (cameras or {}).items()}
    if left is not None or right is not None or set(given) != set(names):
        extra = [side for side, view in (("left", left), ("right", right)) if view is not None]
        raise UsageError(
            f"the rig's cameras are {', '.join(names)}, and given are {', '.join([*extra, *given]) or 'none'}",
            consequence="Nothing is measured",
            cure="Give each camera of the rig by its name in cameras, None where it has no picture",
        )
    return tuple(given[name] for name in names)


def frames_of(setup: Setup, views: Sequence[Any], t_s: float, bits: int | None) -> list[Frame | None]:
    """Return images by camera in the rig's order, None where one has none, as frames of one moment."""
    if setup.overlaid:
        return [as_frame(views[0], name="the image", t_s=t_s, bits=bits)] * len(views)
    named = zip(setup.rig.names, views, strict=True)
    return [None if one is None else as_frame(one, name=f"the {name} image", t_s=t_s, bits=bits) for name, one in named]


def estimate_of(measured: Measured) -> PoseEstimate:
    """Return a measured moment as Python gets it."""
    pose = measured.pose
    return PoseEstimate(status=pose.status, why=pose.why, t_s=pose.t_s, detail=measured)
