"""Which motion of the joints tells most of a cell: of the tip's pose over a volume, in a given time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.cell.fit import CellFit
from armsight.calibrate.cell.knowledge import ArmTolerance
from armsight.calibrate.cell.model import CellModel
from armsight.defaults import CAMERA_HZ, MOTION_HZ, MOTION_S, SPOT_STD_PX
from armsight.errors import Cancelled, Inconsistent, NotEnoughData
from armsight.kinematics import Arm
from armsight.optics import INTRINSICS
from armsight.records import Motion, Progress, Silent, Target
from armsight.units import DEG, MM
from armsight_lab.cell_plan.information import (
    KINDS,
    Known,
    by_kind,
    inverse,
    kind_of,
    known_before,
    motion_information,
    noise_px,
    rests,
)
from armsight_lab.cell_plan.path import MotionBounds
from armsight_lab.cell_plan.scene import Free, Roadmap, Scene, places, roadmap
from armsight_lab.cell_plan.tour import LOOKED_HZ, LocalSearch, MotionPlan, by_worth, longest, tour

MOST_PLACES, TYPICAL_PLACES = 70, 35
"""Places that are chosen at most, and among how many the time is thought to be shared."""
TRIALS, PUSHES = 30, 3
"""Exchanges of a place for another that are tried on the whole motion, and for each how many moves of places after."""
AMONG = 40
"""Best of the places left, of which the other one is drawn."""
LEAST_IN_VOLUME = 5
"""Places with the tip in the volume; over fewer nothing is averaged."""
STRAY_M = 3e-5
"""What gears, play and encoders leave at the flange of an arm of industry."""
BUILT = ArmTolerance(length_m=3e-4, zero_rad=5e-3, angle_rad=6e-4, sag=1e-3)
"""How far arms of industry are from their tables, zeros included: what is foretold stands on it, as how large the cell
is follows from the arm's lengths alone."""
UNTOLD = 0.7
"""A parameter that keeps so much of the deviation it had is not told by the motion."""
LITTLE = {True: 20.0 * DEG, False: 0.05}
"""A joint that turns (rad) or slides (m) less is hardly told."""
LITTLE_SEEN = 0.6
AT_FLOOR = 0.8
"""A motion that leaves so much of the deviation to what no motion tells cannot be bettered by much."""
ENDLESS = 1e4
"""So many times the motion: what is then left, no motion tells."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanSettings:
    """duration_s of the motion in steps of rate_hz; frames_hz and spot_px of the cameras; seed of what is drawn.

    stray_m: how far the flange strays from where its joints say, otherwise every STRAYS_S. trials: exchanges of places,
    with PUSHES moves of them each.
    """

    duration_s: float = MOTION_S
    rate_hz: float = MOTION_HZ
    frames_hz: float = CAMERA_HZ
    spot_px: float = SPOT_STD_PX
    seed: int = 1
    trials: int = TRIALS
    tolerance: ArmTolerance = BUILT
    stray_m: float = STRAY_M


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CellPlan:
    """A motion, and what is foretold of it, by the spots' noise and how the arm strays.

    before_m, after_m: RMS deviation of the tip over the volume, as the cameras measure it and as the arm says it.
    least_m: what is left of it however long one moved so: how large the cell is, by the arm's lengths and the target.
    kinds: the same of each kind of parameter before and after, all else exact. untold: parameters that stay as unknown
    as they were. seen: share of the time in which both cameras see all lights. moved (n,): range of each joint.
    places (k, n): what it goes through. notes: what stays open, and what would help.
    """

    motion: Motion
    before_m: tuple[float, float]
    after_m: tuple[float, float]
    least_m: tuple[float, float]
    kinds: dict[str, tuple[float, float]]
    untold: tuple[str, ...]
    seen: float
    moved: Array
    places: Array
    notes: tuple[str, ...]


def plan_motion(
    scene: Scene,
    target: Target,
    T_flange_target: RigidTransform,
    settings: PlanSettings | None = None,
    *,
    start: Array,
    learned: Array | None = None,
    progress: Progress | None = None,
) -> CellPlan:
    """Return the motion from start (n,) and back that makes the mean variance of the tip over the volume least.

    Places in view are chosen one by one by what they tell, joined to a short round, exchanged and then moved while the
    information of the whole motion grows: at the frames' own times, with its speed in the images, line by line. learned
    (P, P): information of what was recorded before. Raises NotEnoughData where nothing is in view or within the limits,
    Inconsistent for a start outside them, or too little time.
    """
    settings, progress = settings or PlanSettings(), progress or Silent()
    rng = np.random.default_rng(settings.seed)
    check_bounds(scene.arm, scene.bounds)
    check_start(scene.arm, scene.bounds, scene.free, start)
    steps = 2 + settings.trials * (1 + PUSHES)
    progress.update(0, steps, "looking for places in view")
    found = places(scene, rng, start)
    road = roadmap(scene, found)
    _check_volume(scene, road)
    spot_px = noise_px(scene, settings.spot_px, settings.stray_m, settings.frames_hz)
    known = known_before(scene, target, T_flange_target, road.q, settings.tolerance, spot_px, learned)
    progress.update(1, steps, "choosing places")
    J = rests(scene, known, road.q, spot_px)
    J[~scene.seen(road.q)] = 0.0  # the start may be out of view: it tells nothing
    frames = settings.duration_s * settings.frames_hz / TYPICAL_PLACES
    order = by_worth(J, known, road.long_s, MOST_PLACES, frames)
    best = longest(scene, road, order, settings.duration_s)
    if best is None:
        raise Inconsistent(
            f"no round through places in view is gone in {settings.duration_s:g} s within the limits of speed",
            consequence="No motion is planned",
            cure="Give more time (--duration), or a start nearer to where the lights are seen (--start)",
        )
    best, information = _improved(scene, road, known, best, order, settings, rng, progress)
    best, information = _pushed(scene, known, best, information, settings, rng, progress)
    return _told(scene, known, best, information, settings)


def _check_volume(scene: Scene, road: Roadmap) -> None:
    """Raise NotEnoughData where the tip hardly comes into the volume."""
    inside = int((scene.inside(road.q) & scene.seen(road.q)).sum())
    if inside < LEAST_IN_VOLUME:
        raise NotEnoughData(
            f"the tip comes into the volume at {inside} of {len(road.q)} positions that can be gone to in view",
            consequence="How well it is known there cannot be foretold, and no motion is planned",
            cure="Give a volume that arm and cameras reach (--volume, in base axes), or place the cameras otherwise",
        )


def refine(
    scene: Scene,
    model: CellModel,
    found: CellFit,
    target: Target,
    T_flange_target: RigidTransform,
    settings: PlanSettings | None = None,
    *,
    start: Array,
    progress: Progress | None = None,
) -> CellPlan:
    """Return the motion for a further recording, by what a first one's fit knows: its cameras, lights and arm, and its
    information beside that of the new motion.

    The clocks' delays are those of another recording, and are asked anew. Raises as plan_motion.
    """
    now = replace(scene, model=CellModel(recording=scene.model.recording, lights=model.lights), x=found.x)
    learned = found.normals.A.sum(axis=0) if found.wander is None else found.wander.reduced(found.normals).A
    clocks = np.array([k for k in range(model.arm_at) if kind_of(model, k) == "clocks"], dtype=np.intp)
    keep = np.setdiff1d(np.arange(len(learned)), clocks)
    # what the first recording says of all else, whatever its clocks were
    inner = learned[np.ix_(clocks, clocks)] + 1e-12 * np.diag(np.diag(learned)[clocks]) + 1e-12 * np.eye(len(clocks))
    cross = learned[np.ix_(keep, clocks)]
    without = np.zeros_like(learned)
    without[np.ix_(keep, keep)] = learned[np.ix_(keep, keep)] - cross @ np.linalg.solve(inner, cross.T)
    return plan_motion(now, target, T_flange_target, settings, start=start, learned=without, progress=progress)


def check_bounds(arm: Arm, bounds: MotionBounds) -> None:
    """Raise Inconsistent for a joint whose limits nobody told."""
    bare = np.flatnonzero(~(np.isfinite(bounds.lower) & np.isfinite(bounds.upper)))
    if len(bare):
        names = ", ".join(arm.joints[j].name for j in bare.tolist())
        raise Inconsistent(
            f"the limits of {names} are not known",
            consequence="Where the arm may go cannot be told, and no motion is planned",
            cure="Give lower and upper of each joint in the arm's file, or in limits.yaml (--limits)",
        )


def check_start(arm: Arm, bounds: MotionBounds, free: Free, start: Array) -> None:
    """Raise Inconsistent for a start (n,) of another arm, beyond the limits, or where the arm may not be."""
    if start.shape != (arm.n,):
        raise Inconsistent(
            f"the start has {start.size} values, {arm.name} has {arm.n} joints",
            consequence="No motion is planned",
            cure="Give one value for each joint, rad or m (--start)",
        )
    for j in np.flatnonzero((start < bounds.lower) | (start > bounds.upper)).tolist():
        raise Inconsistent(
            f"the arm stands with {arm.joints[j].name} at {start[j]:.4g}, beyond its limits "
            f"{bounds.lower[j]:.4g} to {bounds.upper[j]:.4g} (rad or m, a margin kept)",
            consequence="No motion begins there",
            cure="Move it back within them, or give the limits that hold (--limits)",
        )
    if not free(start[None])[0]:
        raise Inconsistent(
            "where the arm stands its tool, flange or lights are outside the workspace or in a forbidden box",
            consequence="No motion begins there",
            cure="Move it out of there, or correct the boxes (--limits)",
        )


def _improved(
    scene: Scene,
    road: Roadmap,
    known: Known,
    best: MotionPlan,
    order: list[int],
    settings: PlanSettings,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[MotionPlan, Array]:
    """Return the best tour found by exchanging places for others, and the information of its motion."""
    information = _of_motion(scene, known, best, settings)
    worth = known.worth(known.information + information)
    for trial in range(settings.trials):
        if progress.cancelled():
            raise Cancelled("stopped", consequence="No motion is planned")
        progress.update(2 + trial, 2 + settings.trials * (1 + PUSHES), "exchanging places")
        chosen = list(best.chosen)
        # one out and another in, or one more while there is time
        left = [k for k in order if k not in best.chosen][:AMONG]
        if rng.random() < 0.7 and len(chosen) > 1:
            chosen.pop(int(rng.integers(len(chosen))))
        if left:
            chosen.append(left[int(rng.integers(len(left)))])
        other = tour(scene, road, chosen, settings.duration_s)
        if other is None:
            continue
        there = _of_motion(scene, known, other, settings)
        value = known.worth(known.information + there)
        if value < worth:
            best, information, worth = other, there, value
    return best, information


def _pushed(
    scene: Scene,
    known: Known,
    best: MotionPlan,
    information: Array,
    settings: PlanSettings,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[MotionPlan, Array]:
    """Return the round with its places moved to where they tell more, and the information of its motion."""
    spot_px = noise_px(scene, settings.spot_px, settings.stray_m, settings.frames_hz)
    pusher = LocalSearch(scene=scene, known=known, spot_px=spot_px, duration_s=settings.duration_s, rng=rng)
    worth, moves = known.worth(known.information + information), settings.trials * PUSHES
    for move in range(moves):
        if progress.cancelled():
            raise Cancelled("stopped", consequence="No motion is planned")
        progress.update(2 + settings.trials + move, 2 + settings.trials + moves, "moving places")
        other = pusher.pushed(best, information)
        if other is None:
            continue
        there = _of_motion(scene, known, other, settings)
        value = known.worth(known.information + there)
        pusher.learn(better=value < worth)
        if value < worth:
            best, information, worth = other, there, value
    return best, information


def _of_motion(scene: Scene, known: Known, found: MotionPlan, settings: PlanSettings) -> Array:
    motion = found.way.motion(settings.duration_s, LOOKED_HZ)
    spot_px = noise_px(scene, settings.spot_px, settings.stray_m, settings.frames_hz)
    return motion_information(scene, known, motion, spot_px, settings.frames_hz)


def _told(scene: Scene, known: Known, found: MotionPlan, information: Array, settings: PlanSettings) -> CellPlan:
    motion = found.way.motion(settings.duration_s, settings.rate_hz)
    before, after = known.information, known.information + information
    parts = [by_kind(scene.model, known, which) for which in (before, after)]
    std = [np.sqrt(np.diag(inverse(which))) for which in (before, after)]
    names = [scene.model.names[k] for k in known.free.tolist()]
    untold = tuple(name for name, a, b in zip(names, *std, strict=True) if b > UNTOLD * a)
    moved = np.ptp(motion.q, axis=0)
    seen = float(scene.seen(motion.q[:: max(1, round(settings.rate_hz / 10.0))]).mean())
    told, least = known.tip_m(after), known.tip_m(before + ENDLESS * information)
    return CellPlan(
        motion=motion,
        before_m=known.tip_m(before),
        after_m=told,
        least_m=least,
        kinds={kind: (parts[0][kind], parts[1][kind]) for kind in KINDS},
        untold=untold,
        seen=seen,
        moved=moved,
        places=found.places,
        notes=(*_notes(scene, moved, untold, seen), *_at_floor(told, least)),
    )


def _notes(scene: Scene, moved: Array, untold: tuple[str, ...], seen: float) -> tuple[str, ...]:
    """Return what stays open, and what would help."""
    notes = []
    for j, joint in enumerate(scene.arm.joints):
        turns = bool(scene.arm.revolute[j])
        if moved[j] < LITTLE[turns]:
            how = f"{moved[j] / DEG:.0f} deg" if turns else f"{moved[j]:.3f} m"
            notes.append(
                f"{joint.name} moves over {how} only while both cameras see the lights: its zero and its links are "
                "hardly told; widen its limits, or place the target so that it stays in view while this joint moves"
            )
    of_arm = [name for name in untold if "." in name and name.split(".")[0] in {j.name for j in scene.arm.joints}]
    if of_arm:
        notes.append(
            f"{', '.join(of_arm)} stay as the arm's file has them: more range of those joints in view, or a target "
            "that sits further from the flange, would tell them"
        )
    lens = [name for name in untold if name.split(".")[-1] in INTRINSICS]
    if lens:
        notes.append(
            f"{', '.join(lens)} stay unknown: let the lights come nearer to the edges of the images and to the cameras"
        )
    if seen < LITTLE_SEEN:
        notes.append(
            f"both cameras see all lights in {100.0 * seen:.0f} % of the time: turn the cameras to where the tip is to "
            "be known, or let the lights face both"
        )
    return tuple(notes)


def _at_floor(told: tuple[float, float], least: tuple[float, float]) -> tuple[str, ...]:
    """Return what is said where hardly anything is left that a motion could better."""
    after, floor = max(told), max(least)
    if floor < AT_FLOOR * after:
        return ()
    return (
        f"of {after / MM:.2f} mm {floor / MM:.2f} are how large the cell is, by the arm's lengths and the target as "
        "built, which no motion tells: a rig calibrated with an exact board would (armsight calibrate cell --prior)",
    )
