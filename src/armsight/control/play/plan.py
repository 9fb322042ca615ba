"""A taught path made ready to be run: checked for the arm and timed within its limits, before anything moves."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.control.guard.limits import Limits, joint_bounds
from armsight.control.paths import PathCheck, check_path
from armsight.control.paths.check import SLOWED
from armsight.control.paths.outliers import SAME_M, distinct_rows, of_rows, path_jumps
from armsight.control.play.shape import TURN_M, Shape, Weave, shaped, steps, welds_of
from armsight.control.play.timing import ARM_M, SPEED_SHARE, Samples, Track, timed
from armsight.defaults import APPROACH_SPEED_M_S, BLEND_M, PATH_SPEED_M_S, RETRACT_M
from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.geometry import pose_difference
from armsight.kinematics import Arm, fk_jacobian
from armsight.kinematics.numeric import target_matrices
from armsight.records import TaughtPath
from armsight.units import DEG, MM

LEG_STEP_M = 1e-3
"""Between two samples of the way to a path, and at least LEG_SAMPLES."""
LEG_SAMPLES = 33
CHECK_M = 1e-3
"""Between two poses that are checked for the arm; also half a millimetre and less where a weave is narrow."""
REST_M, REST_SHARE = 1e-4, 1.05
"""What a path keeps from walls, and of singularities, beyond what the guard does: ways to rest lead off the path."""
NEWTON_STEPS = 5
MET = 1e-9
"""m or rad: joint readings that put the tip so near a sample are its readings."""
LEAST_SPEED_M_S = 2e-4
"""A path that allows no more than this somewhere has a corner there that nobody can run through."""
TURNS_RAD = 1e-3
"""Of an arm that cannot turn its tool at will: a path's rotation is met that is no further from the arm's own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaySettings:
    """How a path is run.

    speed_m_s: along the path where it says none. blend_m: length over which corners are rounded, with a deviation that
    the plan tells. approach_speed_m_s, retract_m: of the way to the path's start, which begins retract_m before it
    along the tool's axis. keep_rotation: the tool keeps the rotation it has; else it takes the path's.
    """

    speed_m_s: float = PATH_SPEED_M_S
    blend_m: float = BLEND_M
    weave: Weave = field(default_factory=Weave)
    approach_speed_m_s: float = APPROACH_SPEED_M_S
    retract_m: float = RETRACT_M
    keep_rotation: bool = False

    def __post_init__(self) -> None:
        for name in ("speed_m_s", "blend_m", "approach_speed_m_s"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise UsageError(f"{name} is {value:g}, which is not above zero", cure="Give more than 0")
        if not (np.isfinite(self.retract_m) and self.retract_m >= 0.0):
            raise UsageError(f"retract_m is {self.retract_m:g}", cure="Give 0 or more")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathPlan(Shape):
    """A path ready to be run, in base axes.

    approach: the way from where the tip stood to the start, in straight parts. track: the path with its weave.
    speed_m_s (n,): along the seam, as planned. welds: lengths at which a weld is switched on or off. slowest: the place
    of the least planned speed, in words. turned_rad: how far the tool turns from what was asked at most, of an arm that
    cannot turn it at will. fastest_m_s, fastest: the largest speed that tip or flange reach anywhere, the way to the
    path included, and which of them where.
    """

    approach: tuple[Track, ...]
    track: Track
    speed_m_s: Array
    welds: tuple[tuple[float, bool], ...]
    slowest: str
    turned_rad: float
    fastest_m_s: float
    fastest: str
    check: PathCheck

    @property
    def ways(self) -> tuple[Track, ...]:
        """All that is run, one after the other, with a rest between."""
        return (*self.approach, self.track)

    @property
    def length_m(self) -> float:
        """Length of the path along its seam."""
        return self.track.length_m

    @property
    def time_s(self) -> float:
        """How long it takes, without pauses and at full override."""
        return float(sum(way.duration_s for way in self.ways))


def plan_path(
    path: TaughtPath, arm: Arm, limits: Limits, q: ArrayLike, settings: PlaySettings | None = None
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
    shape = shaped(path, settings.blend_m, settings.weave, settings.speed_m_s)
    legs = _legs(T_base_stand, RigidTransform.from_matrix(shape.T[0]), settings, limits)
    check, found = _checked(arm, limits, stand, legs, shape, keeps=settings.keep_rotation)
    bounds = joint_bounds(arm, limits)
    *approach, track = (Track(samples, *timed(samples, arm, limits, bounds)) for samples in found)
    speed = np.asarray(track.speeds * np.maximum(np.gradient(shape.s_m, shape.u), 0.0))
    fastest_m_s, fastest = _fastest(arm, tuple(approach), track)
    return PathPlan(
        **{one.name: getattr(shape, one.name) for one in fields(shape)},
        approach=tuple(approach),
        track=track,
        speed_m_s=speed,
        welds=welds_of(path),
        slowest=_slowest(track, speed),
        turned_rad=_turned(arm, shape, track.samples, keeps=settings.keep_rotation),
        fastest_m_s=fastest_m_s,
        fastest=fastest,
        check=check,
    )


def _in_base(path: TaughtPath, arm: Arm) -> TaughtPath:
    if path.parent == "base":
        return path
    if path.parent != "world":
        raise UsageError(f"the path is in the frame {path.parent!r}")
    T = arm.T_world_base.inv().as_matrix() @ path.T_world_tip
    return replace(path, T_world_tip=T, parent="base")


def _in_world(path: TaughtPath, arm: Arm) -> Array:
    """Return the poses (m, 4, 4) of a path in base or world axes as an arm reaches for them."""
    T = path.T_world_tip
    return arm.T_world_base.as_matrix() @ T if path.parent == "base" else T


def _usable(path: TaughtPath, settings: PlaySettings, T_base_stand: RigidTransform) -> TaughtPath:
    if settings.keep_rotation:
        T = path.T_world_tip.copy()
        T[:, :3, :3] = T_base_stand.rotation.as_matrix()
        path = replace(path, T_world_tip=T)
    if len(distinct_rows(path)) < 2:
        turn = steps(path)[1]
        only = f" at which the tool turns by {turn.sum() / DEG:.0f} deg" if turn.sum() > TURNS_RAD else ""
        raise NotEnoughData(
            f"the path has {min(len(path), 1)} positions{only}", consequence="Nothing is moved", cure="Give two or more"
        )
    for jump in path_jumps(path):
        raise Inconsistent(jump.text, consequence="Nothing is moved", cure=jump.cure)
    return of_rows(path, distinct_rows(path, turn_m=TURN_M))


def _legs(stand: RigidTransform, start: RigidTransform, settings: PlaySettings, limits: Limits) -> list[Samples]:
    """Return the legs from where the tip stands to the path's start, by way of one before it on the tool's axis."""
    before = start * RigidTransform.from_translation([0.0, 0.0, -settings.retract_m])
    speed = min(settings.approach_speed_m_s, SPEED_SHARE * limits.speed_m_s)
    legs = (_leg(stand, before, speed), _leg(before, start, speed))
    return [leg for leg in legs if leg.u[-1] > SAME_M]


def _leg(start: RigidTransform, end: RigidTransform, speed_m_s: float) -> Samples:
    way = pose_difference(end, start)
    length_m = max(float(np.linalg.norm(way[:3])), ARM_M * float(np.linalg.norm(way[3:])))
    share = np.linspace(0.0, 1.0, max(LEG_SAMPLES, int(np.ceil(length_m / LEG_STEP_M)) + 1))
    turns = Rotation.from_rotvec(share[:, None] * way[3:]) * start.rotation
    u = share * length_m
    return Samples(
        u=u,
        T=RigidTransform.from_components(start.translation + share[:, None] * way[:3], turns).as_matrix(),
        s_m=u,
        paced_m=u[:, None],
        wanted_m_s=np.full(len(u), speed_m_s),
    )


def _fastest(arm: Arm, approach: tuple[Track, ...], track: Track) -> tuple[float, str]:
    """Return the largest speed that tip or flange reach in m/s, and which of them where."""
    T_tool_flange = arm.T_flange_tool.inv().as_matrix()
    found = []
    for way in (track, *approach):
        u, T = way.samples.u, way.samples.T
        rate = way.speeds
        where = "along it" if way is track else "on the way to it"
        for name, xyz in (("tip", T[:, :3, 3]), ("flange", (T @ T_tool_flange)[:, :3, 3])):
            speed = rate * np.linalg.norm(np.gradient(xyz, u, axis=0), axis=1)
            found.append((float(speed.max()), f"the {name}, {where}"))
    return max(found, key=lambda one: round(one[0], 6))  # where both are as fast, the tip along the path is told


def _slowest(track: Track, speed: Array) -> str:
    """Return where the speed along the seam (n,) is furthest below the one asked for, in words; empty nowhere.

    Between its first and its last largest value, which leaves out how it gathers and gives up speed at the ends, and
    not where the tip hardly moves but the tool turns. Raises Inconsistent where no speed is slow enough.
    """
    s, share = track.samples.s_m, speed / track.samples.wanted_m_s
    up, down = np.flatnonzero(np.diff(share) <= 0.0), np.flatnonzero(np.diff(share) >= 0.0)
    within = slice(int(up[0]), int(down[-1]) + 2)
    along = np.gradient(s, track.samples.u)[within] > 0.5
    if not along.any():
        return ""
    slow = within.start + int(np.argmin(np.where(along, share[within], np.inf)))
    if track.speeds[slow] < LEAST_SPEED_M_S:
        raise Inconsistent(
            f"the path turns so sharply at {s[slow]:.4f} m that no speed is slow enough",
            consequence="Nothing is moved",
            cure="Round its corners more (--blend), smooth it (armsight path smooth), or give a wider weave",
        )
    return f"{speed[slow] / MM:.1f} mm/s at {s[slow]:.3f} m" if share[slow] < 0.98 else ""


def _turned(arm: Arm, shape: Shape, samples: Samples, *, keeps: bool) -> float:
    """Return how far the tool is off the rotation asked for at most, rad. Raises Inconsistent where it must not be."""
    R = Rotation.from_matrix(samples.T[:, :3, :3]) * Rotation.from_matrix(shape.T[:, :3, :3]).inv()
    off = np.asarray(R.magnitude())
    worst = int(np.argmax(off))
    turned = float(off[worst])
    if turned > TURNS_RAD and not keeps:
        raise Inconsistent(
            f"{arm.name} has {arm.n} joints and cannot turn its tool as the path asks: it would be off by "
            f"{turned / DEG:.1f} deg at {samples.s_m[worst]:.3f} m",
            consequence="Nothing is moved",
            cure="Run the positions alone (--keep-rotation)",
        )
    return turned


def _checked(
    arm: Arm, limits: Limits, stand: Array, legs: list[Samples], shape: Shape, *, keeps: bool
) -> tuple[PathCheck, list[Samples]]:
    """Return the check of all that is run, and the ways with readings. keeps: rotation kept. Raises Inconsistent."""
    ways: list[Samples] = [*legs, shape]
    rows = [_rows(way) for way in ways]
    joined = np.concatenate([way.T[at] for way, at in zip(ways, rows, strict=True)])
    path = TaughtPath.of_poses(RigidTransform.from_matrix(joined), parent="base")
    kept = replace(limits, margin_m=limits.margin_m + REST_M, singularity=REST_SHARE * limits.singularity)
    check = check_path(path, arm, kept, speed_m_s=limits.speed_m_s, start=stand, taught=False)
    ends = np.cumsum([len(at) for at in rows])
    for issue in check.issues:
        if issue.trouble in SLOWED:
            continue
        k = int(np.searchsorted(ends, issue.row, side="right"))
        at_m = ways[k].s_m[rows[k][issue.row - ends[k]]]
        where = f"at {at_m:.3f} m of the path" if ways[k] is shape else f"on the way to the path (leg {k + 1})"
        raise Inconsistent(
            f"{arm.name} cannot run it: {issue.trouble.value} {where}: {issue.text}"
            + (f"; {shape.turns}" if shape.turns and not keeps else ""),
            consequence="Nothing is moved",
            cure="Move the path or the arm's stand"
            + ("" if keeps else ", or keep the tool's rotation (--keep-rotation)"),
        )
    _check_branch(check, arm, stand)
    found = np.split(np.asarray(check.q), ends[:-1])
    return check, [with_readings(way, arm, at, q) for way, at, q in zip(ways, rows, found, strict=True)]


def _rows(way: Samples) -> NDArray[np.intp]:
    every = max(1, min(int(CHECK_M / way.u[1]), 8))
    return np.unique(np.append(np.arange(0, len(way.u), every), len(way.u) - 1))


def with_readings(way: Samples, arm: Arm, rows: NDArray[np.intp], q: Array) -> Samples:
    """Return a way with readings at all its samples, from those q (k, joints) at rows (k,), and the poses they give.

    An arm of less than six joints meets the positions, and turns the tool as it does. Raises Inconsistent where samples
    between are not met.
    """
    values = np.asarray(CubicSpline(way.u[rows], arm.values(q))(way.u))
    T_world = arm.T_world_base.as_matrix() @ way.T
    free = slice(0, 6 if arm.n >= 6 else 3)
    lengths = np.array([arm.length_m] * 3 + [1.0] * 3)[free]
    for _ in range(NEWTON_STEPS):
        T, J = fk_jacobian(arm, values)
        turn = Rotation.from_matrix(T_world[:, :3, :3]) * Rotation.from_matrix(T[:, :3, :3]).inv()
        off = np.concatenate([T_world[:, :3, 3] - T[:, :3, 3], turn.as_rotvec()], axis=1)[:, free]
        if np.abs(off).max() < MET:
            break
        scaled = J[:, free] / lengths[:, None]
        square = scaled @ scaled.transpose(0, 2, 1)
        values = values + (scaled.transpose(0, 2, 1) @ np.linalg.solve(square, (off / lengths)[..., None]))[..., 0]
    else:
        worst = int(np.argmax(np.abs(off).max(axis=1)))
        raise Inconsistent(
            f"{arm.name} does not meet the path at {way.s_m[worst]:.3f} m",
            consequence="Nothing is moved",
            cure="Move the path away from the arm's singularities",
        )
    T_base = way.T if arm.n >= 6 else arm.T_world_base.inv().as_matrix() @ T
    return replace(way, T=T_base, q=np.asarray(arm.readings(values)))


def _check_branch(check: PathCheck, arm: Arm, stand: Array) -> None:
    """Raise Inconsistent where the way does not begin with the joints as they stand."""
    off = np.abs(check.q[0] - stand).max() if len(check.q) else np.inf
    if off > 0.05:
        raise Inconsistent(
            f"{arm.name} would begin with its joints {off:.2f} rad or m from where they stand",
            consequence="Nothing is moved",
            cure="Move the arm away from the singularity it stands at",
        )
