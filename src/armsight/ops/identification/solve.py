"""Sweeps in, the arm that made them out; and the sweeps that frames show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from armsight.arrays import Image
from armsight.calibrate.identify import Identification, Sweeps, identify
from armsight.calibrate.identify.chain import placed_by
from armsight.calibrate.identify.result import LeftOutJoint, PlanOutput
from armsight.calibrate.identify.sweeps import require_two
from armsight.drivers import is_video, moments_of
from armsight.errors import Cancelled, Inconsistent, NotEnoughData
from armsight.kinematics import Arm
from armsight.measure.poses.beacon import without_standing
from armsight.measure.poses.moments import measure_chosen, require_views
from armsight.measure.poses.pipeline import Setup, check_sizes
from armsight.measure.spots import find_spots
from armsight.ops.identification.beacon_observer import SeenBeacon, beacon_note, beacon_of, beacon_settings
from armsight.ops.identification.left_out import consequence, first_joints, named
from armsight.ops.sources.cameras import cameras_of, named_cameras, open_cameras
from armsight.optics import Rig
from armsight.records import Frame, Progress, Spots, Target
from armsight.store import World
from armsight.store.arm_points import read_sweep_joints
from armsight.store.interpret import OURS, TableFormat


def solve_sweeps(
    sweeps: Sweeps,
    *,
    rig: Rig | None = None,
    world: World | None = None,
    nominal: Arm | None = None,
    held: Sequence[float] = (),
    name: str = "identified",
    notes: Sequence[str] = (),
    plan: PlanOutput | None = None,
    sigma: float | None = None,
    method: str = "ml",
    increments: str = "known",
) -> Identification:
    """Return the arm that made these sweeps, in the axes of the rig's parent where a world is known.

    nominal: what it is held against. held: where joints behind the swept ones stood, rad or m. notes go first. plan: of
    the sweeps. sigma, method, increments: see calibrate.identify. Raises DataRefused.
    """
    m, n = sweeps.n, sweeps.n + len(held)
    left_out = range(m + 1, n + 1)
    nominal = None if nominal is None else _swept_part(nominal, m, held)
    found = identify(
        sweeps,
        rig=rig if sweeps.uv_px is not None else None,
        sigma=sigma,
        method=method,
        increments=increments,
        base=None if world is None else world.T_parent_rig.inv().as_matrix(),
        name=f"{name}, {named(range(1, m + 1))} of {n}" if left_out else name,
    )
    _check_paper(found)
    arm = found.arm
    if world is not None:  # found in the rig's axes
        arm = placed_by(world.T_parent_rig, arm, on_base=world.parent == "base")
    first = [consequence(n, left_out)] if left_out else []
    kept = tuple(LeftOutJoint(joint=joint, held_at=at) for joint, at in zip(left_out, held, strict=True))
    return replace(
        found,
        arm=arm,
        notes=(*first, *notes, *found.notes),
        nominal=nominal,
        plan=plan,
        left_out=kept or None,
    )


def _swept_part(nominal: Arm, m: int, held: Sequence[float]) -> Arm:
    """Return the nominal arm of m swept joints, those behind them held. Raises Inconsistent for one of others."""
    if held and nominal.n == m + len(held):
        nominal = first_joints(nominal, m, np.array(held))
    if len(nominal.joints) != m:
        raise Inconsistent(
            f"the nominal arm has {len(nominal.joints)} joints, the sweep {m}",
            consequence="They cannot be compared",
            cure="Give the arm that was swept, or none",
        )
    return nominal


def _check_paper(result: Identification) -> None:
    """Raise Inconsistent where the paper's means miss the readings that they were made from by far."""
    if result.method != "paper" or not result.useless:
        return
    raise Inconsistent(
        f"the paper's method gives an arm that misses its own readings by {result.misfit:.0f} standard deviations of "
        f"their noise, {result.worst_m * 1e3:.3g} mm RMS on the worst joint",
        consequence="The arm is useless and is not written",
        cure="Use --method ml: the same readings, fitted at once",
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BeaconFrames:
    """Frames of a beacon, with the table of which joint moved and all readings in each.

    mask: an image that is black where no light may be.
    """

    target: Target
    left: str | None
    right: str | None
    joints: Path
    cameras: Mapping[str, str] = field(default_factory=dict)
    mask: Image | None = None
    table: TableFormat = OURS

    def sweeps(self, rig: Rig, progress: Progress) -> tuple[Sweeps, list[str]]:
        """Return the sweep that the frames show, and notes on those in which the beacon is not seen."""
        target, given = self.target, cameras_of(rig.names, named_cameras(self.cameras, self.left, self.right))
        frames, joint, q = read_sweep_joints(self.joints, self.table)
        setup = Setup(rig=rig, target=target, settings=beacon_settings(target, self.mask))
        wanted = set(frames.tolist())
        require_two(rig)
        require_views(setup, len(rig.cameras))
        spots: list[tuple[int, list[Spots]]] = []
        with open_cameras(given, colour=target.colour is not None) as moments:
            for count, views in enumerate(moments_of(moments)):
                # by time a frame without partner leaves no moment, and the next one keeps its number
                first = next(frame for frame in views if frame is not None)
                number = first.sequence if is_video(next(iter(given.values()))) else count
                if progress.cancelled():
                    raise Cancelled("the frames were not read to the end", consequence="Nothing was written")
                progress.update(count + 1, max(wanted) + 1, "looking for the beacon")
                if number in wanted:
                    check_sizes(setup.rig, views)
                    spots.append((number, [_spots(setup, frame) for frame in views]))
        name, seen, notes = beacons(setup, spots)
        rows = [i for i, frame in enumerate(frames.tolist()) if frame in seen]
        if not rows:
            raise NotEnoughData(
                f"the beacon is seen in none of the {len(frames)} frames; {notes[0] if notes else 'there are none'}",
                consequence="The arm is not identified",
                cure="Look at the frames: one light, on, in both views"
                if rig.is_pair
                else "Look at the frames: one light, on, in the views of two cameras",
            )
        return Sweeps(
            joint=joint[rows],
            q=q[rows],
            xyz_m=np.array([seen[int(frames[i])].xyz_m for i in rows]),
            uv_px=np.array([seen[int(frames[i])].uv_px for i in rows]),
            std_px=np.array([seen[int(frames[i])].std_px for i in rows]),
            cameras=rig.names,
        ), [*beacon_note(name, len(target.names)), *notes]


def _spots(setup: Setup, frame: Frame | None) -> Spots:
    """Return the spots of a view, none without a picture."""
    return Spots.none() if frame is None or frame.unreadable else find_spots(frame.image, setup.settings)


def beacons(setup: Setup, spots: list[tuple[int, list[Spots]]]) -> tuple[str, dict[int, SeenBeacon], list[str]]:
    """Return which light is the beacon, the beacon by frame, and why it is not seen in the others; spots: by camera.

    The beacon moves with the arm: what stands at one place in most frames is something else. Of several lights it is
    the one that is seen most often, in all frames the same.
    """
    names = setup.target.names
    by_light: dict[str, dict[int, SeenBeacon]] = {name: {} for name in names}
    whys: dict[int, str] = {}
    moving = [without_standing(seen) for seen in zip(*(views for _, views in spots), strict=True)]
    for (number, _), views in zip(spots, zip(*moving, strict=True), strict=True):
        found = measure_chosen(setup, float(number), views)
        whys[number] = found.pose.why or "the beacon is not seen"
        for name in names:
            if (beacon := beacon_of(found, name, setup.target)) is not None:
                by_light[name][number] = beacon
    chosen = max(names, key=lambda name: len(by_light[name]))
    notes = [f"frame {number}: {why}" for number, why in whys.items() if number not in by_light[chosen]]
    return chosen, by_light[chosen], notes
