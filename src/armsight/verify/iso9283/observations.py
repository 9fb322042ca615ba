"""What an ISO 9283 test gives: visits of commanded poses, runs along commanded paths, arrivals, planes they cross."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight.fitting.groups import taken
from armsight.records import frozen_array

CORNER_RAD = np.pi / 9
"""A commanded path that turns by more at one vertex has a corner there: circles are drawn with far smaller turns."""


class Stamps(StrEnum):
    """What the time stamps of a run are: of the sampling itself, of the rows' arrival, or not there."""

    SAMPLING = "sampling"
    ARRIVAL = "arrival"
    ABSENT = "absent"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseVisits:
    """The attained positions (n, 3) of one robot at one commanded pose, one row per visit, in one measuring frame.

    pose: the commanded pose's name. visit (n,): number of the cycle; rows of two poses with the same number belong to
    one cycle. quat_xyzw (n, 4): attained orientations, or None. covariance (n, k, k), k = 6 with orientations and 3
    without: the whole uncertainty of each measurement; systematic (k, k): the part of it that is the same in every
    visit (rig, target). approach: by visit, the direction it came from; None where nobody knows. commanded_xyz_m (3,),
    commanded_quat_xyzw (4,): the command; in_measuring_frame: whether it is given in the frame that was measured in.
    robot: which of several exchanged robots.

    Raises Inconsistent where sizes contradict each other or a cycle comes twice.
    """

    pose: str
    xyz_m: Array
    visit: NDArray[np.int64]
    quat_xyzw: Array | None = None
    covariance: Array | None = None
    systematic: Array | None = None
    approach: tuple[str, ...] | None = None
    commanded_xyz_m: Array | None = None
    commanded_quat_xyzw: Array | None = None
    in_measuring_frame: bool = True
    robot: str = ""

    def __post_init__(self) -> None:
        n = len(self.xyz_m)
        size = 3 if self.quat_xyzw is None else 6
        shapes: dict[str, tuple[int | None, ...]] = {
            "xyz_m": (n, 3),
            "quat_xyzw": (n, 4),
            "covariance": (n, size, size),
            "systematic": (size, size),
            "commanded_xyz_m": (3,),
            "commanded_quat_xyzw": (4,),
        }
        freeze(self, shapes)
        visit = np.array(self.visit, dtype=np.int64)
        if visit.shape != (n,) or len(np.unique(visit)) != n:
            raise Inconsistent(
                f"pose {self.pose}: {n} positions need {n} different visit numbers, not {visit.tolist()[:20]}",
                consequence="Visits of two poses cannot be put together by cycle",
                cure="Number the visits of each pose; give each robot a PoseVisits of its own",
            )
        visit.setflags(write=False)
        object.__setattr__(self, "visit", visit)
        if self.approach is not None:
            object.__setattr__(self, "approach", tuple(self.approach))
            if len(self.approach) != n:
                raise Inconsistent(f"pose {self.pose}: {len(self.approach)} approach directions for {n} visits")

    def __len__(self) -> int:
        return len(self.xyz_m)

    @property
    def place(self) -> str:
        """The pose's name, with the robot's before it where there is one."""
        return f"{self.robot} {self.pose}".strip()

    @property
    def rotation(self) -> Rotation | None:
        """The attained orientations as one stack of n."""
        return None if self.quat_xyzw is None else Rotation.from_quat(self.quat_xyzw)

    @property
    def directions(self) -> tuple[str, ...]:
        """The different approach directions, sorted; empty where they are not known."""
        return tuple(sorted(set(self.approach or ())))

    @property
    def random(self) -> Array | None:
        """The mean covariance (k, k) of what differs from visit to visit in the measurement; None if not known."""
        if self.covariance is None or not len(self):
            return None
        return random_part(self.covariance.mean(axis=0), self.systematic)

    def take(self, index: NDArray[np.intp]) -> PoseVisits:
        """Return some of the visits, in the given order."""
        return taken(self, index, "xyz_m", "visit", "quat_xyzw", "covariance", "approach")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CommandedPath:
    """The commanded path as a polyline: xyz_m (k, 3), quat_xyzw (k, 4) or None, and the commanded speed.

    Vertices at which it turns by more than CORNER_RAD are its corners; a curve is given by so many vertices that none
    is one. Raises Inconsistent below two vertices, for equal neighbours and for a speed that is not positive.
    """

    xyz_m: Array
    quat_xyzw: Array | None = None
    speed_m_s: float | None = None

    def __post_init__(self) -> None:
        freeze(self, {"xyz_m": (None, 3), "quat_xyzw": (len(self.xyz_m), 4)})
        if len(self.xyz_m) < 2 or not (self.lengths > 0.0).all():
            raise Inconsistent(
                "a commanded path needs at least two vertices, and none equal to the next",
                consequence="It has no direction",
                cure="Remove repeated vertices",
            )
        if self.speed_m_s is not None and not (np.isfinite(self.speed_m_s) and self.speed_m_s > 0.0):
            raise Inconsistent(f"the commanded speed {self.speed_m_s:g} m/s is not a positive number")

    @property
    def lengths(self) -> Array:
        """Length of each segment (k - 1,) in m."""
        return np.asarray(np.linalg.norm(np.diff(self.xyz_m, axis=0), axis=1))

    @property
    def directions(self) -> Array:
        """Unit vector of each segment (k - 1, 3)."""
        return np.diff(self.xyz_m, axis=0) / self.lengths[:, None]

    @property
    def corners(self) -> NDArray[np.intp]:
        """Vertices (c,) between the ends at which the path turns sharply."""
        d = self.directions
        cosine = np.einsum("ij,ij->i", d[:-1], d[1:])
        return np.flatnonzero(cosine < np.cos(CORNER_RAD)) + 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathRun:
    """One run along a path: xyz_m (m, 3), and where there are any t_s (m,) and quat_xyzw (m, 4)."""

    xyz_m: Array
    t_s: Array | None = None
    quat_xyzw: Array | None = None

    def __post_init__(self) -> None:
        m = len(self.xyz_m)
        freeze(self, {"xyz_m": (m, 3), "t_s": (m,), "quat_xyzw": (m, 4)})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathTest:
    """Several runs along one path.

    stamps: what the runs' times are. covariance_m2 (3, 3): the whole uncertainty of one sample's position;
    systematic_m2 (3, 3): the part of it that all samples share. in_measuring_frame: of the command.
    """

    name: str
    runs: tuple[PathRun, ...]
    commanded: CommandedPath | None = None
    in_measuring_frame: bool = True
    stamps: Stamps = Stamps.SAMPLING
    covariance_m2: Array | None = None
    systematic_m2: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "runs", tuple(self.runs))
        object.__setattr__(self, "stamps", Stamps(self.stamps))
        freeze(self, {"covariance_m2": (3, 3), "systematic_m2": (3, 3)})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArrivalTest:
    """Traces of several arrivals at one pose, each from before it reaches the band to rest.

    band_m: radius of the limit band about the position of rest; the pose repeatability, or what the maker states; None
    where nobody knows.
    covariance_m2 (3, 3): the whole uncertainty of one sample's position, systematic_m2 the part all samples share.
    """

    pose: str
    traces: tuple[PathRun, ...]
    band_m: float | None
    stamps: Stamps = Stamps.SAMPLING
    covariance_m2: Array | None = None
    systematic_m2: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "traces", tuple(self.traces))
        object.__setattr__(self, "stamps", Stamps(self.stamps))
        freeze(self, {"covariance_m2": (3, 3), "systematic_m2": (3, 3)})
        if self.band_m is not None and not (np.isfinite(self.band_m) and self.band_m > 0.0):
            raise Inconsistent(
                f"the limit band of {self.pose} is {self.band_m:g} m, which is not a positive number",
                consequence="Nothing can enter it",
                cure="Give the pose repeatability, or the band that the maker states",
            )


def freeze(record: object, shapes: dict[str, tuple[int | None, ...]]) -> None:
    """Turn a record's arrays, where they are given, into read-only copies; raises Inconsistent as frozen_array."""
    for name, shape in shapes.items():
        value = getattr(record, name)
        if value is not None:
            object.__setattr__(record, name, frozen_array(name, value, shape))


def random_part(covariance: Array, systematic: Array | None) -> Array:
    """Return covariance (k, k) without its systematic part; directions in which nothing is left have zero."""
    if systematic is None:
        return covariance
    value, vector = np.linalg.eigh(covariance - systematic)
    return np.asarray((vector * np.maximum(value, 0.0)) @ vector.T)


def stamps_fault(stamps: Stamps, t_s: tuple[Array | None, ...]) -> str | None:
    """Return why times cannot be divided by, or None where they can."""
    if stamps is Stamps.ABSENT or any(t is None for t in t_s):
        return "the runs carry no times"
    if stamps is Stamps.ARRIVAL:
        return "the stamps are arrival times, not sampling times: put them on the sampling clock first"
    for number, t in enumerate(t_s, start=1):
        if t is not None and (np.diff(t) <= 0.0).any():
            return f"the stamps of run {number} do not increase (row {int(np.argmax(np.diff(t) <= 0.0)) + 2})"
    return None


# Where runs cross planes square to a path: what path accuracy and repeatability are computed from.

PLANES = 50
"""Planes along a path, however many corners it has."""
CORNER_ZONE = 0.1
"""Share of a leg next to a corner that has no planes: rounding is judged by CR and CO, and no plane is square there."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Planes:
    """Planes through points xyz_m (k, 3) with unit normals along the path (k, 3), spacing_m apart.

    rotation: the commanded orientations there as one stack, or None.
    """

    xyz_m: Array
    normal: Array
    spacing_m: float
    rotation: Rotation | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Crossings:
    """Where each run crosses each plane: xyz_m (runs, planes, 3), NaN where it does not.

    rotations: by run the orientations as one stack over the planes, the identity where there is no crossing; None where
    a run has none.
    """

    xyz_m: Array
    rotations: tuple[Rotation, ...] | None


def planes_of(path: CommandedPath) -> Planes:
    """Return the planes square to a commanded path, evenly spaced on each leg between its corners."""
    at = np.concatenate([[0.0], np.cumsum(path.lengths)])  # (k,) arc length of the vertices
    ends = np.unique([0, *path.corners, len(at) - 1])
    stations: list[float] = []
    for first, last in pairwise(ends):
        a, b = at[first], at[last]
        start = a + CORNER_ZONE * (b - a) * (first in path.corners)
        stop = b - CORNER_ZONE * (b - a) * (last in path.corners)
        count = max(round(PLANES * (b - a) / at[-1]), 1)
        stations += (start + (stop - start) * (np.arange(count) + 0.5) / count).tolist()
    s = np.array(stations)  # (planes,)
    segment = np.clip(np.searchsorted(at, s, side="right") - 1, 0, len(at) - 2)
    xyz = path.xyz_m[segment] + (s - at[segment])[:, None] * path.directions[segment]
    rotation = None if path.quat_xyzw is None else Slerp(at, Rotation.from_quat(path.quat_xyzw))(s)
    return Planes(xyz_m=xyz, normal=path.directions[segment], spacing_m=float(at[-1]) / len(s), rotation=rotation)


def planes_of_run(run: PathRun) -> Planes | None:
    """Return planes square to a run itself, for paths whose command is not known; None where it has too few samples.

    Means of blocks of samples stand for the path: their chords are long beside the measurement's noise.
    """
    blocks = min(PLANES, len(run.xyz_m) // 3)
    if blocks < 4:
        return None
    knots = np.array([block.mean(axis=0) for block in np.array_split(run.xyz_m, blocks)])
    if not (np.linalg.norm(np.diff(knots, axis=0), axis=1) > 0.0).all():
        return None
    path = CommandedPath(xyz_m=knots)
    middle = 0.5 * (knots[:-1] + knots[1:])
    return Planes(xyz_m=middle, normal=path.directions, spacing_m=float(path.lengths.mean()), rotation=None)


def cross(planes: Planes, runs: Sequence[PathRun]) -> Crossings:
    """Return where each run crosses each plane, interpolated between samples.

    Where noise makes a slow run cross several times, the mean of those crossings is taken; other parts of a path that
    comes back to the plane's position lie further off than half the planes' spacing and are left out.
    """
    points, fractions = [], []
    for run in runs:
        found = [_crossing(p, u, planes.spacing_m, run.xyz_m) for p, u in zip(planes.xyz_m, planes.normal, strict=True)]
        points.append([point for point, _ in found])
        fractions.append([index for _, index in found])
    rotations = [_orientations(run, np.array(index)) for run, index in zip(runs, fractions, strict=True)]
    known = tuple(rotation for rotation in rotations if rotation is not None)
    return Crossings(xyz_m=np.array(points), rotations=known if len(known) == len(runs) else None)


def _crossing(point: Array, normal: Array, spacing_m: float, xyz: Array) -> tuple[Array, float]:
    """Return the crossing (3,) of the track xyz (m, 3) with a plane, and its fractional row; NaN for none."""
    height = (xyz - point) @ normal  # (m,)
    rows = np.flatnonzero((height[:-1] < 0.0) != (height[1:] < 0.0))
    if not len(rows):
        return np.full(3, np.nan), np.nan
    share = height[rows] / (height[rows] - height[rows + 1])
    found = xyz[rows] + share[:, None] * (xyz[rows + 1] - xyz[rows])  # (c, 3)
    distance = np.linalg.norm(found - point, axis=1)
    near = distance <= distance.min() + 0.5 * spacing_m
    return np.asarray(found[near].mean(axis=0)), float((rows + share)[np.argmin(distance)])


def _orientations(run: PathRun, row: Array) -> Rotation | None:
    """Return the run's orientations at fractional rows (k,), the identity at NaN."""
    if run.quat_xyzw is None or len(run.quat_xyzw) < 2:
        return None
    quat = np.tile([0.0, 0.0, 0.0, 1.0], (len(row), 1))
    seen = np.isfinite(row)
    if seen.any():
        track = Slerp(np.arange(len(run.quat_xyzw)), Rotation.from_quat(run.quat_xyzw))
        quat[seen] = track(row[seen]).as_quat()
    return Rotation.from_quat(quat)
