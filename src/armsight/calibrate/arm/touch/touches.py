"""What an arm touched: joint readings while its tip rested on spikes, planes and balls, or moved a dial gauge."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.arm.points import SAME_PLACE, ArmPoints, check_moves, require_joints, require_radians
from armsight.errors import Inconsistent, NotEnoughData
from armsight.fitting.groups import means, repeats, taken
from armsight.kinematics import Arm
from armsight.records.checks import freeze


class Kind(StrEnum):
    """What is touched: a spike or socket, a flat, a ball, or the anvil of a dial gauge, whose reading then counts."""

    POINT = "point"
    PLANE = "plane"
    SPHERE = "sphere"
    GAUGE = "gauge"


FEWEST = {Kind.POINT: 3, Kind.PLANE: 5, Kind.SPHERE: 6, Kind.GAUGE: 6}
"""Touches of a feature: fewer hardly say more than where it is."""
FEWEST_TOUCHES = 10
"""Equations beyond the tip and one feature that can tell a zero at all."""
FEWEST_OF_TIP = 6
"""Touches with one of several tips: fewer hardly say more than where it is."""
FARTHEST_M = 20.0
"""No arm's features are further apart: such a length is in millimetres."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownLength:
    """A length in m that was measured, and how well: between points or balls' centres a and b, or a's radius (b '')."""

    a: str
    b: str = ""
    length_m: float
    sigma_m: float

    @property
    def words(self) -> str:
        """What it is of."""
        return f"the distance of {self.a} and {self.b}" if self.b else f"the radius of {self.a}"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Touches:
    """Joint values q (m, n) in rad or m, with the feature (m,) that each touches, and its kind (m,).

    reading_m: (m,) of the gauge, growing as the tip moves away along its axis; 0 of other kinds. sigma_m: (m,)
    standard deviation of the row's own reading or touch, 0 where it is not known; what scatters beyond it is found.
    lengths: what was measured beside them. row: (m,) of the table, from 0. tip: (m,) names which of the tool's tips
    touched, "" of one alone.
    """

    q: Array
    feature: tuple[str, ...]
    kind: tuple[Kind, ...]
    reading_m: Array
    sigma_m: Array
    lengths: tuple[KnownLength, ...] = ()
    row: NDArray[np.intp]
    tip: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        m = len(self.feature)
        object.__setattr__(self, "tip", self.tip or ("",) * m)
        freeze(self, q=(m, np.shape(self.q)[-1]), reading_m=(m,), sigma_m=(m,))

    def __len__(self) -> int:
        return len(self.feature)

    @property
    def kinds(self) -> dict[str, Kind]:
        """The kind of each feature, in the order in which they come."""
        return dict(zip(self.feature, self.kind, strict=True))

    @property
    def which(self) -> NDArray[np.intp]:
        """Which feature (m,) each row is of, in the order of kinds."""
        number = {name: k for k, name in enumerate(self.kinds)}
        return np.array([number[name] for name in self.feature], dtype=np.intp)

    @property
    def tips(self) -> tuple[str, ...]:
        """The names of the tips, sorted."""
        return tuple(sorted(set(self.tip)))

    @property
    def of_tip(self) -> NDArray[np.intp]:
        """Which tip (m,) touched in each row, in the order of tips."""
        return np.asarray(np.unique(self.tip, return_inverse=True)[1])

    @property
    def scalar(self) -> NDArray[np.bool_]:
        """Which rows (m,) say one number, not three."""
        return np.array([kind is not Kind.POINT for kind in self.kind])

    def take(self, rows: NDArray[np.intp]) -> Touches:
        """Return some rows, with all lengths."""
        return taken(self, rows, "q", "feature", "kind", "reading_m", "sigma_m", "row", "tip")

    def as_points(self) -> ArmPoints:
        """Return the rows as those of a tool's point, whose places nobody measured (zeros)."""
        return ArmPoints(q=self.q, xyz_m=np.zeros((len(self), 3)), row=self.row, point=self.tip)


def check_touches(arm: Arm, touches: Touches) -> None:
    """Raise NotEnoughData or Inconsistent for touches that cannot tell anything of this arm."""
    require_joints(arm, touches.q)
    require_radians(arm, touches.q)
    if len(touches) < FEWEST_TOUCHES:
        raise NotEnoughData(
            f"{len(touches)} touches; {FEWEST_TOUCHES} is the least",
            consequence="They hardly tell more than where tip and features are",
            cure="Touch the same features from many more postures: two spikes 25 times each",
        )
    for name, kind in touches.kinds.items():
        rows = [k for label, k in zip(touches.feature, touches.kind, strict=True) if label == name]
        if set(rows) != {kind}:
            raise Inconsistent(
                f"{name} is called {' and '.join(sorted(set(rows)))}",
                consequence="Nobody knows what was touched",
                cure="Give each feature one kind, or two names",
            )
        if len(rows) < FEWEST[kind]:
            raise NotEnoughData(
                f"{name} was touched {len(rows)} times; {FEWEST[kind]} times is the least for a {kind}",
                consequence="That hardly says more than where it is",
                cure=f"Touch it from more postures, or leave {name} out",
            )
    for name, count in zip(touches.tips, np.bincount(touches.of_tip).tolist(), strict=True):
        if name and count < FEWEST_OF_TIP:
            raise NotEnoughData(
                f"the tip {name} touched {count} times; {FEWEST_OF_TIP} times is the least",
                consequence="That hardly says more than where the tip is",
                cure=f"Touch with it from more postures, or leave the rows of {name} out",
            )
    _check_lengths(touches)
    check_moves(arm, touches.as_points())


def _check_lengths(touches: Touches) -> None:
    centred = [name for name, kind in touches.kinds.items() if kind in (Kind.POINT, Kind.SPHERE)]
    balls = [name for name, kind in touches.kinds.items() if kind is Kind.SPHERE]
    for known in touches.lengths:
        ends = [known.a, *([known.b] if known.b else [])]
        unknown = [name for name in ends if name not in (centred if known.b else balls)]
        if unknown or len(set(ends)) < len(ends):
            what = "point or sphere" if known.b else "sphere"
            raise Inconsistent(
                f"{known.words} is given, and {', '.join(unknown) or known.a} is no {'other ' * (not unknown)}{what} "
                "that was touched",
                consequence="Nobody knows what it is of",
                cure=f"Name what the table does: {', '.join(centred if known.b else balls) or 'it has none'}",
            )
        if not 0.0 < known.length_m < FARTHEST_M:
            raise Inconsistent(
                f"{known.words} is given as {known.length_m:g} m",
                consequence="Nothing is computed from it",
                cure="Give metres, or the unit with the number (270mm)",
            )


def of_postures(touches: Touches) -> Touches:
    """Return one row, their mean, for touches of a feature by a tip in one posture: they share what the arm has wrong
    there."""
    # features and tips are apart in this space: never one place
    of = repeats(np.column_stack([touches.q, 1e3 * touches.which, 1e3 * touches.of_tip]), SAME_PLACE)
    if of.max() + 1 == len(touches):
        return touches
    first = np.unique(of, return_index=True)[1]
    return replace(touches.take(first), q=means(touches.q, of), reading_m=means(touches.reading_m, of))
