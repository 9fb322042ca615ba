"""What a measured pair is worth beside its truth: lights found, errors, errors over their claims, wrong poses."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from armsight.errors import ArmsightError
from armsight.measure.poses.outcome import Track
from armsight.measure.poses.pipeline import Measured, Setup, measure_pair
from armsight.records import Frame, PoseStatus, Spots

Array = NDArray[np.float64]
SIDES = ("left", "right")

FAR_MM, FAR_DEG = 5.0, 5.0
"""A pose further off than this is wrong, whatever it claims."""

BEYOND = 6.0
"""Standard deviations of the claimed covariance beyond which a pose is wrong, where it is also off by BEYOND_MM."""
BEYOND_MM = 1.0

MISTAKEN_PX = 5.0
"""A named spot further than this from its light is something else; no two lights are nearer than 19 px."""

CLAIM = 0.999
"""Share of the claimed distribution within which an error counts as claimed."""

RAISED = "raised"
"""Status of a pair that the product answered with one of its errors."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SpotError:
    """One named spot of a pose: error (2,) in px, squared error over its claim, the model behind it."""

    name: str
    side: str
    error_px: Array
    chi2: float
    model: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verdict:
    """One pair. position_mm, orientation_deg, chi2 (6 degrees of freedom), chi2_position (3): NaN without a pose.

    place_mm: where only a position is given, its distance from the mean of as many lights (those that fit it best).
    found: (side, name) of the lights found. named: what the spots of a pose are worth.
    """

    status: str
    why: str
    ms: float
    found: frozenset[tuple[str, str]]
    position_mm: float = np.nan
    orientation_deg: float = np.nan
    chi2: float = np.nan
    chi2_position: float = np.nan
    place_mm: float = np.nan
    named: tuple[SpotError, ...] = ()
    measured: Measured | None = None

    @property
    def ok(self) -> bool:
        """Whether there is a whole pose."""
        return self.status == PoseStatus.OK

    @property
    def far(self) -> bool:
        """Whether the pose is off by more than FAR_MM or FAR_DEG."""
        return self.ok and (self.position_mm > FAR_MM or self.orientation_deg > FAR_DEG)

    @property
    def beyond(self) -> bool:
        """Whether the pose is off by far more than it claims."""
        return self.ok and self.position_mm > BEYOND_MM and max(self.chi2, self.chi2_position) > BEYOND**2

    @property
    def wrong(self) -> bool:
        """Whether the pose misleads."""
        return self.far or self.beyond

    @property
    def claimed(self) -> bool:
        """Whether the pose is off by no more than it says, however much that is."""
        return self.ok and self.chi2 <= chi2.ppf(CLAIM, 6) and self.chi2_position <= chi2.ppf(CLAIM, 3)

    @property
    def mistaken(self) -> bool:
        """Whether the pose was made of something else than the target's lights under their names."""
        return self.ok and any(float(np.linalg.norm(s.error_px)) > MISTAKEN_PX for s in self.named)

    @property
    def misplaced(self) -> bool:
        """Whether a position without orientation is no place of any of the lights."""
        return self.place_mm > FAR_MM


def judge(
    setup: Setup,
    frames: tuple[Frame, Frame],
    T_rig_target: Array,
    lights: Mapping[tuple[str, str], Array],
    *,
    reach_px: float,
    track: Track | None = None,
) -> Verdict:
    """Return what the product makes of a pair; lights: true centre of area (2,) in px of each (side, name) visible."""
    start = time.perf_counter()
    try:
        measured = measure_pair(setup, *frames, track)
    except ArmsightError as error:
        ms = (time.perf_counter() - start) * 1e3
        return Verdict(status=RAISED, why=f"{type(error).__name__}: {error.cause}", ms=ms, found=frozenset())
    ms = (time.perf_counter() - start) * 1e3
    pose = measured.pose
    known = {
        "status": str(pose.status),
        "why": pose.why,
        "ms": ms,
        "found": found(measured, lights, reach_px),
        "measured": measured,
    }
    if pose.T_parent_target is None or pose.covariance is None:
        return Verdict(**known)
    if pose.status is not PoseStatus.OK:
        places = setup.target.xyz_m @ T_rig_target[:3, :3].T + T_rig_target[:3, 3]
        return Verdict(**known, place_mm=place_error_mm(pose.T_parent_target[:3, 3], places, len(pose.spots)))
    d = pose_error(pose.T_parent_target, T_rig_target)
    return Verdict(
        **known,
        position_mm=1e3 * float(np.linalg.norm(d[:3])),
        orientation_deg=float(np.rad2deg(np.linalg.norm(d[3:]))),
        chi2=float(d @ np.linalg.solve(pose.covariance, d)),
        chi2_position=float(d[:3] @ np.linalg.solve(pose.covariance[:3, :3], d[:3])),
        named=spot_errors(measured, lights),
    )


def pose_error(T: Array, truth: Array) -> Array:
    """Return (translation, rotation vector) from the true pose to T, in the parent's axes."""
    turn = Rotation.from_matrix(T[:3, :3] @ truth[:3, :3].T).as_rotvec()
    return np.concatenate([T[:3, 3] - truth[:3, 3], turn])


def place_error_mm(at: Array, places: Array, n: int) -> float:
    """Return the distance of a position from the mean of n of the lights' places (m, 3), whichever are nearest."""
    means = [np.mean(some, axis=0) for some in combinations(places, min(n, len(places)))]
    return 1e3 * min(float(np.linalg.norm(at - mean)) for mean in means)


def found(measured: Measured, lights: Mapping[tuple[str, str], Array], reach_px: float) -> frozenset[tuple[str, str]]:
    """Return the lights found: the named spots of a whole pose, else whatever was seen, within reach of the truth."""
    out = set()
    for (side, name), uv in lights.items():
        if measured.pose.status is PoseStatus.OK:
            spots = getattr(measured, side)
            at = spots.uv_px[[n == name for n in measured.names]]
        else:
            at = getattr(measured, f"{side}_seen").uv_px
        if near(at, uv, reach_px):
            out.add((side, name))
    return frozenset(out)


def near(at: Array, uv: Array, reach_px: float) -> bool:
    """Whether one of the places (n, 2) is within reach of uv."""
    return bool(len(at)) and float(np.linalg.norm(at - uv, axis=1).min()) <= reach_px


def spot_errors(measured: Measured, lights: Mapping[tuple[str, str], Array]) -> tuple[SpotError, ...]:
    """Return the errors of the named spots whose light is visible."""
    out = []
    for side in SIDES:
        spots: Spots = getattr(measured, side)
        for i, name in enumerate(measured.names):
            if (side, name) not in lights:
                continue
            e = spots.uv_px[i] - lights[side, name]
            q = float(e @ np.linalg.solve(spots.covariance_px2[i], e))
            out.append(SpotError(name=name, side=side, error_px=e, chi2=q, model=spots.model[i]))
    return tuple(out)


def reason(why: str) -> str:
    """Return a refusal's words without its numbers, so that alike ones can be counted."""
    return re.sub(r"\(?-?\d+(\.\d+)?([eE]-?\d+)?(, -?\d+(\.\d+)?)*\)?", "#", why)


def share(hits: int, n: int) -> str:
    """Return a share in per cent with its binomial standard deviation (of one more hit and one more miss)."""
    if n == 0:
        return "-"
    p = (hits + 1) / (n + 2)
    return f"{100.0 * hits / n:.1f} ± {100.0 * np.sqrt(p * (1.0 - p) / n):.1f}"


def within(values: Sequence[float], freedom: int) -> str:
    """Return the share of squared errors inside the 95 % ellipsoid."""
    q = np.asarray(values)
    return share(int((q <= chi2.ppf(0.95, freedom)).sum()), len(q))


def spread(values: Sequence[float], freedom: int) -> float:
    """Return by how much the middle error exceeds its claim: the root of the median over what it should be."""
    return float(np.sqrt(np.median(values) / chi2.ppf(0.5, freedom))) if len(values) else np.nan


def blob_detector() -> Callable[[NDArray[np.uint8]], Array]:
    """Return OpenCV's blob detector as it is usually asked for lights: (n, 2) of an image's bright blobs."""
    parameters = cv2.SimpleBlobDetector_Params()
    parameters.blobColor, parameters.thresholdStep = 255, 15.0
    parameters.filterByArea, parameters.minArea, parameters.maxArea = True, 8.0, 800.0
    detector = cv2.SimpleBlobDetector_create(parameters)

    def detect(image: NDArray[np.uint8]) -> Array:
        return np.array([k.pt for k in detector.detect(image)], float).reshape(-1, 2)

    return detect
