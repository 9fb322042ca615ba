"""How late each camera's clock is, and how long it takes to read a picture, from the motion of the board itself.

A picture's points are cut into bands of rows, each a view by itself at its own time; what the board moves within a band
is taken from the points by the motion that was found, until both agree.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from armsight.arrays import Array
from armsight.calibrate.cameras.bundle_adjustment import Bundle, adjust, bundle_of, delays_of, readouts_of, start_at
from armsight.calibrate.cameras.moving_board import alone, motion_of
from armsight.calibrate.cameras.observations import BoardOptions, Observations
from armsight.calibrate.cameras.outlier_rejection import fixed_names, named
from armsight.calibrate.cameras.pairing import as_pose, camera_of
from armsight.calibrate.cameras.preconditions import LEAST_VIEWS
from armsight.errors import DataRefused, Undetermined
from armsight.fitting import Fit
from armsight.records import Progress

LOOSE_S = 0.02
"""A delay less sure than this is held at zero: boards were still, or times are none."""
LOOSE_READOUT_S = 0.004
"""A read-out less sure than this is: a third of what webcams take."""
BY_CHANCE = 1e-3
"""Delays and read-outs are taken where chi-square would fall as much without any this often."""
BANDS = 4
"""Bands over a board of usual height: what is left in a band is a sixteenth of what it tells of the read-out."""
ROUNDS = 1
"""Fits after the first; each leaves a sixteenth of the error in what is taken from the points."""
STEP_S = 1e-4
"""Step of the differences by time."""

Timed = tuple[Observations, Bundle, list[str], list[tuple[str, str]]]


def with_clocks(
    observations: Observations,
    start: Bundle,
    options: BoardOptions,
    times: Array | None,
    readouts_s: Mapping[str, float],
    progress: Progress | None,
) -> Timed:
    """Return observations with their times where the board's motion tells the delays, the state, advice, and (source,
    why) of moments left out. readouts_s: those known, by camera."""
    fitted, C = partial(_fitted, options, progress), observations.n_cameras
    if times is None:
        told = ["the delays of the clocks are held at zero: the images have no times; hold the board still for each"]
        return observations, start, told, []
    # what the moments say with every board held still is both the start and the rival
    still_fit = fitted(observations, start)
    state = replace(bundle_of(still_fit, C), delays_s=np.zeros(C - 1))
    timed = replace(observations, t_s=times)
    stay, lost = _with_neighbours(timed, state)
    if len(stay) >= LEAST_VIEWS:
        try:
            timed, state = timed.take(stay), start_at(state, stay)
            fit = fitted(timed, state)
            loose = {name for name, std in fit.std().items() if name in delays_of(timed.cameras) and std > LOOSE_S}
            if loose:
                timed = replace(timed, held=timed.held | loose)
                fit = fitted(timed, state)
            compared = fitted(observations.take(stay), start_at(bundle_of(still_fit, C), stay))
            # both on the same points: by how much chi-square falls for as many delays
            gain = 2.0 * (compared.cost - fit.cost) / fit.scale**2
        except (DataRefused, Undetermined):
            gain = 0.0
        else:
            asked = [name for name in delays_of(timed.cameras) if name not in timed.held]
            if asked and gain > chdtri(len(asked), BY_CHANCE):
                told = [f"{name} is held at zero: the board's motion does not tell it" for name in sorted(loose)]
                timed, state, rolled = _rolled(timed, fit, options, readouts_s, progress)
                return timed, state, [*told, *rolled], lost
    told = ["the delays of the clocks are held at zero: the board's motion does not tell them"]
    return observations, start, told, []


def _fitted(options: BoardOptions, progress: Progress | None, seen: Observations, state: Bundle) -> Fit:
    return adjust(seen, state, fixed_names(options, seen), max_iterations=options.max_iterations, progress=progress)


def _with_neighbours(timed: Observations, state: Bundle) -> tuple[NDArray[np.intp], list[tuple[str, str]]]:
    """Return the moments with others near enough in time, and the rest with why they are left out."""
    # a moment of one camera tells nothing of another one's clock: it may stay without neighbours
    lonely = alone(timed, state.delays_s) & ((timed.weight > 0.0).any(axis=2).sum(axis=1) > 1)
    why = "no other moment is near enough in time to tell how the board moved"
    return np.flatnonzero(~lonely), [(named(timed, g), why) for g in np.flatnonzero(lonely).tolist()]


def _rolled(
    timed: Observations, fit: Fit, options: BoardOptions, given: Mapping[str, float], progress: Progress | None
) -> tuple[Observations, Bundle, list[str]]:
    """Return observations with read-outs where the board's motion tells them, the state, and advice."""
    C, names = timed.n_cameras, readouts_of(timed.cameras)
    known = {name: given[camera] for name, camera in zip(names, timed.cameras, strict=True) if camera in given}
    line, band = _bands(timed)
    state = replace(bundle_of(fit, C), readouts_s=np.array([known.get(name, 0.0) for name in names]))
    rolled = replace(timed, line=band, held=timed.held | set(known))
    told = "read-outs are held at zero, as of global shutters: the board's motion does not tell them"
    try:
        for _ in range(1 + ROUNDS):
            rolled = replace(rolled, uv=timed.uv - _within(rolled, state, line - band))
            most, fixed = options.max_iterations, fixed_names(options, rolled)
            found = adjust(rolled, state, fixed, max_iterations=most, progress=progress)
            loose = {name for name, std in found.std().items() if name in names and std > LOOSE_READOUT_S}
            state = bundle_of(found, C)
            if loose:
                rolled = replace(rolled, held=rolled.held | loose)
                state = replace(state, readouts_s=np.where([one in loose for one in names], 0.0, state.readouts_s))
    except (DataRefused, Undetermined):
        return timed, bundle_of(fit, C), [told]
    asked = [name for name in names if name not in rolled.held]
    if not known and not (asked and 2.0 * (fit.cost - found.cost) / found.scale**2 > chdtri(len(asked), BY_CHANCE)):
        return timed, bundle_of(fit, C), [told]
    held = sorted(set(names) - set(asked) - set(known))
    return rolled, state, [f"{name} is held at zero: the board's motion does not tell it" for name in held]


def _bands(timed: Observations) -> tuple[Array, Array]:
    """Return where in its picture each point is (G, C, n), -0.5 to 0.5 from the first row to the last, and its band."""
    rows = np.array([size[1] for size in timed.sizes], float)[:, None]
    line, seen = timed.uv[..., 1] / (rows - 1.0) - 0.5, timed.weight > 0.0
    high = np.where(seen, line, -np.inf).max(axis=2) - np.where(seen, line, np.inf).min(axis=2)
    width = float(np.median(high[seen.any(axis=2)])) / BANDS
    return line, np.where(seen, (np.round(line / width)) * width, 0.0)


def _within(rolled: Observations, state: Bundle, off: Array) -> Array:
    """Return by how much each point (G, C, n, 2), px, has moved since the time of its band; off (G, C, n): lines."""
    motion = motion_of(rolled, state.delays_s, state.readouts_s)
    own = np.concatenate([state.back, state.delays_s, state.readouts_s])
    nodes = motion.nodes_of(state.poses).reshape(*motion.shape, 6)
    poses, _, _, rate = motion.along(nodes, own)
    moved, sides = np.zeros(rolled.uv.shape), [np.zeros(6), *state.sides]
    for c, k in enumerate(state.k):
        camera, T = camera_of(k, rolled.sizes[c], rolled.lenses[c]), as_pose(np.array(sides[c])).inv()
        v = np.flatnonzero(motion.camera == c)
        each = []
        for step in (-STEP_S, STEP_S):
            R = Rotation.from_rotvec(step * rate[v, 3:]) * Rotation.from_rotvec(poses[v, 3:])
            P = rolled.X @ R.as_matrix().transpose(0, 2, 1) + (poses[v, :3] + step * rate[v, :3])[:, None]
            each.append(camera.project(T.apply(P.reshape(-1, 3))).reshape(len(v), -1, 2))
        flow = (each[1] - each[0]) / (2.0 * STEP_S)
        seen = motion.views.weight[v, c] > 0.0
        at = np.nonzero(seen)
        lines = off[motion.moment[v][at[0]], c, at[1]]
        moved[motion.moment[v][at[0]], c, at[1]] = flow[at] * (state.readouts_s[c] * lines)[:, None]
    return moved
