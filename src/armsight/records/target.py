"""What is looked for: lights in a known arrangement, or a printed board."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from types import NoneType

import numpy as np
from numpy.typing import NDArray

from armsight.errors import Inconsistent
from armsight.records import checks
from armsight.records.by_value import Saveable


class TargetKind(StrEnum):
    """The kinds of target; the first is lights, the others are printed."""

    SPOTS = "spots"
    CHECKERBOARD = "checkerboard"
    CIRCLES = "circles"
    ACIRCLES = "acircles"
    CHARUCO = "charuco"
    APRILGRID = "aprilgrid"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Colour:
    """A beacon's colour: hue range in degrees (wrapping through 360), least saturation and value in 0..1."""

    hue_deg: tuple[float, float]
    min_saturation: float = 0.3
    min_value: float = 0.3

    def __post_init__(self) -> None:
        hue_deg = checks.frozen_array("hue_deg", self.hue_deg, (2,))
        object.__setattr__(self, "hue_deg", tuple(hue_deg.tolist()))
        checks.require_numbers(self, "min_saturation", "min_value")
        if not ((hue_deg >= 0.0) & (hue_deg <= 360.0)).all():
            raise Inconsistent(f"hue {self.hue_deg} is outside 0 to 360 degrees", cure="Give (from, to) in degrees")
        if not (0.0 <= self.min_saturation <= 1.0 and 0.0 <= self.min_value <= 1.0):
            raise Inconsistent("saturation and value run from 0 to 1", cure="Give shares, not per cent")


RED = Colour(hue_deg=(340.0, 20.0))
GREEN = Colour(hue_deg=(90.0, 150.0))
BLUE = Colour(hue_deg=(200.0, 260.0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Target(Saveable):
    """Points of the target in its own frame, in m.

    names: of the points. xyz_m: (n, 3). For boards the points run row by row, the pattern in the plane
    z = 0, x along the columns, y along the rows, origin at the first point; columns and rows count inner
    corners or circles, of ChArUco boards squares, of AprilGrids tags. diameter_m: of a flat round light, where known.
    colour: of a beacon, where it is
    found by colour. A beacon is a target with one spot. model_known is False where the spots' arrangement has not
    been measured: then names give only their labels, xyz_m is zeros, and the frame follows
    Pachidis eqs. (7)-(8). covariance: (3 n, 3 n) m^2 of the measured positions in the order of names, x y z each; None
    where the positions are taken as exact.
    """

    kind: TargetKind
    names: tuple[str, ...]
    xyz_m: NDArray[np.float64]
    diameter_m: float | None = None
    colour: Colour | None = None
    columns: int = 0
    rows: int = 0
    pitch_m: float = 0.0
    marker_m: float = 0.0
    dictionary: str = ""
    model_known: bool = True
    covariance: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", checks.one_of(TargetKind, "kind", self.kind))
        object.__setattr__(self, "names", checks.require_texts("names", self.names))
        checks.require_kind("colour", self.colour, Colour, NoneType)
        checks.require_kind("dictionary", self.dictionary, str)
        checks.require_kind("model_known", self.model_known, bool)
        checks.require_numbers(self, "diameter_m", "pitch_m", "marker_m")
        for count in ("columns", "rows"):
            checks.require_count(count, getattr(self, count))
        checks.freeze(self, xyz_m=(len(self.names), 3))
        if self.covariance is not None:
            size = 3 * len(self.names)
            checks.freeze(self, covariance=(size, size))
        if not self.names or len(set(self.names)) != len(self.names):
            raise Inconsistent(
                "a target needs at least one spot, and every spot a name of its own",
                consequence="There is nothing to look for",
                cure="Name the lights A, B, C ... and give each its place",
            )
        checks.check_metres(np.ptp(self.xyz_m, axis=0).max(), checks.TARGET_M, "the target's points spread over")
        checks.check_metres(
            np.linalg.norm(self.xyz_m, axis=1).max(), checks.TARGET_M, "a point of the target lies off its origin by"
        )
        if self.diameter_m is not None and not self.diameter_m > 0.0:
            raise Inconsistent(f"a spot's diameter of {self.diameter_m} m is not positive", cure="Leave it out")
        checks.check_metres(self.diameter_m or 0.0, checks.PITCH_M, "a spot of the target has a diameter of")

    @property
    def covariance_names(self) -> tuple[str, ...]:
        """Names of the covariance's rows: 'A.x_m', 'A.y_m', 'A.z_m', 'B.x_m', ..."""
        return tuple(f"{name}.{axis}_m" for name in self.names for axis in "xyz")

    @property
    def is_board(self) -> bool:
        """Whether it is printed rather than lit."""
        return self.kind is not TargetKind.SPOTS


def spot_target(
    spots_m: dict[str, tuple[float, float, float]],
    *,
    diameter_m: float | None = None,
    colour: Colour | None = None,
    covariance: NDArray[np.float64] | None = None,
) -> Target:
    """Return a lit target from the named positions of its spots in m; covariance (3 n, 3 n) of these, m^2."""
    places = [checks.frozen_array(f"the place of light {name}", position, (3,)) for name, position in spots_m.items()]
    return Target(
        kind=TargetKind.SPOTS,
        names=tuple(spots_m),
        xyz_m=np.array(places).reshape(-1, 3),
        diameter_m=diameter_m,
        colour=colour,
        covariance=covariance,
    )


def unmeasured_target(*, diameter_m: float | None = None, colour: Colour | None = None) -> Target:
    """Return a target of three lights A, B, C whose arrangement nobody has measured."""
    return Target(
        kind=TargetKind.SPOTS,
        names=("A", "B", "C"),
        xyz_m=np.zeros((3, 3)),
        diameter_m=diameter_m,
        colour=colour,
        model_known=False,
    )


def board_target(
    kind: TargetKind,
    columns: int,
    rows: int,
    pitch_m: float,
    *,
    marker_m: float = 0.0,
    dictionary: str = "",
) -> Target:
    """Return a printed board of columns x rows points (inner corners or circles), pitch_m apart.

    For ACIRCLES pitch_m is the distance between neighbours of one row's half step: point (row r, column c)
    is at x = (2 c + r mod 2) pitch, y = r pitch, as in OpenCV's asymmetric grid. For CHARUCO columns and
    rows count squares, as OpenCV does, and the points are the (columns-1) x (rows-1) inner corners.
    For APRILGRID they count tags, pitch_m from tag to tag and marker_m wide, and the points are the tags' corners as
    Kalibr numbers them: row by row from the lower left one of tag 0, y up.
    Raises Inconsistent for sizes that no board has.
    """
    if kind is TargetKind.SPOTS:
        raise Inconsistent("a board is a checkerboard, circles, acircles, charuco or aprilgrid")
    if columns < 2 or rows < 2 or not pitch_m > 0.0:
        raise Inconsistent(
            f"a board of {columns}x{rows} points {pitch_m} m apart cannot be",
            cure="Count the inner corners, circles, squares (ChArUco) or tags (AprilGrid), two or more each way, and "
            "give the pitch in metres",
        )
    checks.check_metres(pitch_m, checks.PITCH_M, "the board's points are apart by")
    n_columns, n_rows = (columns - 1, rows - 1) if kind is TargetKind.CHARUCO else (columns, rows)
    if kind is TargetKind.APRILGRID:
        n_columns, n_rows = 2 * columns, 2 * rows
    r, c = np.mgrid[0:n_rows, 0:n_columns]
    x = (2 * c + r % 2 if kind is TargetKind.ACIRCLES else c) * pitch_m
    y = r * pitch_m
    if kind is TargetKind.APRILGRID:
        x, y = (k // 2 * pitch_m + k % 2 * marker_m for k in (c, r))
    xyz = np.stack([x, y, np.zeros(r.shape)], axis=-1).reshape(-1, 3)
    return Target(
        kind=kind,
        names=tuple(f"r{i}c{j}" for i in range(n_rows) for j in range(n_columns)),
        xyz_m=xyz,
        columns=columns,
        rows=rows,
        pitch_m=pitch_m,
        marker_m=marker_m,
        dictionary=dictionary,
    )
