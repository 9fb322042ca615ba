"""A taught path made ready to be run: rounded, woven, checked for the arm, and timed within its limits."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.control.guard.limits import Limits, joint_bounds
from armsight.control.paths import PathCheck, PathTrouble, check_path, poses_at
from armsight.control.paths.outliers import SAME_M, distinct_rows, of_rows, path_jumps
from armsight.control.play.track import SPEED_SHARE, Leg, Track, Way, Weave, WeaveKind, quats, timed
from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.kinematics import Arm
from armsight.kinematics.target import target_matrices
from armsight.records import WELD_OFF, WELD_ON, TaughtPath
from armsight.units import MM

Array = NDArray[np.float64]

STEP_M = 2.5e-4
"""Between two samples of a path."""
MOST_SAMPLES = 40_000
"""Ten metres at STEP_M; longer paths are sampled more coarsely."""
PER_WAVE = 40
"""Least samples of a wave of a weave."""
LEG_PLACES = 33
"""Positions of a leg at which the flange's speed is looked at: it differs along a leg that turns about the tip."""
CHECK_M = 1e-3
"""Between two poses that are checked for the arm; also half a millimetre and less where a weave is narrow."""
BLEND_SHARE = 0.5
"""Of a path, over which its corners may be rounded."""
LEAST_SPEED_M_S = 2e-4
"""A path that allows no more than this somewhere has a corner there that nobody can run through."""
SLOWED = frozenset({PathTrouble.SPEED, PathTrouble.TURN, PathTrouble.JOINT_SPEED})
"""What is no trouble: the plan goes slower there."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaySettings:
    """How a path is run.

    speed_m_s: along the path where it says none. blend_m: length over which corners are rounded, with a deviation that
    the plan tells. approach_speed_m_s, retract_m: of the way to the path's start, which begins retract_m before it
    along the tool's axis. keep_rotation: the tool keeps the rotation it has; else it takes the path's.
    """

    speed_m_s: float = 0.01
    blend_m: float = 0.003
    weave: Weave = field(default_factory=Weave)
    approach_speed_m_s: float = 0.02
    retract_m: float = 0.05
    keep_rotation: bool = False

    def __post_init__(self) -> None:
        for name in ("speed_m_s", "blend_m", "approach_speed_m_s"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise UsageError(
                    f"{name} is {value:g}, which is not above zero",
                    consequence="Nothing is moved",
                    cure="Give more than 0",
                )
        if not (np.isfinite(self.retract_m) and self.retract_m >= 0.0):
            raise UsageError(f"retract_m is {self.retract_m:g}", consequence="Nothing is moved", cure="Give 0 or more")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathPlan:
    """A path ready to be run, in base axes.

    approach: legs from where the tip stood to the start. track: the path with its weave. s_m (n,), seam_m (n, 3),
    tip_m (n, 3): samples of the length, of the path without and with weave. welds: lengths at which a weld is switched
    on or off. rounded_m: how far rounding moves the path at most. speed_m_s (n,): as planned. time_s: of all, without
    pauses, at full override. slowest: the place of the least planned speed, in words. fastest_m_s, fastest: the largest
    speed that tip or flange reach anywhere, the way to the path included, and which of them where.
    """

    approach: tuple[Leg, ...]
    track: Track
    s_m: Array
    seam_m: Array
    tip_m: Array
    speed_m_s: Array
    welds: tuple[tuple[float, bool], ...]
    rounded_m: float
    slowest: str
    fastest_m_s: float
    fastest: str
    check: PathCheck

    @property
    def ways(self) -> tuple[Way, ...]:
        """All that is run, one after the other, with a rest between."""
        return (*self.approach, self.track)

    @property
    def length_m(self) -> float:
        """Length of the path along its seam."""
        return self.track.length_m

    @property
    def time_s(self) -> float:
        """About how long it takes, without pauses and at full override."""
        mean = 0.5 * (self.speed_m_s[1:] + self.speed_m_s[:-1])
        legs = sum(leg.length_m / leg.speed_at(0.0) for leg in self.approach)
        return float(np.sum(np.diff(self.s_m) / mean)) + legs


def plan_path(
    path: TaughtPath,
    arm: Arm,
    limits: Limits,
    q: ArrayLike,
    settings: PlaySettings | None = None,
) -> PathPlan:
    """Return the path made ready for an arm that stands at readings q (n,); arm's tool is the tip.

    Raises NotEnoughData for a path of less than two positions, Inconsistent for a path with a jump, out of reach,
    beyond a limit, near a singularity or with a corner that cannot be run through, with the row or length where it is.
    """
    settings = settings or PlaySettings()
    stand = np.asarray(q, dtype=np.float64)
    target_matrices(arm, _in_world(path, arm))  # millimetres are told before they are sampled, for minutes
    T_base_stand = arm.T_world_base.inv() * RigidTransform.from_matrix(arm.fk(arm.values(stand)))
    path = _usable(_in_base(path, arm), settings, T_base_stand)
    s, T_seam, rounded_m = _rounded(path, settings)
    T_tip = _woven(T_seam, s, settings.weave, _welded(path, s))
    legs = _approach(T_base_stand, RigidTransform.from_matrix(T_tip[0]), settings, limits)
    check, q_track, rows = _checked(arm, limits, stand, legs, s, T_tip, keeps=settings.keep_rotation)
    wanted = _wanted_speed(path, s, settings)
    speed = timed(s, T_tip, (s[rows], q_track), wanted, limits, joint_bounds(arm, limits))
    slow = int(np.argmin(speed))
    if speed[slow] < LEAST_SPEED_M_S:
        raise Inconsistent(
            f"the path turns so sharply at {s[slow]:.4f} m that no speed is slow enough",
            consequence="Nothing is moved",
            cure="Round its corners more (--blend), smooth it (armsight path smooth), or give a wider weave",
        )
    fastest_m_s, fastest = _fastest(arm, legs, s, T_tip, speed)
    return PathPlan(
        approach=legs,
        track=Track(T_tip, s, speed),
        s_m=s,
        seam_m=T_seam[:, :3, 3],
        tip_m=T_tip[:, :3, 3],
        speed_m_s=speed,
        welds=_welds(path),
        rounded_m=rounded_m,
        slowest=f"{speed[slow] / MM:.1f} mm/s at {s[slow]:.3f} m" if speed[slow] < 0.99 * wanted[slow] else "",
        fastest_m_s=fastest_m_s,
        fastest=fastest,
        check=check,
    )


def _in_base(path: TaughtPath, arm: Arm) -> TaughtPath:
    """Return the path in base axes."""
    if path.parent == "base":
        return path
    if path.parent != "world":
        raise UsageError(f"the path is in the frame {path.parent!r}", consequence="Nothing is moved")
    T = arm.T_world_base.inv().as_matrix() @ path.T_world_tip
    return replace(path, T_world_tip=T, parent="base")


def _in_world(path: TaughtPath, arm: Arm) -> Array:
    """Return the poses (m, 4, 4) of a path in base or world axes as an arm reaches for them."""
    T = path.T_world_tip
    return arm.T_world_base.as_matrix() @ T if path.parent == "base" else T


def _usable(path: TaughtPath, settings: PlaySettings, T_base_stand: RigidTransform) -> TaughtPath:
    """Return the path without rows at one position and with the rotations to run. Raises for jumps and too few rows."""
    keep = distinct_rows(path)
    if len(keep) < 2:
        raise NotEnoughData(
            f"the path has {len(keep)} places", consequence="Nothing is moved", cure="Give at least two"
        )
    if settings.keep_rotation:
        T = path.T_world_tip.copy()
        T[:, :3, :3] = T_base_stand.rotation.as_matrix()
        path = replace(path, T_world_tip=T)
    for jump in path_jumps(path):
        raise Inconsistent(jump.text, consequence="Nothing is moved", cure=jump.cure)
    return of_rows(path, keep)


def _rounded(path: TaughtPath, settings: PlaySettings) -> tuple[Array, Array, float]:
    """Return lengths (n,), poses (n, 4, 4) of the path with its corners rounded, and how far that moves it, in m.

    Three running means (a cubic B-spline) over blend_m in all: curvature has no jump, both ends stay. The path is
    continued beyond its ends by its mirror image in the point. Raises UsageError where blend_m is most of the path.
    """
    total = float(path.length_m[-1])
    if settings.blend_m > BLEND_SHARE * total:
        raise UsageError(
            f"corners shall be rounded over {settings.blend_m / MM:.1f} mm of a path of {total / MM:.1f} mm",
            consequence="Little of the path would be left, and nothing is moved",
            cure="Round them less (--blend, in m)",
        )
    step = max(STEP_M, total / MOST_SAMPLES)
    if settings.weave.kind is not WeaveKind.NONE:
        step = min(step, settings.weave.wavelength_m / PER_WAVE)
    count = max(8, int(np.ceil(total / step)))
    s = np.linspace(0.0, total, count + 1)
    T = poses_at(path, s)
    width = max(3, 2 * round(settings.blend_m / (s[1] - s[0]) / 6.0) + 1)
    rows = np.concatenate([T[:, :3, 3], quats(T)], axis=1)
    pad = min(3 * width, count)
    long = np.concatenate([2.0 * rows[0] - rows[pad:0:-1], rows, 2.0 * rows[-1] - rows[-2 : -pad - 2 : -1]])
    for _ in range(3):
        long = uniform_filter1d(long, width, axis=0, mode="nearest")
    smooth = long[pad : pad + len(s)]
    out = T.copy()
    out[:, :3, 3] = smooth[:, :3]
    out[:, :3, :3] = Rotation.from_quat(smooth[:, 3:]).as_matrix()
    at_rows = np.stack([np.interp(path.length_m, s, smooth[:, k]) for k in range(3)], axis=1)
    moved = np.concatenate([smooth[:, :3] - T[:, :3, 3], at_rows - path.xyz_m])
    return s, out, float(np.linalg.norm(moved, axis=1).max())


def _welds(path: TaughtPath) -> tuple[tuple[float, bool], ...]:
    """Return lengths at which a weld is switched, and whether on."""
    s = path.length_m
    return tuple((float(s[row]), tag == WELD_ON) for row, tag in enumerate(path.tags) if tag in (WELD_ON, WELD_OFF))


def _welded(path: TaughtPath, s: Array) -> Array:
    """Return 1 where the tip welds and 0 elsewhere (n,); 1 everywhere on a path without such tags."""
    welds = _welds(path)
    if not welds:
        return np.ones_like(s)
    on = np.full(len(s), not welds[0][1], dtype=bool)
    for at_m, state in welds:
        on[s >= at_m - 1e-9] = state
    return on.astype(np.float64)


def _woven(T: Array, s: Array, weave: Weave, welded: Array) -> Array:
    """Return the poses woven across the path in the tool's plane; it grows and fades where welds are switched."""
    if weave.kind is WeaveKind.NONE:
        return T
    tangent = np.gradient(T[:, :3, 3], s, axis=0)
    across = np.cross(T[:, :3, 2], tangent)
    size = np.linalg.norm(across, axis=1)
    if size.min() < 0.2 * np.linalg.norm(tangent, axis=1).max():
        raise Inconsistent(
            f"at {s[int(np.argmin(size))]:.3f} m the path runs along the tool's own axis",
            consequence="There is no direction to weave in, and nothing is moved",
            cure="Tilt the tool (armsight path angle), or leave --weave out",
        )
    width = max(3, round(0.5 * weave.wavelength_m / (s[1] - s[0])))
    share = welded
    for _ in range(3):
        share = uniform_filter1d(share, width, mode="nearest")
    out = T.copy()
    out[:, :3, 3] += (share * weave.offset_m(s) / size)[:, None] * across
    return out


def _approach(stand: RigidTransform, start: RigidTransform, settings: PlaySettings, limits: Limits) -> tuple[Leg, ...]:
    """Return the legs from where the tip stands to the path's start, by way of one before it on the tool's axis."""
    before = start * RigidTransform.from_translation([0.0, 0.0, -settings.retract_m])
    speed = min(settings.approach_speed_m_s, SPEED_SHARE * limits.speed_m_s)
    legs = (Leg(stand, before, speed), Leg(before, start, speed))
    return tuple(leg for leg in legs if leg.length_m > SAME_M)


def _fastest(arm: Arm, legs: tuple[Leg, ...], s: Array, T: Array, speed: Array) -> tuple[float, str]:
    """Return the largest speed that tip or flange reach in m/s, and which of them where; lengths count no weave."""
    ways = [(T, s, speed, "along it")]
    for leg in legs:
        at = np.linspace(0.0, leg.length_m, LEG_PLACES)
        poses = np.array([leg.pose(s).as_matrix() for s in at])
        ways.append((poses, at, np.full(LEG_PLACES, leg.speed_at(0.0)), "on the way to it"))
    T_tool_flange = arm.T_flange_tool.inv().as_matrix()
    found = []
    for poses, at, allowed, where in ways:
        for name, xyz in (("tip", poses[:, :3, 3]), ("flange", (poses @ T_tool_flange)[:, :3, 3])):
            per_m = np.linalg.norm(np.gradient(xyz, at, axis=0), axis=1)
            found.append((float((allowed * per_m).max()), f"the {name}, {where}"))
    return max(found, key=lambda one: round(one[0], 6))  # where both are as fast, the tip along the path is told


def _checked(
    arm: Arm, limits: Limits, stand: Array, legs: tuple[Leg, ...], s: Array, T: Array, *, keeps: bool
) -> tuple[PathCheck, Array, Array]:
    """Return the check of all that is run, and readings (k, n) at the track's rows (k,). Raises Inconsistent.

    keeps: whether the tool's rotation is kept already.
    """
    every = max(1, min(int(CHECK_M / (s[1] - s[0])), 8))
    rows = np.unique(np.append(np.arange(0, len(s), every), len(s) - 1))
    poses, parts = [], []
    for k, leg in enumerate(legs):
        count = max(2, int(np.ceil(leg.length_m / (2.0 * CHECK_M))))
        poses += [leg.pose(at).as_matrix() for at in np.linspace(0.0, leg.length_m, count + 1)[:-1]]
        parts += [f"on the way to the path (leg {k + 1})"] * count
    n = len(poses)
    joined = TaughtPath.of_poses(RigidTransform.from_matrix(np.array([*poses, *T[rows]])), parent="base")
    check = check_path(joined, arm, limits, speed_m_s=limits.speed_m_s, start=stand, taught=False)
    for issue in check.issues:
        if issue.trouble in SLOWED:
            continue
        where = parts[issue.row] if issue.row < n else f"at {s[rows[issue.row - n]]:.3f} m of the path"
        raise Inconsistent(
            f"{arm.name} cannot run it: {issue.trouble.value} {where}: {issue.text}",
            consequence="Nothing is moved",
            cure="Move the path or the arm's stand"
            + ("" if keeps else ", or keep the tool's rotation (--keep-rotation)"),
        )
    _check_branch(check, arm, stand)
    return check, np.asarray(check.q[n:]), rows


def _check_branch(check: PathCheck, arm: Arm, stand: Array) -> None:
    """Raise Inconsistent where the way does not begin with the joints as they stand."""
    off = np.abs(check.q[0] - stand).max() if len(check.q) else np.inf
    if off > 0.05:
        raise Inconsistent(
            f"{arm.name} would begin with its joints {off:.2f} rad or m from where they stand",
            consequence="Nothing is moved",
            cure="Move the arm away from the singularity it stands at",
        )


def _wanted_speed(path: TaughtPath, s: Array, settings: PlaySettings) -> Array:
    """Return the speed (n,) asked for along the path."""
    at = path.length_m
    row = np.clip(np.searchsorted(at, s + 1e-12, side="right") - 1, 0, len(at) - 2)
    own = path.speed_m_s[row]
    return np.where(np.isfinite(own), own, settings.speed_m_s)
