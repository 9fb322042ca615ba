"""What was measured of an arm: its tool at joint readings, in any fixed frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.errors import Inconsistent, NotEnoughData
from armsight.fitting.groups import means, repeats, taken
from armsight.kinematics import Arm, fk
from armsight.records.checks import check_spread, freeze

MOST_TURNS_RAD = 40.0
"""A turning joint's reading beyond six turns is in degrees or counts."""

FEWEST_ROWS = 6
"""Base and one tool point alone have nine unknowns; three rows would fit anything."""
FEWEST_POSITIONS = 4
"""Different joint positions: of three, base and one tool point fit any positions."""
LEAST_MOVE = 0.01
"""Some joint must move by so much (rad, or of the mean link): less is lost in the noise of any measurement."""
SAME_Q = 1e-9
"""Readings that differ by less (rad or m) are of one joint position: rounding of a file."""

UNITS = {1000.0: "millimetres", 100.0: "centimetres", 39.37: "inches", 1e-3: "kilometres"}
MOST_TOUCHED, TOUCHES = 3, 4
"""Positions that touched points are at most, and joint positions for each: measured ones differ in some digit."""
FARTHEST = 1e5
"""Positions of 100 m in millimetres stay within it, so that these are told as such; beyond it a cell is wrong."""
ABSURD = 12.0
"""Positions that spread so many times as far as the arm moves its tool, or so many times less, are in another unit."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmPoints:
    """Measurements: joint readings q (m, n), positions xyz_m (m, 3), and where known rotations (m, 3, 3).

    point: (m,) names which of the tool's points a row is of. t_s: (m,) times, where the rows are of one recording.
    row: (m,) which row of its table each is, from 0, where some of the table were left out.
    block: (m,) of time that each row is of, where the errors of neighbours were found alike, and gap_s: how far in time
    rows must be apart to be independent. counted: whether t_s is no time but counts the rows. covariance (m, 3, 3): of
    the positions, by which rows are weighed; None where it is not known. unweighed: why covariances that were given
    are not used, or not as they are; "" for nothing to say.
    """

    q: Array
    xyz_m: Array
    rotation: Array | None = None
    point: tuple[str, ...] = ()
    t_s: Array | None = None
    row: NDArray[np.intp] | None = None
    block: NDArray[np.intp] | None = None
    gap_s: float = 0.0
    covariance: Array | None = None
    unweighed: str = ""
    counted: bool = False

    def __post_init__(self) -> None:
        m = len(self.xyz_m)
        freeze(self, q=(m, np.shape(self.q)[-1]), xyz_m=(m, 3))
        for name, shape in (("rotation", (m, 3, 3)), ("covariance", (m, 3, 3)), ("t_s", (m,))):
            if getattr(self, name) is not None:
                freeze(self, **{name: shape})
        object.__setattr__(self, "point", tuple(self.point) or ("",) * m)
        if len(self.point) != m:
            raise Inconsistent(
                f"{m} positions, but {len(self.point)} names of points",
                consequence="Nobody knows which row is of which point",
                cure="Give one name a row, or none",
            )

    def __len__(self) -> int:
        return len(self.xyz_m)

    @property
    def labels(self) -> tuple[str, ...]:
        """The names of the tool's points, sorted."""
        return tuple(sorted(set(self.point)))

    @property
    def position(self) -> NDArray[np.intp]:
        """Which joint position each row (m,) is of, counted from 0 as they come: rows of equal readings are of one."""
        _, first, which = np.unique(np.round(self.q / SAME_Q), axis=0, return_index=True, return_inverse=True)
        number = np.empty(len(first), dtype=np.intp)
        number[np.argsort(first)] = np.arange(len(first))
        return number[which.ravel()]

    @property
    def group(self) -> NDArray[np.intp]:
        """Which rows (m,) hang together, counted from 0: those of a block of time, else those of a joint position."""
        return self.position if self.block is None else np.unique(self.block, return_inverse=True)[1]

    def away(self, left: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which rows (m,) are none of those left out, nor nearer to one in time than errors are alike."""
        rest = ~left
        if self.block is None or self.t_s is None or not left.any():
            return rest
        # the nearest in time of those left out, before and behind
        times = np.sort(self.t_s[left])
        k = np.searchsorted(times, self.t_s)
        before, after = times[np.maximum(k - 1, 0)], times[np.minimum(k, len(times) - 1)]
        near = np.minimum(np.abs(self.t_s - before), np.abs(self.t_s - after)) <= self.gap_s
        return np.asarray(rest & ~near)

    def take(self, rows: NDArray[np.intp]) -> ArmPoints:
        """Return the measurements of some rows."""
        row = np.arange(len(self)) if self.row is None else self.row
        arrays = ("q", "xyz_m", "rotation", "point", "t_s", "block", "covariance")
        return taken(self, rows, *arrays, row=row[rows])

    def whiten(self, vectors: Array, sigma_m: float) -> Array:
        """Return (m, 3, ...) in units of each row's noise: sigma_m in every coordinate, beside its own covariance."""
        if self.covariance is None:
            return vectors / sigma_m
        # L L' is a row's covariance and what that leaves unexplained: L^-1 r has components of unit variance
        L = np.linalg.cholesky(self.covariance + sigma_m**2 * np.eye(3))
        return np.asarray(np.linalg.solve(L, vectors.reshape(len(self), 3, -1)).reshape(vectors.shape))

    def weight_notes(self, sigma_m: float) -> tuple[str, ...]:
        """Return that the covariances weigh, with sigma_m that they leave unexplained, or why they do not."""
        told = (self.unweighed,) if self.unweighed else ()
        if self.covariance is None:
            return told
        own = f"(typically {1e3 * self.typical_m(0.0):.2g} mm in a coordinate)"
        text = f"Rows are weighed by the covariances of their positions {own}"
        return (*told, f"{text} and {1e3 * sigma_m:.2g} mm that these leave unexplained")

    def typical_m(self, sigma_m: float) -> float:
        """Return the noise of one coordinate of the middle row."""
        if self.covariance is None:
            return sigma_m
        own = float(np.median(np.trace(self.covariance, axis1=1, axis2=2))) / 3.0
        return float(np.sqrt(sigma_m**2 + own))


def require_joints(arm: Arm, q: Array) -> None:
    """Raise Inconsistent for joint readings (m, n) of an arm with another number of joints."""
    if q.shape[1] != arm.n:
        raise Inconsistent(
            f"the rows have {q.shape[1]} joint readings, {arm.name} has {arm.n} joints",
            consequence="They cannot be of this arm",
            cure="Give the file of this arm, with q1 .. qn in the order of its joints",
        )


def require_radians(arm: Arm, q: Array) -> None:
    """Raise Inconsistent for joint readings (m, n) that would be many turns."""
    turns = np.abs(q[:, arm.revolute])
    if turns.size and turns.max() > MOST_TURNS_RAD:
        raise Inconsistent(
            f"a joint reading of {turns.max():.4g} rad is {turns.max() / (2 * np.pi):.0f} turns",
            consequence="The arm is not calibrated",
            cure="Give radians; the numbers look like degrees",
        )


def check_points(arm: Arm, points: ArmPoints) -> None:
    """Raise NotEnoughData or Inconsistent for measurements that cannot be of this arm: count, units, other joints."""
    require_joints(arm, points.q)
    if len(points) < FEWEST_ROWS:
        raise NotEnoughData(
            f"{len(points)} measurements; {FEWEST_ROWS} is the least",
            consequence="Even base and tool would fit anything",
            cure="Measure more joint positions",
        )
    check_moves(arm, points)
    require_radians(arm, points.q)
    _check_far(points)
    _check_touched(points)
    check_units(arm, points.q, points.xyz_m)
    check_spread(points.xyz_m, "the positions")


def _check_touched(points: ArmPoints) -> None:
    """Raise Inconsistent where many joint positions are at a few places to the last digit: points that were touched."""
    places = len(np.unique(points.xyz_m, axis=0))
    if places > MOST_TOUCHED or int(points.position.max()) + 1 < TOUCHES * places:
        return
    raise Inconsistent(
        f"the {len(points)} rows have {places} position{'s' * (places > 1)} to the last digit, and the joints moved: "
        "fixed points that the tool touched",
        consequence="Such rows say only that the tool came back there, and are no measured positions",
        cure="Give the table with --touch in place of --points; or measure where the tool is at each joint position (a "
        "tracker, or a light and `armsight measure`)",
    )


def _check_far(points: ArmPoints) -> None:
    """Raise Inconsistent where a position is further off than any is in any unit, by its row."""
    far = np.abs(points.xyz_m).max(axis=1)
    worst = int(np.argmax(far))
    if far[worst] > FARTHEST:
        raise Inconsistent(
            f"row {worst if points.row is None else points.row[worst]}: a position of {far[worst]:.3g} m",
            consequence="Nothing is computed from the positions",
            cure="Correct the row, or leave it out",
        )


def check_moves(arm: Arm, points: ArmPoints) -> None:
    """Raise NotEnoughData where too few joint positions were measured, or the joints hardly moved between them."""
    count = int(points.position.max()) + 1
    if count < FEWEST_POSITIONS:
        raise NotEnoughData(
            f"the {len(points)} rows are of {count} joint position{'s' * (count > 1)}; {FEWEST_POSITIONS} is the least",
            consequence="Even base and tool would fit anything",
            cure="Measure at more joint positions; further rows at the same ones do not help",
        )
    moved = np.ptp(points.q, axis=0)
    most = int(np.argmax(moved / np.where(arm.revolute, 1.0, arm.length_m)))
    if moved[most] < LEAST_MOVE * (1.0 if arm.revolute[most] else arm.length_m):
        unit = "rad" if arm.revolute[most] else "m"
        raise NotEnoughData(
            f"the joints hardly moved: {arm.joints[most].name} the most, by {moved[most]:.3g} {unit}",
            consequence="What the arm did is lost in the noise of the positions",
            cure="Measure joint positions far apart, over the ranges that the arm is used in",
        )


def check_units(arm: Arm, q: Array, xyz_m: Array) -> None:
    """Raise Inconsistent where positions (k, 3) spread too far, or too little, for the tool at readings (m, n)."""
    there = fk(arm, q)[:, :3, 3]
    expected = np.linalg.norm(there - there.mean(axis=0), axis=1).mean()
    seen = np.linalg.norm(xyz_m - xyz_m.mean(axis=0), axis=1).mean()
    check_scale(float(expected), float(seen), f"{arm.name} moves its tool")


def check_scale(expected_m: float, seen_m: float, what: str) -> None:
    """Raise Inconsistent where two mean spreads differ as only units do. what: what spreads as expected, in words."""
    if not expected_m > 0.0:
        return
    ratio = seen_m / expected_m
    if 1.0 / ABSURD < ratio < ABSURD:
        return
    unit = UNITS[min(UNITS, key=lambda factor: abs(np.log(max(ratio, 1e-12) / factor)))]
    raise Inconsistent(
        f"the positions spread {ratio:.4g} times as far as {what}",
        consequence="Nothing is computed from them",
        cure=f"Give metres; the numbers look like {unit}, where they are of this arm and this run",
    )


# Rows that are not independent without saying so: readings of one joint position, samples of one motion.

SAME_PLACE = 1e-3
"""Readings of one place differ by no more (rad, m): what a controller holds a joint to is a tenth of it."""
APART = 1e3
"""Between the tool's points in the space that places are looked for in: never one place."""
FEWEST_SAMPLES = 60
"""Rows from which an order is looked for: of fewer, steps are small by chance."""
SMOOTH = 0.05
"""Squared steps from row to row over those of rows in random order, of every joint that moves, below which rows follow
one motion; a scan by one joint after the other has one that jumps."""
MOVES = 0.01
"""A joint that moved less (rad, m) says nothing of the order."""


def of_places(points: ArmPoints) -> ArmPoints:
    """Return one row for all readings of a point at a joint position, their mean; as they are where nothing repeats.

    What the arm has wrong there (gears, give, play) all of them have.
    """
    label = np.array([points.labels.index(name) for name in points.point], float)
    of = repeats(np.column_stack([points.q, APART * label]), SAME_PLACE)
    if of.max() + 1 == len(points):
        return points
    first = np.unique(of, return_index=True)[1]
    count = np.bincount(of)[:, None, None]
    rotation, covariance = points.rotation, points.covariance
    return replace(
        points.take(first),
        q=means(points.q, of),
        xyz_m=means(points.xyz_m, of),
        rotation=None if rotation is None else Rotation.from_matrix(means(rotation, of)).as_matrix(),
        t_s=None if points.t_s is None else means(points.t_s, of),
        # what readings say of their own noise averages out; what is the place's the fit finds beside it
        covariance=None if covariance is None else means(covariance, of) / count,
    )


def in_order(points: ArmPoints) -> ArmPoints:
    """Return rows without times that follow one motion with their order for a time; others as they are."""
    if points.t_s is not None or len(points) < FEWEST_SAMPLES:
        return points
    moves = np.ptp(points.q, axis=0) > MOVES
    steps = np.diff(points.q[:, moves], axis=0)
    share = (steps**2).mean(axis=0) / (2.0 * points.q[:, moves].var(axis=0))
    if not moves.any() or share.max() > SMOOTH:
        return points
    order = np.concatenate([[0], np.cumsum((np.diff(points.q, axis=0) != 0.0).any(axis=1))])
    return replace(points, t_s=order.astype(float), counted=True)
