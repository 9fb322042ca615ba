"""A path as it is to be run: sampled so that turning counts too, its corners rounded, and woven."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation, Slerp

from armsight.arrays import Array
from armsight.control.play.timing import Samples, quats
from armsight.errors import Inconsistent, UsageError
from armsight.records import WELD_OFF, WELD_ON, TaughtPath
from armsight.units import DEG, MM

MOST_M = {"amplitude_m": 0.025, "wavelength_m": 0.1}
"""Wider or longer weaves are millimetres taken for metres: welding robots weave by 25 mm at most."""
HARMONICS = 3
"""Of a zigzag: its flanks are straight to a few per cent, its tips round, so that the arm need not stop there."""


class WeaveKind(StrEnum):
    """What a weave looks like from above."""

    NONE = "none"
    SINE = "sine"
    ZIGZAG = "zigzag"


@dataclass(frozen=True, slots=True, kw_only=True)
class Weave:
    """amplitude_m: from the seam to the farthest position on either side. wavelength_m: along the seam."""

    kind: WeaveKind = WeaveKind.NONE
    amplitude_m: float = 0.0
    wavelength_m: float = 0.0

    def __post_init__(self) -> None:
        if self.kind is WeaveKind.NONE:
            return
        for name in ("amplitude_m", "wavelength_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and 0.0 < value <= MOST_M[name]):
                raise UsageError(
                    f"the weave's {name} is {value:g}, which is not above zero and up to {MOST_M[name]:g} m",
                    cure="Give metres, for instance --weave sine:0.002:0.008",
                )

    @classmethod
    def parse(cls, text: str) -> Weave:
        """Return the weave of a text none, sine:AMPLITUDE:WAVELENGTH or zigzag:..., in m. Raises UsageError."""
        name, *numbers = text.split(":")
        try:
            kind = WeaveKind(name)
            values = [float(part) for part in numbers]
            if len(values) != (0 if kind is WeaveKind.NONE else 2):
                raise ValueError
        except ValueError:
            raise UsageError(
                f"{text[:60]!r} is no weave",
                cure="Give none, sine:AMPLITUDE:WAVELENGTH or zigzag:AMPLITUDE:WAVELENGTH in metres",
            ) from None
        return cls() if not values else cls(kind=kind, amplitude_m=values[0], wavelength_m=values[1])

    def offset_m(self, s_m: ArrayLike) -> Array:
        """Return the offset across the seam (n,) at lengths s_m (n,) along it; 0 at length 0."""
        s = np.asarray(s_m, dtype=np.float64)
        if self.kind is WeaveKind.NONE:
            return np.zeros_like(s)
        phase = s / self.wavelength_m
        if self.kind is WeaveKind.SINE:
            return np.asarray(self.amplitude_m * np.sin(2.0 * np.pi * phase))
        return self.amplitude_m * _zigzag(phase)


def _zigzag(phase: Array) -> Array:
    """Return a zigzag (n,) of height 1 with tips rounded: the first harmonics of a triangular wave."""
    angle = 2.0 * np.pi * phase
    rows = [(-1) ** k * np.sin((2 * k + 1) * angle) / (2 * k + 1) ** 2 for k in range(HARMONICS)]
    return np.asarray(np.sum(rows, axis=0) / sum(1.0 / (2 * k + 1) ** 2 for k in range(HARMONICS)))


TURN_M = 0.02
"""Turning by a radian counts as so much of a path: one degree per 0.35 mm, and less is only as long as it is."""
STEP_M = 2.5e-4
"""Between two samples of a path, 0.7 degrees where it only turns."""
MOST_SAMPLES = 40_000
"""Ten metres at STEP_M; longer paths are sampled more coarsely."""
PER_WAVE = 40
"""Least samples of a wave of a weave."""
BLEND_SHARE = 0.5
"""Of a path, over which its corners may be rounded."""
MOST_PIECES, LEAST_M2 = 100, 1e-30
"""Straight pieces to either side that a sample's distance from the path is taken from; (1 fm)^2: keeps it finite."""
LEAST_MEAN = 0.9
"""Of the mean of quaternions over a corner: below it they differ by more than 100 degrees, and the mean is none."""
TURN_TOLD_RAD = 45.0 * DEG
"""From here on it is told that the tool turns where the tip hardly moves."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shape(Samples):
    """A path as run; u: its length, or its turning where that is more (TURN_M). paced_m (n, 3): without the weave.

    rounded_m, rounded_rad: how far rounding moves and turns it at most. turns: where the tool turns though the tip
    hardly moves, in words.
    """

    rounded_m: float
    rounded_rad: float
    turns: str

    @property
    def tip_m(self) -> Array:
        """The path's positions (n, 3) as they are run."""
        return self.T[:, :3, 3]


def shaped(path: TaughtPath, blend_m: float, weave: Weave, speed_m_s: float) -> Shape:
    """Return a path whose rows all differ, with its corners rounded over blend_m and woven.

    speed_m_s: where a row says none. Three running means (a cubic B-spline) over blend_m in all: curvature has no
    jump, both ends stay. Raises UsageError where blend_m is most of the path, Inconsistent where the mean of rotations
    or the weave has no direction.
    """
    way, turn = steps(path)
    at_rows = np.concatenate([[0.0], np.cumsum(np.maximum(way, TURN_M * turn))])
    u = _sampled(at_rows, blend_m, weave)
    drawn = _drawn(path, at_rows, u)
    width = max(3, 2 * round(blend_m / u[1] / 6.0) + 1)
    smooth = _smoothed(drawn, width)
    T = np.tile(np.eye(4), (len(u), 1, 1))
    T[:, :3, 3], s = smooth[:, :3], smooth[:, 7]
    T[:, :3, :3] = _mean_rotation(smooth[:, 3:7], s).as_matrix()
    turned = Rotation.from_matrix(T[:, :3, :3]) * Rotation.from_quat(drawn[:, 3:7]).inv()
    row = np.clip(np.searchsorted(at_rows, u + 1e-12, side="right") - 1, 0, len(at_rows) - 2)
    own = path.speed_m_s[row]
    woven, turned_m = _woven(T, drawn[:, :3], u, s, weave, _welded(path, s))
    return Shape(
        u=u,
        T=woven,
        s_m=s,
        paced_m=T[:, :3, 3],
        wanted_m_s=np.where(np.isfinite(own), own, speed_m_s),
        rounded_m=_apart(path.xyz_m, at_rows, smooth[:, :3], drawn[:, :3], u[1], 3 * width) + turned_m,
        rounded_rad=float(turned.magnitude().max()),
        turns=_turns(path, way, turn),
    )


def steps(path: TaughtPath) -> tuple[Array, Array]:
    """Return the way in m and the angle in rad, each (n - 1,), from each row to the next."""
    R = path.poses.rotation
    way = np.linalg.norm(np.diff(path.xyz_m, axis=0), axis=1)
    return way, np.asarray((R[1:] * R[:-1].inv()).magnitude())


def welds_of(path: TaughtPath) -> tuple[tuple[float, bool], ...]:
    """Return lengths at which a weld is switched, and whether on."""
    s = path.length_m
    return tuple((float(s[row]), tag == WELD_ON) for row, tag in enumerate(path.tags) if tag in (WELD_ON, WELD_OFF))


def _turns(path: TaughtPath, way: Array, turn: Array) -> str:
    """Return where the tool turns most though the tip hardly moves, in words; empty for less than TURN_TOLD_RAD."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], TURN_M * turn > way, [False]]).astype(int)))
    runs = [slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    if not runs:
        return ""
    most = max(runs, key=lambda run: float(turn[run].sum()))
    if turn[most].sum() < TURN_TOLD_RAD:
        return ""
    length_m = float(way[most].sum())
    where = "in one place" if length_m < 1e-5 else f"over {length_m / MM:.2g} mm"
    return f"the tool turns by {turn[most].sum() / DEG:.0f} deg {where} at {path.length_m[most.start]:.3f} m"


def _sampled(at_rows: Array, blend_m: float, weave: Weave) -> Array:
    total = float(at_rows[-1])
    if blend_m > BLEND_SHARE * total:
        raise UsageError(
            f"corners shall be rounded over {blend_m / MM:.1f} mm of a path of {total / MM:.1f} mm",
            consequence="Little of the path would be left, and nothing is moved",
            cure="Round them less (--blend, in m)",
        )
    step = max(STEP_M, total / MOST_SAMPLES)
    if weave.kind is not WeaveKind.NONE:
        step = min(step, weave.wavelength_m / PER_WAVE)
    return np.linspace(0.0, total, max(8, int(np.ceil(total / step))) + 1)


def _drawn(path: TaughtPath, at_rows: Array, u: Array) -> Array:
    """Return the path as given at u (n,): positions, quaternions and lengths (n, 8), even between rows."""
    turns = Slerp(at_rows, path.poses.rotation)(u).as_matrix()
    columns = np.concatenate([path.xyz_m, path.length_m[:, None]], axis=1)
    between = np.stack([np.interp(u, at_rows, column) for column in columns.T], axis=1)
    return np.concatenate([between[:, :3], quats(turns), between[:, 3:]], axis=1)


def _smoothed(rows: Array, width: int) -> Array:
    """Return the means (n, k) of rows; beyond its ends the path goes on as its mirror image in the point."""
    pad = min(3 * width, len(rows) - 1)
    long = np.concatenate([2.0 * rows[0] - rows[pad:0:-1], rows, 2.0 * rows[-1] - rows[-2 : -pad - 2 : -1]])
    for _ in range(3):
        long = uniform_filter1d(long, width, axis=0, mode="nearest")
    return np.asarray(long[pad : pad + len(rows)])


def _apart(rows: Array, at_rows: Array, smooth: Array, drawn: Array, step_m: float, reach: int) -> float:
    """Return how far, at most, the smooth path (n, 3) is from the drawn one, and the rows (m, 3) from the smooth one.

    reach: samples before and behind among which the nearest straight piece is looked for.
    """
    n, found = len(drawn), 0.0
    for points, at, line in (
        (smooth, np.arange(n), drawn),
        (rows, np.rint(at_rows / step_m).astype(np.intp), smooth),
    ):
        least = np.full(len(points), np.inf)
        stride = max(1, reach // MOST_PIECES)
        for k in range(-reach, reach, stride):
            a = line[np.clip(at + k, 0, n - 1)]
            d = line[np.clip(at + k + stride, 0, n - 1)] - a
            share = np.sum((points - a) * d, axis=1) / np.maximum(np.sum(d * d, axis=1), LEAST_M2)
            gap = points - a - np.clip(share, 0.0, 1.0)[:, None] * d
            least = np.minimum(least, np.sum(gap * gap, axis=1))
        found = max(found, float(np.sqrt(least.max())))
    return found


def _mean_rotation(quaternions: Array, s: Array) -> Rotation:
    """Return the rotations of means of quaternions (n, 4). Raises Inconsistent where those averaged differ too much."""
    size = np.linalg.norm(quaternions, axis=1)
    worst = int(np.argmin(size))
    if size[worst] < LEAST_MEAN:
        raise Inconsistent(
            f"at {s[worst]:.3f} m the tool turns too far within the length over which corners are rounded",
            consequence="Its rotation there has no mean, and nothing is moved",
            cure="Round the corners less (--blend, in m)",
        )
    return Rotation.from_quat(quaternions)


def _welded(path: TaughtPath, s: Array) -> Array:
    """Return 1 where the tip welds and 0 elsewhere (n,); 1 everywhere on a path without such tags."""
    welds = welds_of(path)
    if not welds:
        return np.ones_like(s)
    on = np.full(len(s), not welds[0][1], dtype=bool)
    for at_m, state in welds:
        on[s >= at_m - 1e-9] = state
    return on.astype(np.float64)


def _woven(T: Array, drawn: Array, u: Array, s: Array, weave: Weave, welded: Array) -> tuple[Array, float]:
    """Return the poses woven across the path in the tool's plane; it grows and fades where welds are switched.

    And how far, at most, rounding has turned the weave away from that across the path as drawn (n, 3), in m.
    """
    if weave.kind is WeaveKind.NONE:
        return T, 0.0
    tangent = np.gradient(T[:, :3, 3], u, axis=0)
    along = np.linalg.norm(tangent, axis=1)
    across = np.cross(T[:, :3, 2], tangent)
    size = np.linalg.norm(across, axis=1)
    given = np.cross(T[:, :3, 2], np.gradient(drawn, u, axis=0))
    given /= np.maximum(np.linalg.norm(given, axis=1), 1e-12)[:, None]
    worst = int(np.argmin(size))
    if size[worst] < 0.2 * along.max():
        stands = along[worst] < 0.2 * along.max()
        raise Inconsistent(
            f"at {s[worst]:.3f} m the tool turns and the tip stands"
            if stands
            else f"at {s[worst]:.3f} m the path runs along the tool's own axis",
            consequence="There is no direction to weave in, and nothing is moved",
            cure="Leave --weave out" if stands else "Tilt the tool (armsight path angle), or leave --weave out",
        )
    width = max(3, round(0.5 * weave.wavelength_m / u[1]))
    share = welded
    for _ in range(3):
        share = uniform_filter1d(share, width, mode="nearest")
    out = T.copy()
    offset_m = share * weave.offset_m(s)
    out[:, :3, 3] += (offset_m / size)[:, None] * across
    turned = np.linalg.norm(across / size[:, None] - given, axis=1)
    return out, float((np.abs(offset_m) * turned).max())
