"""From nothing to the final fit of a cell: start, name the lights, and fit with ever finer gates and more spots."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import TypeGuard

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array, Index
from armsight.calibrate.cell.assignment import (
    NEAR,
    SHORTEST,
    NamedLights,
    assign,
    best_pieces,
    moves,
    name_lights,
    places_on_flange,
    tracklets,
)
from armsight.calibrate.cell.checks import CURES, Cause, Suspicion, gives_way, refusal, suspicions
from armsight.calibrate.cell.fit import (
    CellData,
    CellFit,
    blocks_of,
    fit_cell,
    gauge,
    learned_tolerance,
    side_scales,
    straying,
)
from armsight.calibrate.cell.knowledge import (
    ArmTolerance,
    CellPriors,
    Knowledge,
    default_knowledge,
    shape_information,
    with_priors,
)
from armsight.calibrate.cell.model import PER_CAMERA, CellModel, start_vector
from armsight.calibrate.cell.observations import CellRecording, Spots
from armsight.calibrate.cell.start import Start, delays, find_start
from armsight.calibrate.cell.wander import JointDrift
from armsight.errors import Cancelled, Inconsistent, NotEnoughData
from armsight.records import Progress, Target

FIRST_GATE_PX, FIRST_GATE = 3.0, 12.0
"""Of the first assignment: px, and times what the start leaves in the median; a straightened lens and a nominal arm
leave some pixels."""
GATE = 6.0
"""Standard deviations beyond which a spot is another light's, a reflection or touched."""
LEAST_GATE_PX = 0.5
THIN = 8000
"""Spots used until the final fit."""
PARTED = (0.5, 0.6, 0.4, 0.7, 0.3, 0.8, 0.2)
"""Shares of a recording that nothing explains at which it is parted, to see whether something changed between."""
JUMP_S = 0.04
"""Delays of two parts that differ by so much are of a clock that jumped, not of a camera that moved."""
POOR = 6e-4
"""Of the image's width: a start that leaves more is by another arm's model, more likely than not."""
MAX_START_PX = 12.0
"""What a right start leaves at most: rolling shutters and what a nominal arm is wrong by."""
COARSE_DAMPING = 1e-4
FIRST_FREE = ("fx", "fy", "cx", "cy", "k1", "tx", "ty", "tz", "rx", "ry", "rz", "delay_s", "readout_s")
FEWEST_SPOTS = 400
FEWEST_LIT = 0.55
"""Of the frames: a camera that sees the lights in fewer was dark, or looked elsewhere."""
PLAIN = 30.0
"""Times beyond chance (without the straying, which makes up some of it) that a change is told before more is fitted."""
PLAINLY_VISIBLE = 1.0
LEAST_ALIKE = 0.5
"""Of another day's log the best of all delays correlates by 0.2 to 0.4."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solved:
    """The final fit, its model, the lights as they were named, and what speaks against one model, likeliest first."""

    model: CellModel
    fit: CellFit
    lights: NamedLights
    doubts: tuple[Suspicion, ...]


def solve_cell(
    recording: CellRecording,
    target: Target,
    tolerance: ArmTolerance,
    *,
    priors: CellPriors | None = None,
    compliance: bool | None = None,
    progress: Progress,
) -> Solved:
    """Return the fit of everything that the recording can tell. Raises DataRefused with the reason, Cancelled."""
    starts, lights = _starts(recording, target)
    _tell(progress, 1, "finding the cameras")
    model = CellModel(recording=recording, lights=lights.names)
    x = start_vector(model, [_camera_vector(recording, side, start) for side, start in enumerate(starts)], lights.xyz_m)

    def before(at: Array, believed: ArmTolerance) -> Knowledge:
        known = default_knowledge(model, at, believed, target)
        return known if priors is None else with_priors(model, known, priors, at)

    coarse = _coarse(model, x, before(x, tolerance), starts)
    coarse = _coarse(model, coarse.x, before(x, tolerance), starts)
    _tell(progress, 2, "fitting, a part of the spots")
    free = free_names(model, coarse, tolerance, compliance=bool(compliance))
    found = _round(model, coarse, before(x, tolerance), free, thin=True)
    _require_one_model(suspicions(model, found))
    passes = [True, False]
    for thin in passes:
        _tell(progress, 3 if thin else 4, "fitting, all spots")
        # how far this arm is from its model, and how it strays, are both of the fit before
        known = before(found.x, learned_tolerance(model, found, tolerance))
        found = _bearing(model, _round(model, found, known, free, thin=thin, wander=straying(model, found)))
        doubts = suspicions(model, found)
        if compliance is None and gives_way(doubts):
            compliance, free = True, free_names(model, found, tolerance, compliance=True)
            passes += [] if thin else [False]
    return Solved(model=model, fit=found, lights=lights, doubts=tuple(doubts))


def _tell(progress: Progress, done: int, note: str) -> None:
    """Tell of a round that begins. Raises Cancelled before it does."""
    progress.update(done, 4, note)
    if progress.cancelled():
        raise Cancelled(f"stopped before {note}", consequence="No result was kept")


def _bearing(model: CellModel, found: CellFit) -> CellFit:
    """Return the fit in which no joint rises under the arm's weight: one that would is held to be stiff."""
    while True:
        at = {name: model.names.index(name) for name in model.arm.sags if name in found.free}
        rising = [name for name, k in at.items() if found.x[k] < 0.0]
        if not rising:
            return found
        x = found.x.copy()
        x[[at[name] for name in rising]] = 0.0
        found = fit_cell(model, x, found, [name for name in found.free if name not in rising], found.known)


def _named(recording: CellRecording, starts: Sequence[Start], seen: Sequence[_Seen], target: Target) -> NamedLights:
    apart = np.linalg.norm(target.xyz_m[:, None] - target.xyz_m[None], axis=2) + 1e3 * np.eye(len(target.xyz_m))
    weights = [one.weights for one in seen]
    places, _ = places_on_flange([start.lights_m for start in starts], weights, float(NEAR * apart.min()))
    fits = all(start.rms_px < POOR * recording.sizes[one.side][0] for start, one in zip(starts, seen, strict=True))
    return name_lights(places, dict(zip(target.names, target.xyz_m, strict=True)), arm_fits=fits)


def _require_one_model(doubts: Sequence[Suspicion]) -> None:
    """Raise Inconsistent where something plainly changed on the way: nothing more is fitted then."""
    first = doubts[0]
    if first.evidence > PLAIN and first.visible > PLAINLY_VISIBLE and first.cause is not Cause.ELASTIC:
        raise refusal(doubts)


def free_names(model: CellModel, found: CellFit, tolerance: ArmTolerance, *, compliance: bool) -> tuple[str, ...]:
    """Return all that can be told: lenses, places, clocks, lights, and of the arm what is not the others' as well."""
    arm = model.arm
    candidates = (*arm.geometry, *(arm.sags if compliance else ()))
    information = found.normals.A.sum(axis=0) + shape_information(model, found.x, found.known.shape)
    chosen = gauge(model, information, candidates, tolerance)
    # skew is no more than a manufacturer's fault that nobody has seen for decades
    lens = [f"{side}.{name}" for side in model.recording.names for name in PER_CAMERA if name != "skew"]
    return (*lens, *chosen, *model.names[model.lights_at :])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Seen:
    """What one camera saw of lights that move: ways (rows of spots), the delays that are likely, and how alike both
    move at the best one."""

    side: int
    spots: Spots
    ways: list[Index]
    delays_s: Array
    alike: float

    @property
    def weights(self) -> Array:
        """How many spots each piece has that is looked at."""
        return np.array([len(rows) for rows in best_pieces(self.spots, self.ways)], float)

    def start(self, recording: CellRecording, places: Array | None = None) -> Start | None:
        """Return the camera that explains it, by lights at known places (k, 3) on the flange where these are given."""
        size = recording.sizes[self.side]
        return find_start(recording.arm, recording.log, self.spots, self.ways, size, self.delays_s, places)


def _starts(recording: CellRecording, target: Target) -> tuple[list[Start], NamedLights]:
    """Return each camera to begin with, and the lights by their names."""
    seen = [_seen(recording, side) for side in range(len(recording.names))]
    found = [one.start(recording) for one in seen]
    strong = [k for k, start in enumerate(found) if _explains(start)]
    if not strong or recording.is_pair or len(strong) == len(found):
        starts = [_explained(recording, one, start) for one, start in zip(seen, found, strict=True)]
        return starts, _named(recording, starts, seen, target)
    # a camera that sees too little by itself is placed by the lights that the others have found
    starts = [_explained(recording, seen[k], found[k]) for k in strong]
    lights = _named(recording, starts, [seen[k] for k in strong], target)
    again = [start if k in strong else seen[k].start(recording, lights.xyz_m) for k, start in enumerate(found)]
    return [_explained(recording, one, start) for one, start in zip(seen, again, strict=True)], lights


def _explained(recording: CellRecording, seen: _Seen, start: Start | None) -> Start:
    """Return the camera. Raises Inconsistent where it explains nothing, or is a mirrored one."""
    if not _explains(start):
        raise _unexplained(recording, seen, start)
    # a mirrored picture has a camera of its own that explains it, but a left-handed one
    if start.mirrored:
        raise Inconsistent(
            f"the {recording.names[seen.side]} camera shows the scene as in a mirror",
            consequence="Nothing is calibrated",
            cure="Switch off the mirroring of its pictures; or check the signs of the joints in --model",
        )
    return start


def _explains(start: Start | None) -> TypeGuard[Start]:
    return start is not None and start.rms_px <= MAX_START_PX


def _seen(recording: CellRecording, side: int) -> _Seen:
    """Return what a camera saw. Raises NotEnoughData where that is too little."""
    name, number = recording.names[side], recording.clocks[side].number
    spots = recording.spots.take(recording.spots.side == side)
    ways = tracklets(spots, number)
    if sum(map(len, ways)) < FEWEST_SPOTS:
        raise NotEnoughData(
            f"the {name} camera saw {sum(map(len, ways))} spots that move",
            consequence="Nothing is calibrated",
            cure="See that the target's lights shine and stay in its view while the arm moves; set --threshold "
            "where lights are not found",
        )
    if recording.is_pair:  # of more cameras one may see the lights seldom, while the others do
        seen = len(np.unique(np.concatenate([spots.frame[rows] for rows in ways])))
        # frames without lights may have no rows in a table: the clock counts them all
        require_lit(seen / (1 + int(number[-1])), f"the {name} camera", "its frames")
    tried, alike = delays(recording.arm, recording.log, spots, ways)
    return _Seen(side=side, spots=spots, ways=ways, delays_s=tried, alike=float(alike[0]))


def _unexplained(recording: CellRecording, seen: _Seen, start: Start | None) -> Inconsistent:
    """Return the error for a camera that no place explains, with what it may be; raises what is known better."""
    name = recording.names[seen.side]
    _require_alike(seen.alike, name)
    _require_unchanged(recording, seen.side, seen.spots, seen.ways)
    return Inconsistent(
        f"no camera explains what the {name} one saw by the arm's motion"
        + ("" if start is None else f": {start.rms_px:.0f} px remain"),
        consequence="Nothing is calibrated",
        cure="Check that --model is of this arm and its signs, the log in radians and of all this recording, "
        "the target on the flange, lit all the time, and the camera untouched; or record longer, all joints "
        "turning further",
    )


def _require_alike(r: float, side: str) -> None:
    """Raise Inconsistent where image and arm never move alike."""
    if r < LEAST_ALIKE:
        raise Inconsistent(
            f"the lights in the {side} camera and the arm's joints never move alike: the correlation of their speeds "
            f"is {r:.2f} at best",
            consequence="Nothing is calibrated",
            cure="Give the robot's log of this very recording, and see that the lights are on this arm's flange",
        )


def _require_unchanged(recording: CellRecording, side: int, spots: Spots, ways: Sequence[Index]) -> None:
    """Raise Inconsistent where a camera explains each part of the recording by itself, and both together not."""
    begin, end = float(spots.stamp_s.min()), float(spots.stamp_s.max())
    for share in PARTED:
        at = begin + share * (end - begin)
        found = []
        for first in (True, False):
            kept = [rows[(spots.stamp_s[rows] < at) == first] for rows in ways]
            kept = [rows for rows in kept if len(rows) >= SHORTEST and moves(spots.uv_px[rows])]
            if sum(map(len, kept)) < FEWEST_SPOTS:
                break
            tried, _ = delays(recording.arm, recording.log, spots, kept)
            start = find_start(recording.arm, recording.log, spots, kept, recording.sizes[side], tried)
            if start is None or start.rms_px > 2.0 * POOR * recording.sizes[side][0]:
                break
            found.append(start)
        if len(found) == 2:
            jumped = abs(found[1].delay_s - found[0].delay_s) > JUMP_S
            cause = Cause.CLOCK_JUMPED if jumped else Cause.CAMERA_MOVED
            raise Inconsistent(
                f"{recording.names[side]} {cause.value} on the way: what it saw before {at - begin:.0f} s of its "
                "frames and after is explained by the arm's motion, each by itself, and both together not",
                consequence="One calibration does not hold for all of the recording, and none is given",
                cure=CURES[cause].format(part=recording.names[side]),
            )


def require_lit(share: float, who: str, of: str) -> None:
    """Raise NotEnoughData where a camera saw the lights in too few of its frames, or all cameras in too few moments."""
    if share < FEWEST_LIT:
        raise NotEnoughData(
            f"{who} saw the target's lights in {100.0 * share:.0f} % of {of}",
            consequence="What the rest would say is not known, and no cell is calibrated",
            cure="See that the lights shine all the time and stay in view, and record again",
        )


def _camera_vector(recording: CellRecording, side: int, start: Start) -> Array:
    half = 0.5 * recording.clocks[side].period_s
    f = start.focal_px
    lens = [f, f, *start.centre_px, 0.0, start.k1, 0.0, 0.0, 0.0, 0.0]
    return np.concatenate([lens, start.t, Rotation.from_matrix(start.R).as_rotvec(), [start.delay_s, 0.0, half]])


def thinned(spots: Spots, most: int) -> Spots:
    """Return every k-th frame's spots, so that there are about most."""
    step = max(1, round(len(spots) / most))
    return spots.take(spots.frame % step == 0)


def _coarse(model: CellModel, x: Array, known: Knowledge, starts: Sequence[Start]) -> CellFit:
    """Return the fit of cameras and lights by the nominal arm."""
    gates = [FIRST_GATE_PX + FIRST_GATE * start.rms_px for start in starts]
    spots, block = blocks_of(model, x, thinned(assign(model, x, model.recording.spots, gates), THIN))
    if len(spots) < FEWEST_SPOTS:
        raise NotEnoughData(
            f"{len(spots)} spots are where the lights should be",
            consequence="Nothing is calibrated",
            cure="Record two minutes in which the cameras see the target's lights",
        )
    free = [f"{side}.{name}" for side in model.recording.names for name in FIRST_FREE]
    spread = float(np.median(spots.spread_px))
    first = (1.0 / spread,) * len(starts)  # of a pixel: what the nominal arm leaves, not the spots' own
    data = CellData(spots=spots, block=block, scale=first)
    return fit_cell(model, x, data, (*free, *model.names[model.lights_at :]), known, COARSE_DAMPING)


def _round(
    model: CellModel,
    before: CellFit,
    known: Knowledge,
    free: Collection[str],
    *,
    thin: bool,
    wander: JointDrift | None = None,
) -> CellFit:
    """Return the fit after another assignment of the spots, with the noise of the fit before."""
    scale = side_scales(before)
    spread = float(np.median(before.spots.spread_px))
    gates = [max(GATE * each * spread, LEAST_GATE_PX) for each in scale]
    every = assign(model, before.x, model.recording.spots, gates)
    spots, block = blocks_of(model, before.x, thinned(every, THIN) if thin else every)
    if wander is not None:
        count = np.bincount(block)
        wander = replace(wander, t_s=np.bincount(block, weights=model.times_s(before.x, spots)) / count)
    # the straying's stretches are those of these spots
    data = CellData(spots=spots, block=block, scale=scale, wander=wander)
    return fit_cell(model, before.x, data, free, known)
