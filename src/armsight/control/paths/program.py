"""A path as the motions of a controller's program: what all exports share."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.records import WELD_OFF, WELD_ON, TaughtPath, frozen_array
from armsight.units import DEG

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,23}")
"""KRL names have at most 24 letters, digits and underscores."""
MOST_ROWS = 20_000
BLEND_SHARE = 0.45
"""Of the way to a neighbour: controllers stop where the blends of two neighbours overlap."""
APPROACH_M, APPROACH_SPEED_M_S = 0.05, 0.05
MOST_ACCELERATION_M_S2 = 50.0
"""Five times gravity, as the quickest picking arms have; mm/s^2 taken for m/s^2 go beyond."""
JOINT_SPEED = 0.2
"""rad/s, of the joint motion to the first position, from wherever the arm stands."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProgramMove:
    """A straight motion to T_base_tip (4, 4): speed, radius of its blend, 0 for a stop; tag: what happens there."""

    T_base_tip: Array
    speed_m_s: float
    blend_m: float
    tag: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_base_tip", frozen_array("T_base_tip", self.T_base_tip, (4, 4)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Program:
    """Motions in base axes, the first from wherever the arm stands.

    start (6,): the joints' readings at the first position, rad; None: it is gone to on a straight line. tool: the
    controller's name or number of the tool. T_flange_tool: what that tool must be, where known. weld_output: the name
    or number of the digital output of weld_on and weld_off; None: these are comments.
    """

    name: str
    moves: tuple[ProgramMove, ...]
    acceleration_m_s2: float
    turn_rad_s: float
    start: Array | None = None
    tool: str | None = None
    T_flange_tool: RigidTransform | None = None
    weld_output: str | None = None

    def __post_init__(self) -> None:
        if self.start is not None:
            object.__setattr__(self, "start", frozen_array("start", self.start, (6,)))
        if NAME.fullmatch(self.name) is None:
            raise UsageError(
                f"{self.name[:40]!r} is no program's name",
                cure="Use a letter, then letters, digits and underscores, 24 at most",
            )
        for key in ("acceleration_m_s2", "turn_rad_s"):
            value = getattr(self, key)
            if not (math.isfinite(value) and value > 0.0):
                raise UsageError(f"{key} is {value:g}, which is not positive")
        if self.acceleration_m_s2 > MOST_ACCELERATION_M_S2:
            raise UsageError(
                f"acceleration_m_s2 is {self.acceleration_m_s2:g}, which no arm has",
                cure="Give it in m/s^2; 500 mm/s^2 are 0.5",
            )


def with_approach(path: TaughtPath, approach_m: float) -> TaughtPath:
    """Return the path with a row before its first and behind its last, back from the work along the tool by approach_m.

    The way to and from them goes at APPROACH_SPEED_M_S, or slower where the path does. 0: the path as it is. Raises
    UsageError for a negative way, NotEnoughData below two rows.
    """
    if not (math.isfinite(approach_m) and approach_m >= 0.0):
        raise UsageError(f"an approach of {approach_m:g} m is none")
    if len(path) < 2:
        raise NotEnoughData(f"a path of {len(path)} rows is no motion", consequence="No program is written")
    if approach_m == 0.0:
        return path
    ends = path.T_world_tip[[0, -1]].copy()
    ends[:, :3, 3] -= approach_m * ends[:, :3, 2]
    slow = np.fmin(path.speed_m_s[[0, -2]], APPROACH_SPEED_M_S)
    nothing = np.full(1, np.nan)
    return replace(
        path,
        T_world_tip=np.concatenate([ends[:1], path.T_world_tip, ends[1:]]),
        t_s=np.concatenate([nothing, path.t_s, nothing]),
        speed_m_s=np.concatenate([slow[:1], path.speed_m_s[:-1], slow[1:], slow[1:]]),
        tags=("", *path.tags, ""),
    )


def _require_weld_off(path: TaughtPath) -> None:
    switched = [state for tag in path.tags if (state := weld_state(tag)) is not None]
    if switched and switched[-1]:
        raise Inconsistent(
            "the weld is still on at the end of the path",
            consequence="The arc would burn on through the retreat; no program is written",
            cure="Tag the row where the seam ends weld_off",
        )


def program_moves(
    path: TaughtPath, *, speed_m_s: float | None = None, blend_m: float = 0.0, stops: Sequence[int] = ()
) -> tuple[ProgramMove, ...]:
    """Return the motions of a path in base, one for each row.

    A row's speed is that of the way behind it; speed_m_s where the path leaves it open. blend_m: radius within which a
    motion may go over into the next, less where neighbours are near, none at the ends, at tags and at the rows stops.
    Raises UsageError for a path in another frame, for a speed that is open or none, for a radius that is none;
    Inconsistent for a weld that is never switched off.
    """
    if path.parent != "base":
        raise UsageError(
            f"the path is in the frame {path.parent!r}; controllers take poses in the robot's base",
            cure="Bring it into base first",
        )
    if not 2 <= len(path) <= MOST_ROWS:
        raise Inconsistent(
            f"a path of {len(path)} rows makes no program; 2 to {MOST_ROWS} do",
            consequence="No program is written",
            cure="Resample it",
        )
    if not (math.isfinite(blend_m) and blend_m >= 0.0):
        raise UsageError(f"a blend of {blend_m:g} m is none")
    behind = path.speed_m_s.copy()
    if speed_m_s is not None:
        behind[np.isnan(behind)] = speed_m_s
    speed = np.concatenate([behind[:1], behind[:-1]])  # of the way to each row
    if not (np.isfinite(speed) & (speed > 0.0)).all():
        row = int(np.argmin(np.isfinite(speed) & (speed > 0.0)))
        raise UsageError(
            f"the speed to row {row} of the program is open or not positive",
            cure="Give a speed for where the path has none",
        )
    _require_weld_off(path)
    way = np.diff(path.length_m)
    radius = np.zeros(len(path))
    radius[1:-1] = np.minimum(blend_m, BLEND_SHARE * np.minimum(way[:-1], way[1:]))
    radius[[bool(tag) for tag in path.tags]] = 0.0
    radius[list(stops)] = 0.0
    return tuple(
        ProgramMove(T_base_tip=T, speed_m_s=float(v), blend_m=float(r), tag=tag)
        for T, v, r, tag in zip(path.T_world_tip, speed, radius, path.tags, strict=True)
    )


def weld_state(tag: str) -> bool | None:
    """Return what a tag does to the weld output: on, off, or None for nothing."""
    return {WELD_ON: True, WELD_OFF: False}.get(tag)


def tag_line(tag: str, output: object, switch: Callable[[bool], str], comment: str) -> str:
    """Return the line of a tag: what switches the weld output, else, or without one, a comment with the tag for {}."""
    on = weld_state(tag)
    return comment.format(ascii_only(tag)) if on is None or output is None else switch(on)


def ascii_only(text: str) -> str:
    """Return text with what is not ASCII as question marks: controllers take no other."""
    return text.encode("ascii", "replace").decode("ascii")


def decimals(value: float, digits: int) -> str:
    """Return a number with so many decimal places, without a sign on nothing."""
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0.0 else text


def in_degrees(angles: Array) -> list[str]:
    """Return angles in degrees to a ten-thousandth."""
    return [decimals(float(angle) / DEG, 4) for angle in angles]
