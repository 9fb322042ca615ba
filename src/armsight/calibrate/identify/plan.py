"""Which sweeps to make and what accuracy to expect of them, before they are made (Cramer-Rao, MATH 4.3).

A small probe of every joint about the start pose tells the arm roughly. From it, rest poses and ranges are chosen,
within limits and where two cameras surely see the beacon, that make the determinant of the information largest: this
is the volume of the standard deviations, which is least for the axes' parameters and for the table's at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.arrays import Array
from armsight.calibrate.identify.chain import KEYS, assign_frames, degeneracy_notes, deviations, propagate_covariance
from armsight.calibrate.identify.rough_arm import RoughArm, View, prior_information
from armsight.defaults import SWEEP_READINGS
from armsight.errors import Degenerate, Inconsistent, NotEnoughData, UsageError
from armsight.geometry.poses import skew
from armsight.optics import Rig
from armsight.records import frozen_array

PROBE_SHARE = 0.05
"""Share of a joint's travel that a probe moves it: small beside what a free working position allows."""
RESTS, GRID, ROUNDS = 150, 41, 4
"""Rest poses tried a joint, values of its range, rounds of exchange."""
PLAN_SEED = 1
AT_LIMIT = 2e-4
"""A reading (rad, m) so near a limit, or so far beyond, is at it: an encoder's step."""
POOR_M, POOR_RAD = 0.005, np.deg2rad(1.0)
"""Expected standard deviations beyond these are named: an arm known worse is of no use to a controller."""

NEARLY_PARALLEL = 0.1
"""Sine between axes below which an offset along them is told ten times worse than a distance, and more."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlannedSweep:
    """A sweep: joint (from 0), q (readings, n), what ends its range: ('limit' or 'view') at both ends, span: rad or m.

    radius_m: the beacon's distance from a turning joint's axis, 0 of a slide. way: poses (k, n) that lead to its first
    reading, each a move of one joint.
    """

    joint: int
    q: Array
    ends: tuple[str, str]
    radius_m: float
    way: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", frozen_array("q", self.q, (None, None)))
        object.__setattr__(self, "way", frozen_array("way", self.way, (None, self.q.shape[1])))

    @property
    def span(self) -> float:
        """How far the joint moves, rad or m."""
        return float(abs(self.q[-1, self.joint] - self.q[0, self.joint]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """Sweeps in the order of moving; the standard deviations of the table's entries to expect (NaN: chosen, not
    measured)."""

    sweeps: tuple[PlannedSweep, ...]
    expected: tuple[dict[str, float], ...]
    notes: tuple[str, ...]
    sigma_px: float


def checked_limits(limits: ArrayLike, start: ArrayLike) -> tuple[Array, Array]:
    """Return limits (n, 2) and start (n,) as arrays; a limit at which the arm stands is moved by an encoder's step.

    Raises UsageError, Inconsistent for a start beyond the limits.
    """
    low_high, q = np.asarray(limits, dtype=float), np.asarray(start, dtype=float)
    if low_high.shape != (len(q), 2) or not np.isfinite(low_high).all() or not (low_high[:, 0] < low_high[:, 1]).all():
        raise UsageError(
            f"the limits do not give {len(q)} joints a lower and an upper value each",
            cure="Write lo:hi for every joint, in rad or m, lower before upper",
        )
    beyond = np.flatnonzero((q < low_high[:, 0] - AT_LIMIT) | (q > low_high[:, 1] + AT_LIMIT))
    if len(beyond):
        j = int(beyond[0])
        raise Inconsistent(
            f"joint {j + 1} stands at {q[j]:.4g}, outside its limits {low_high[j, 0]:g} to {low_high[j, 1]:g}",
            consequence="Nothing is moved",
            cure="Bring the arm to a pose within the limits first, or correct them (rad, m)",
        )
    at_limit = np.abs(low_high - q[:, None]) <= AT_LIMIT
    return low_high + at_limit * [-2.0 * AT_LIMIT, 2.0 * AT_LIMIT], q


def probe(limits: Array, start: Array, joint: int, *, share: float = PROBE_SHARE, readings: int = 6) -> Array:
    """Return poses (readings, n) that move one joint by a share of its travel about the start, within limits."""
    low, high = limits[joint]
    half = 0.5 * share * (high - low)
    middle = float(np.clip(start[joint], low + half, high - half))
    q = np.tile(start, (readings, 1))
    q[:, joint] = np.clip(np.linspace(middle - half, middle + half, readings), low, high)
    return q


def propose_sweeps(
    arm: RoughArm,
    rig: Rig,
    limits: ArrayLike,
    start: ArrayLike,
    *,
    readings: int = SWEEP_READINGS,
    base: Array | None = None,
    around_m: float = 0.0,
) -> Plan:
    """Return the sweeps that tell the arm best, and the standard deviations to expect of the table they give.

    limits (n, 2), start (n,): in rad or m, joint by joint. base (4, 4): as identify takes it. around_m: how far
    what belongs to the beacon, such as a target's other lights, reaches round it. Raises UsageError,
    Inconsistent, NotEnoughData where the beacon is not in two cameras' images at the start, Degenerate where a joint
    cannot be moved in view.
    """
    low_high, q0 = checked_limits(limits, start)
    if len(q0) != len(arm.axes):
        raise UsageError(f"the arm has {len(arm.axes)} joints, the limits {len(q0)}")
    view = View.of(arm, rig, around_m)
    if not view.seen(q0[None])[0]:
        raise NotEnoughData(
            "the beacon is not surely in both images at the start pose"
            if rig.is_pair
            else "the beacon is not surely in the images of two cameras at the start pose",
            consequence="No sweep is proposed",
            cure="Start where two cameras see the beacon, well inside the image",
        )
    rng = np.random.default_rng(PLAN_SEED)
    candidates = [_candidates(view, low_high, q0, j, readings, rng) for j in range(len(q0))]
    chosen = _exchange(candidates, prior_information(arm.model))
    sweeps = _ordered(view, [found[k] for found, k in zip(candidates, chosen, strict=True)], q0)
    expected, notes = expected_deviations(arm, rig, np.concatenate([sweep.q for sweep in sweeps]), base)
    return Plan(
        sweeps=tuple(sweeps), expected=expected, notes=(*notes, *_poor(expected, sweeps, arm)), sigma_px=arm.sigma_px
    )


def expected_deviations(
    arm: RoughArm, rig: Rig, q: Array, base: Array | None = None
) -> tuple[tuple[dict[str, float], ...], list[str]]:
    """Return the standard deviations that readings at q (m, n) will leave of each joint's entries, and notes on odd
    cases."""
    model, frame = arm.model, np.eye(4) if base is None else base
    G = View.of(arm, rig).slopes(q) / arm.sigma_px
    covariance = np.linalg.inv(np.einsum("mia,mib->ab", G, G) + prior_information(model))
    at = np.zeros(len(covariance))
    if (
        arm.covariance is None
    ):  # a model may say exactly parallel; what will be found is off that by its standard deviations
        at = np.linalg.cholesky(covariance) @ np.random.default_rng(PLAN_SEED).normal(size=len(at))
    axes, beacon = model.axes_at(at)

    def entries(x: Array) -> Array:
        return assign_frames(*model.axes_at(x), frame)[0].ravel()

    notes, known = degeneracy_notes(
        axes, assign_frames(axes, beacon, frame)[0], deviations(propagate_covariance(entries, at, covariance))
    )
    return tuple(dict(zip(KEYS, row.tolist(), strict=True)) for row in known), notes


class Candidate(NamedTuple):
    """A sweep that could be made: readings (m, n), what ends its range, its information (P, P)."""

    joint: int
    q: Array
    ends: tuple[str, str]
    information: Array


def _candidates(
    view: View, limits: Array, start: Array, joint: int, readings: int, rng: np.random.Generator
) -> list[Candidate]:
    """Return sweeps of one joint from the start's and from random rest poses, each over its longest range in view."""
    rests = np.vstack([start, rng.uniform(limits[:, 0], limits[:, 1], (RESTS, len(start)))])
    values = np.linspace(limits[joint, 0], limits[joint, 1], GRID)
    q = np.repeat(rests, GRID, axis=0)
    q[:, joint] = np.tile(values, len(rests))
    seen = view.seen(q).reshape(len(rests), GRID)
    out = []
    for rest, row in zip(rests, seen, strict=True):
        first, last = _longest(row)
        if last - first < 1:
            continue
        poses = np.tile(rest, (readings, 1))
        poses[:, joint] = np.linspace(values[first], values[last], readings)
        if view.way(start, poses[0]) is None and view.way(start, poses[-1]) is None:
            continue
        G = view.slopes(poses) / view.arm.sigma_px
        ends = ("limit" if first == 0 else "view", "limit" if last == GRID - 1 else "view")
        out.append(Candidate(joint, poses, ends, np.einsum("mia,mib->ab", G, G)))
    if not out:
        raise Degenerate(
            f"joint {joint + 1} cannot be moved by {1.0 / (GRID - 1):.0%} of its travel with the beacon surely in view",
            consequence="No sweep of it is proposed",
            cure="Start from a pose with the beacon in the middle of the images, or move the cameras back",
        )
    return out


def _longest(row: NDArray[np.bool_]) -> tuple[int, int]:
    """Return first and last index of the longest run of True; (0, -1) without one."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(int)))
    if not len(edges):
        return 0, -1
    runs = edges.reshape(-1, 2)
    first, end = runs[int(np.argmax(runs[:, 1] - runs[:, 0]))]
    return int(first), int(end) - 1


def _exchange(candidates: Sequence[Sequence[Candidate]], prior: Array) -> list[int]:
    """Return one candidate a joint by the determinant of all information: first in turn, then exchanged one by one."""
    stacks = [np.stack([one.information for one in found]) for found in candidates]
    chosen, total = [-1] * len(stacks), prior.copy()
    for _ in range(ROUNDS):
        before = list(chosen)
        for j, stack in enumerate(stacks):
            if chosen[j] >= 0:
                total = total - stack[chosen[j]]
            # D-optimal: a joint's sweep is the best one beside those of all others
            chosen[j] = int(np.argmax(np.linalg.slogdet(total + stack)[1]))
            total = total + stack[chosen[j]]
        if chosen == before:
            break
    return chosen


def _ordered(view: View, chosen: Sequence[Candidate], start: Array) -> list[PlannedSweep]:
    """Return the sweeps with the ways between them: the next is the nearest, reached in view, else by way of the start.

    The order does not matter to the arm that is found, only to the time it takes.
    """
    left, at, begun, out = list(chosen), start, start, []
    travel = np.maximum(np.ptp(np.concatenate([one.q for one in chosen]), axis=0), 1e-9)
    while left:
        both_ways = [(i, q) for i, one in enumerate(left) for q in (one.q, one.q[::-1])]
        turns = [(float(np.abs((q[0] - at) / travel).sum()), i, q) for i, q in both_ways]
        turns.sort(key=lambda turn: turn[0])
        found = next(((i, q, way) for _, i, q in turns if (way := view.way(at, q[0])) is not None), None)
        if found is None:
            home = _home(view, at, begun, start)
            found = next(
                (i, q, np.vstack([home, way])) for _, i, q in turns if (way := view.way(start, q[0])) is not None
            )
        i, q, way = found
        one = left.pop(i)
        ends = one.ends if q is one.q else one.ends[::-1]
        radius = _radius(view.arm, one.joint, q)
        out.append(PlannedSweep(joint=one.joint, q=q, ends=ends, radius_m=radius, way=way))
        at, begun = q[-1], q[0]
    return out


def _home(view: View, at: Array, begun: Array, start: Array) -> Array:
    """Return the way back to the start: straight, or from the sweep's beginning."""
    straight = view.way(at, start)
    if straight is not None:
        return straight
    back = view.way(begun, start)
    if back is None:
        raise Degenerate(
            "the sweeps cannot be joined with the beacon in view",
            consequence="No sweep is proposed",
            cure="Narrow the limits",
        )
    return np.vstack([begun, back])


def _radius(arm: RoughArm, joint: int, q: Array) -> float:
    """Return the beacon's distance from a turning joint's axis during its sweep: from the two first readings' chord."""
    if not arm.axes[joint].revolute:
        return 0.0
    X = arm.model.predict(np.zeros(len(arm.model.names)), q[:2])[0]
    step = abs(q[1, joint] - q[0, joint])
    # a chord is 2 r sin(angle / 2)
    return float(np.linalg.norm(X[1] - X[0]) / max(2.0 * abs(np.sin(0.5 * step)), 1e-12))


def _poor(expected: Sequence[dict[str, float]], sweeps: Sequence[PlannedSweep], arm: RoughArm) -> list[str]:
    """Return a note on every entry that will be known badly, with the sweep that is to blame."""
    reach = {  # in m: of a turn the chord, as far as it grows with the angle
        one.joint: min(one.span, 1.0) * one.radius_m if arm.axes[one.joint].revolute else one.span for one in sweeps
    }
    by_joint = {sweep.joint: sweep for sweep in sweeps}
    notes = []
    for i, entries in enumerate(expected):
        for key, std in entries.items():
            length = key.endswith("_m")
            if not np.isfinite(std) or std <= (POOR_M if length else POOR_RAD):
                continue
            shown = f"{1e3 * std:.2g} mm" if length else f"{np.rad2deg(std):.2g} deg"
            weak = by_joint[min((j for j in (i, i + 1) if j in reach), key=lambda j: reach[j])]
            why = (_parallel_said(i, arm) if key == "d_m" else "") or _sweep_said(weak, arm)
            notes.append(f"joint {i + 1}, {key}: only to {shown} is to be expected; {why}")
    return notes


def _parallel_said(joint: int, arm: RoughArm) -> str:
    """Return that an offset lies along an axis nearly parallel to one beside it; the angle is the same in any pose."""
    for k in (joint - 1, joint):
        if 0 <= k < len(arm.axes) - 1:
            sine = float(np.linalg.norm(skew(arm.axes[k].direction) @ arm.axes[k + 1].direction))
            if sine < NEARLY_PARALLEL:
                return f"axes {k + 1} and {k + 2} are nearly parallel, and where they come nearest is hardly seen"
    return ""


def _sweep_said(sweep: PlannedSweep, arm: RoughArm) -> str:
    ended = " and ".join(sorted({"its limits" if end == "limit" else "the cameras' view" for end in sweep.ends}))
    if arm.axes[sweep.joint].revolute:
        what = f"an arc of {np.rad2deg(sweep.span):.0f} deg, {1e3 * sweep.radius_m:.0f} mm from the axis"
    else:
        what = f"a way of {1e3 * sweep.span:.0f} mm"
    return f"the sweep of joint {sweep.joint + 1} is {what}, ended by {ended}"
