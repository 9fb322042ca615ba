"""Where an arm can do the tests of ISO 9283: the largest preferred cube whose motions it can make."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.errors import Cancelled, DataRefused, UsageError
from armsight.fields import Doc
from armsight.file_names import PLAN, PLAN_SUMMARY
from armsight.kinematics import Arm, JointPath, Solution, ik, link_frames, singularity_distance, track_path
from armsight.records import Progress, Silent
from armsight.records.checks import Shape
from armsight.records.output import Output, extended, output
from armsight.shown import Shown, Table
from armsight.units import MM
from armsight.verify.iso9283.motions import PLANES, SIDES_M, Motion, TestCube, motions_of

STEPS_PER_SIDE = 25
"""Points at which a motion is checked over the cube's side."""
PLACES, PLACES_PER_SIDE = 16, 6
"""Candidate centres, outward and upward: at least so many over the reach, and over the cube's side."""
COLUMN = 0.1
"""The cube stays this share of the reach away from the base's z axis, where the arm itself stands."""
APART = 0.4
"""Distance between the centres of candidates whose motions are checked, over the cube's side."""
TRIED = 24
"""Candidates of one size whose motions are checked, best conditioned first, before a smaller cube is tried."""
RATED_SPEED_M_S = 0.25
"""Speed that is planned for where none is given: what machines may do with a person beside them."""
SLOWEST = 0.1
"""Share of the wanted speed that the joints must allow: below it the position is as good as singular."""

PATHS = ("line", "rectangle", "large_circle", "small_circle")
CHOICES = ("cube", "poses", "paths")

DOWN = (1.0, 0.0, 0.0, 0.0)
FORWARD = (0.0, 0.7071067811865476, 0.0, 0.7071067811865476)
"""Orientations of the tool in the base frame: its z axis down, or along the base's x."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanOptions:
    """What the operator fixes: side_m of the cube, test plane, tool orientation (4,) in the base frame, and where.

    azimuth_rad: direction of the cube's centre from the base, from the base's x axis. floor_m: no lower than this
    above the base's origin may the cube reach. Without side_m the largest of SIDES_M, without quat_xyzw the better of
    DOWN and FORWARD.
    """

    side_m: float | None = None
    plane: str = "a"
    quat_xyzw: tuple[float, float, float, float] | None = None
    azimuth_rad: float = 0.0
    floor_m: float = 0.0
    speed_m_s: float = RATED_SPEED_M_S

    def __post_init__(self) -> None:
        if self.plane not in PLANES:
            raise UsageError(f"there is no test plane {self.plane!r}", cure=f"Use one of: {', '.join(PLANES)}")
        if not (np.isfinite(self.speed_m_s) and self.speed_m_s > 0.0):
            raise UsageError(f"a speed of {self.speed_m_s:g} m/s is not a positive number", cure="Give more than zero")
        if self.side_m is not None and not (np.isfinite(self.side_m) and self.side_m > 0.0):
            raise UsageError(f"a cube's side of {self.side_m:g} m is not a positive number", cure="Give more than zero")


class PlannedPose(NamedTuple):
    """A test pose."""

    xyz_m: Annotated[Array, Doc("Position in world, x y z."), Shape((3,))]
    q: Annotated[Array, Doc("The controller's joint readings there, rad or m."), Shape((None,))]


@output
class PlannedMotion(Motion):
    """A motion of the plan, in world, with one orientation and the controller's joint readings q (k, n)."""

    q: Array


@output
class TestPlan(Output):
    """A test for one arm, all motions with joint readings.

    limit_margin: inf without limits.

    Checked are reach, limits, singular passages, changes of configuration, joint speeds, and that the joints' origins
    stay above the floor; not the bodies of the arm or of a cell.
    """

    __test__ = False  # not a test of pytest's

    arm: Annotated[str, Doc("The arm's name.")]
    cube: Annotated[TestCube, Doc("The test cube.")]
    quat_xyzw: Annotated[Array, Shape((4,)), Doc("The tool's orientation in world.")]
    speed_m_s: Annotated[float, Doc("Speed along the paths: as wanted, or the highest that all joints allow.")]
    motions: Annotated[tuple[PlannedMotion, ...], Doc("The motions written.")]
    branch: Annotated[tuple[str, ...], Doc("The arm's configuration throughout.")]
    singularity_distance: Annotated[float, Doc("The least over all motions.")]
    limit_margin: Annotated[
        float, Doc("Least distance of a joint from a limit, rad or m; null: no limits.", nullable=True)
    ]
    refused: Annotated[tuple[str, ...], Doc("Larger cubes that were tried, and why not.")] = ()

    @property
    def tour(self) -> dict[str, PlannedPose]:
        """P1 to P5, from the first of all motions."""
        first = self.motions[0]
        rows = {name: i for i, name in enumerate(first.names)}
        return {name: PlannedPose(first.xyz_m[rows[name]], first.q[rows[name]]) for name in sorted(rows)}


@output
class VerifyPlanOutput(TestPlan):
    """armsight verify --plan."""

    poses: Annotated[dict[str, PlannedPose], Doc("P1 to P5.")]
    files: Annotated[tuple[str, ...], Doc("What was written.")]

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        centre = ", ".join(f"{value:.3f}" for value in self.cube.centre_m)
        yield f"Cube of {self.cube.side_m / MM:.0f} mm about ({centre}) m in the base frame, {', '.join(self.branch)}"
        yield from (f"  not {text}" for text in self.refused)
        rows = [[motion.test, ", ".join(motion.figures), str(motion.repeats), str(motion.n)] for motion in self.motions]
        yield Table("Motions", ["tag", "figures", "repeats", "rows"], rows)
        yield f"Speed {self.speed_m_s:.3g} m/s. The arm's body and the cell are not checked: run it slowly first."
        yield f"Results: {{out}}/{PLAN}"


def chosen_motions(plan: TestPlan, part: str) -> VerifyPlanOutput:
    """Return a part of a plan: cube (all motions), poses (all but paths), paths, or a motion by its name.

    Raises UsageError for another.
    """
    names = list(dict.fromkeys(motion.test for motion in plan.motions))
    if part not in (*CHOICES, *names):
        raise UsageError(
            f"--plan {part} is not known", cure=f"Use one of: {', '.join(dict.fromkeys([*CHOICES, *names]))}"
        )
    wanted = {"cube": set(names), "poses": set(names) - set(PATHS), "paths": set(PATHS)}.get(part, {part})
    motions = tuple(motion for motion in plan.motions if motion.test in wanted)
    return extended(plan, VerifyPlanOutput, motions=motions, poses=plan.tour, files=(PLAN, PLAN_SUMMARY))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Candidate:
    """A cube with a start q (n,) at P1 on one branch; distance: the least from a singularity over its points."""

    cube: TestCube
    rotation: Rotation
    q: Array
    distance: float


@dataclass(slots=True, kw_only=True)
class _Refusals:
    """Why candidates of one size failed: by stage (0 reach, 1 one configuration, 2 motions) and words, how often."""

    counts: dict[tuple[int, str], int] = field(default_factory=dict)

    def add(self, stage: int, why: str) -> None:
        self.counts[stage, why] = self.counts.get((stage, why), 0) + 1

    def text(self, side_m: float) -> str:
        """Return the most frequent reason of the furthest stage that was come to."""
        if not self.counts:
            return f"{1e3 * side_m:.0f} mm: no place above the floor within the arm's reach"
        return f"{1e3 * side_m:.0f} mm: {max(self.counts, key=lambda why: (why[0], self.counts[why]))[1]}"


def plan_test(arm: Arm, options: PlanOptions | None = None, progress: Progress | None = None) -> TestPlan:
    """Return the test in the largest cube, edges along the base's axes, in which the arm can make every motion.

    Centres are tried on a grid in the vertical plane of options.azimuth_rad. Where the inverse kinematics gives all
    corners and test poses on one branch the position is a candidate; candidates are ranked by the singularity distance
    of their worst pose, and the motions of the best are checked along straight lines. Raises DataRefused with the
    reason for every size where none fits, UsageError for an arm of unlimited reach, Cancelled.
    """
    options, progress = options or PlanOptions(), progress or Silent()
    if not np.isfinite(arm.reach_m):
        raise UsageError(
            f"the reach of {arm.name} is not limited",
            consequence="No test cube can be placed",
            cure="Give its sliding joints limits in the arm file",
        )
    rotations = [Rotation.from_quat(q) for q in ([options.quat_xyzw] if options.quat_xyzw else [DOWN, FORWARD])]
    refused: list[str] = []
    sides = SIDES_M if options.side_m is None else (options.side_m,)
    for number, side_m in enumerate(sides):
        progress.update(number, len(sides), f"cube of {1e3 * side_m:.0f} mm")
        if progress.cancelled():
            raise Cancelled("the search for a test cube was stopped", consequence="There is no plan")
        refusals = _Refusals()
        found = [c for r in rotations for c in _candidates(arm, side_m, r, options, refusals)]
        for candidate in _apart(found):
            plan = _checked(arm, candidate, options, tuple(refused), refusals)
            if plan is not None:
                return plan
        refused.append(refusals.text(side_m))
    raise DataRefused(
        f"{arm.name} has no room for a test cube ({'; '.join(refused)})",
        consequence="The standard's poses and paths cannot be planned",
        cure="Give another direction, floor or tool orientation, or the side of a smaller cube",
    )


def _apart(found: list[_Candidate]) -> Iterator[_Candidate]:
    """Yield up to TRIED candidates, best conditioned first, none close to one that was tried: it fails alike."""
    tried: list[_Candidate] = []
    for candidate in sorted(found, key=lambda one: one.distance, reverse=True):
        close = [
            other
            for other in tried
            if other.rotation is candidate.rotation
            and np.linalg.norm(other.cube.centre_m - candidate.cube.centre_m) < APART * candidate.cube.side_m
        ]
        if not close and len(tried) < TRIED:
            tried.append(candidate)
            yield candidate


def _candidates(
    arm: Arm, side_m: float, rotation: Rotation, options: PlanOptions, refusals: _Refusals
) -> Iterator[_Candidate]:
    """Yield the cubes whose corners and poses are all reached on one branch, the best branch of each."""
    reach, half = arm.reach_m, 0.5 * side_m
    ahead = np.array([np.cos(options.azimuth_rad), np.sin(options.azimuth_rad), 0.0])
    step = min(reach / PLACES, side_m / PLACES_PER_SIDE)
    for out in np.arange(step, reach, step):
        if np.linalg.norm(np.maximum(np.abs(out * ahead) - half, 0.0)) < COLUMN * reach:
            continue
        for z in np.arange(options.floor_m + half, reach, step):
            centre = out * ahead + [0.0, 0.0, z]
            cube = TestCube(centre_m=centre, side_m=side_m, plane=options.plane)
            best = _best_branch(arm, cube, rotation, options, refusals)
            if best is not None:
                yield best


def _best_branch(
    arm: Arm, cube: TestCube, rotation: Rotation, options: PlanOptions, refusals: _Refusals
) -> _Candidate | None:
    """Return the branch whose worst pose is furthest from a singularity, or None, with the reason counted."""
    points = np.array([*cube.points_m.values(), *cube.corners_m.values()])
    branches: dict[tuple[str, ...], tuple[Array, float]] | None = None
    seed: Array | None = None
    for T in _matrices(arm, points, rotation):
        answer = ik(arm, T, seed)
        if not answer.solutions:
            refusals.add(0, f"a pose of the cube is not reached ({answer.status})")
            return None
        here = {
            branch: (s.q, float(singularity_distance(arm, s.q)))
            for branch, s in _by_branch(answer.solutions)
            if lowest_m(arm, s.q) >= options.floor_m
        }
        if branches is None:
            seed = answer.solutions[0].q
            branches = here
        else:
            shared = branches.keys() & here.keys()
            branches = {b: (branches[b][0], min(branches[b][1], here[b][1])) for b in shared}
        if not branches:
            refusals.add(1, "no configuration of the arm reaches all poses with its joints above the floor")
            return None
    q, distance = max((branches or {}).values(), key=lambda value: value[1])
    return _Candidate(cube=cube, rotation=rotation, q=q, distance=distance)


def lowest_m(arm: Arm, q: Array) -> float:
    """Return the height in m, in the base frame, of the lowest moving joint or of the tool at q (n,)."""
    T = arm.T_world_base.as_matrix()
    heights = [float((frame[:3, 3] - T[:3, 3]) @ T[:3, 2]) for frame in link_frames(arm, q)[2:]]
    return min(heights, default=np.inf)


def _by_branch(solutions: tuple[Solution, ...]) -> Iterator[tuple[tuple[str, ...], Solution]]:
    """Yield the nearest solution of each branch."""
    seen: set[tuple[str, ...]] = set()
    for solution in solutions:
        if solution.branch not in seen:
            seen.add(solution.branch)
            yield solution.branch, solution


def _matrices(arm: Arm, points_m: Array, rotation: Rotation) -> Array:
    """Return T_world_tool (m, 4, 4) at points (m, 3) with a rotation, both in the base frame."""
    T = np.tile(np.eye(4), (len(points_m), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = rotation.as_matrix(), points_m
    return np.asarray(arm.T_world_base.as_matrix() @ T)


def _checked(
    arm: Arm, candidate: _Candidate, options: PlanOptions, refused: tuple[str, ...], refusals: _Refusals
) -> TestPlan | None:
    """Return the plan of a candidate whose motions can all be made, or None, with the reason counted."""
    planned: list[PlannedMotion] = []
    tracks: list[JointPath] = []
    speed_m_s = options.speed_m_s
    for motion in motions_of(candidate.cube):
        track = _track(arm, candidate, motion)
        if track.issues:
            refusals.add(2, f"{motion.test}: {track.issues[0].text}")
            return None
        if min(lowest_m(arm, q) for q in track.q) < options.floor_m:
            refusals.add(2, f"{motion.test}: a joint of the arm would be below the floor")
            return None
        speed_m_s = min(speed_m_s, _top_speed_m_s(arm, motion, track, candidate.cube.side_m))
        if speed_m_s < SLOWEST * options.speed_m_s:
            refusals.add(2, f"{motion.test}: the joints allow {speed_m_s:.2g} m/s of {options.speed_m_s:.2g} m/s")
            return None
        tracks.append(track)
        planned.append(_planned(arm, candidate, motion, track))
    q = np.concatenate([track.q for track in tracks])
    world = arm.T_world_base.rotation * candidate.rotation
    return TestPlan(
        arm=arm.name,
        cube=candidate.cube,
        quat_xyzw=np.asarray(world.as_quat(canonical=True)),
        motions=tuple(planned),
        speed_m_s=speed_m_s,
        branch=tracks[0].branch,
        singularity_distance=float(singularity_distance(arm, q).min()),
        limit_margin=float(np.minimum(q - arm.lower, arm.upper - q).min()),
        refused=refused,
    )


def _track(arm: Arm, candidate: _Candidate, motion: Motion) -> JointPath:
    """Return the joint track of a motion, entered in a straight line from P1, where the candidate's start is."""
    step_m = candidate.cube.side_m / STEPS_PER_SIDE
    make = partial(Motion, test=motion.test, figures=(), repeats=1)
    way = np.array([candidate.cube.centre_m, motion.xyz_m[0]])
    if np.linalg.norm(way[1] - way[0]) > 0.0:
        entry, _ = make(xyz_m=way, names=("", "")).dense(step_m)
        reached = track_path(arm, _matrices(arm, entry, candidate.rotation), start=candidate.q)
        if reached.issues:
            return reached
        start = reached.q[-1]
    else:
        start = candidate.q
    points, _ = motion.dense(step_m)
    return track_path(arm, _matrices(arm, points, candidate.rotation), start=start)


def _top_speed_m_s(arm: Arm, motion: Motion, track: JointPath, side_m: float) -> float:
    """Return the speed of the tool at which the first joint of a track comes to its own limit; inf without limits."""
    _, at = motion.dense(side_m / STEPS_PER_SIDE)
    limits = np.array([np.inf if joint.max_speed is None else joint.max_speed for joint in arm.joints])
    share = np.abs(np.diff(track.q, axis=0)) / np.diff(at)[:, None] / limits  # (m - 1, n) of the limit, per m/s
    return float(1.0 / share.max()) if share.max() > 0.0 else np.inf


def _planned(arm: Arm, candidate: _Candidate, motion: Motion, track: JointPath) -> PlannedMotion:
    """Return the motion in world with the joint values at its own rows."""
    points, at = motion.dense(candidate.cube.side_m / STEPS_PER_SIDE)
    gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(motion.xyz_m, axis=0), axis=1))])
    rows = np.array([int(np.abs(at - length).argmin()) for length in gone])
    xyz_m = _matrices(arm, points[rows], candidate.rotation)[:, :3, 3]
    return extended(motion, PlannedMotion, xyz_m=xyz_m, q=arm.readings(track.q[rows]))
