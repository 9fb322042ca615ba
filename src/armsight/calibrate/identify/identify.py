"""Sweeps in, an arm out: types, axes, table with deviations (Kapucu and Baysec 2005; MATH 4.3, 4.5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, f

from armsight.calibrate.identify.chain import Axis, ChainModel, at_zero, fit_chain, moved_by
from armsight.calibrate.identify.joint import GROSS, PathFit, circle_misfit, fit_circle, fit_line, swung_axes
from armsight.calibrate.identify.paper import pair_line, triple_circle
from armsight.calibrate.identify.result import Identification, JointFound
from armsight.calibrate.identify.seen import Seen, seen_places
from armsight.calibrate.identify.shapes import Tilt, basis
from armsight.calibrate.identify.sweeps import Sweeps, check_sweeps, placed
from armsight.calibrate.identify.table import KEYS, arm_of, carried, place_frames, say_cases
from armsight.errors import Inconsistent, NotConverged, NotEnoughData, UsageError
from armsight.fitting import Fit
from armsight.optics import PackedRig, Rig

Array = NDArray[np.float64]

METHODS = ("ml", "paper")
INCREMENTS = ("known", "order")

DECIDED = 1e-4
"""A line is rejected below this probability: one slide in ten thousand is then called a turning joint."""
HIDDEN_RAD = 0.3
"""A path that may be an arc of so much is not certainly a line."""
STILL = 5.0
"""A beacon that moves by less than so many deviations of the noise has not moved."""
LOST_SHARE = 0.3
"""With more readings discarded the path is not that of one joint."""
POOR = 1e-12
"""Probability of a path's misfit below which it is neither line nor circle."""
FIRST_PX = 0.2
"""Noise of a beacon's centre assumed before it is found from the residuals."""
SLOPES = {1.0: "", np.pi / 180.0: "degrees given as radians", 180.0 / np.pi: "radians given as degrees",
          0.01: "centimetres given as metres", 100.0: "metres given as centimetres",
          0.001: "millimetres given as metres", 1000.0: "metres given as millimetres"}  # fmt: skip
SLOPE_NEAR = 0.25
SUSPECT = 1.6
"""A whole arm that misses its readings by so much more (variance) than single paths do may have started wrong."""
SHORT_RAD = 2.0
"""Arcs shorter than this may have their plane swung about the chord by the noise."""
SWINGS = 4
LOOSE = 1e3
"""Factor on the noise with which nothing counts as gross, while the noise itself is looked for."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Found:
    """A joint's path, the rows of its sweep that were kept, and the readings discarded."""

    path: PathFit
    rows: NDArray[np.intp]
    discarded: tuple[tuple[int, str], ...]
    p_line: float
    line_chi2: float
    decided: bool


def identify(
    sweeps: Sweeps,
    *,
    rig: Rig | None = None,
    sigma: float | None = None,
    method: str = "ml",
    increments: str = "known",
    base: Array | None = None,
    name: str = "identified",
) -> Identification:
    """Return the arm whose beacon made these paths.

    rig: the fit is of pixels; without one, of places. sigma: noise of a pixel coordinate (px) or of a place (m), if
    known; else it is found. increments: 'known', the commanded values are exact, and the whole arm is fitted at once;
    'order', only their order is used, joint by joint. base (4, 4): the frame in rig axes whose foot on axis 1 is the
    first frame's origin. method 'paper': triples, Chauvenet, means. Raises NotEnoughData, Inconsistent, UsageError.
    """
    if method not in METHODS or increments not in INCREMENTS:
        raise UsageError(f"method is one of {', '.join(METHODS)}, increments one of {', '.join(INCREMENTS)}")
    check_sweeps(sweeps)
    if rig is not None:
        sweeps = placed(sweeps, rig, sigma or FIRST_PX)
        seen = Seen(sweeps=sweeps, rig=PackedRig.of(rig), sigma=sigma or FIRST_PX, unit=sigma or FIRST_PX)
    else:
        seen = seen_places(sweeps, sigma or 1.0)
    found, seen = _paths(seen, sigma)
    notes = _notes(found)
    frame = np.eye(4) if base is None else np.asarray(base, float)
    if method == "paper":
        return _from_paper(seen, found, frame, notes, name)
    if increments == "order":
        return _joint_by_joint(seen, found, frame, notes, name)
    return _whole(seen, found, frame, notes, name, sigma)


def _paths(seen: Seen, sigma: float | None) -> tuple[list[_Found], Seen]:
    """Return every joint's path, and the readings with the noise found from all of them."""
    n = seen.sweeps.n
    if sigma is None:
        noises = [_noise(seen.take(seen.sweeps.rows(j)), seen.sweeps.q[seen.sweeps.rows(j), j]) for j in range(n)]
        known = [value for value in noises if np.isfinite(value)]
        if not known:
            raise NotEnoughData(
                "three readings of every joint leave nothing to find the noise by",
                consequence="No deviations can be given", cure="Give the noise (sigma), or take more readings",
            )  # fmt: skip
        seen = seen.at(seen.sigma * max(float(np.median(known)), 1e-9))
    found = [_one_path(seen, j, sigma) for j in range(n)]
    if sigma is None:  # once more with the noise of the shapes that were chosen
        total = sum(item.path.chi2 for item in found)
        dof = sum(item.path.dof for item in found)
        if dof > 0:
            factor = float(np.sqrt(max(total / dof, 1e-18)))
            seen = seen.at(seen.sigma * factor)
            found = [_judged(item, factor, dof) for item in found]
    return found, seen


def _judged(item: _Found, factor: float, dof: int) -> _Found:
    """Return a path with the probability of a line by an F test: the noise was found from dof residuals."""
    if item.path.kind == "line":
        return replace(item, p_line=float(chi2.sf(item.path.chi2 / factor**2, max(item.path.dof, 1))))
    gained = max(item.line_chi2 - item.path.chi2, 0.0) / factor**2
    return replace(item, p_line=float(f.sf(gained / 2.0, 2, max(dof, 1))))


def _noise(seen: Seen, order: Array) -> float:
    """Return the noise of one sweep over the assumed one, by the median of the better shape's residuals."""
    loose = seen.at(LOOSE * seen.sigma if seen.rig is not None else LOOSE)
    path = fit_line(loose, order)
    if path.dof < 1 or circle_misfit(loose) < 0.25 * path.chi2:
        try:
            path = fit_circle(loose, order)
        except NotConverged:
            return float("nan")
    if path.dof < 1:
        return float("nan")
    spread = float(np.median((path.residual**2).sum(axis=1)) / chi2.median(path.dof / len(path.residual)))
    return float(np.sqrt(spread)) * loose.sigma / seen.sigma


def _one_path(seen: Seen, joint: int, sigma: float | None) -> _Found:
    """Return a joint's path, gross readings discarded."""
    rows = seen.sweeps.rows(joint)
    out: list[tuple[int, str]] = []
    _check_moved(seen.take(rows), joint, sigma)
    for _ in range(4):
        part, order = seen.take(rows), seen.sweeps.q[rows, joint]
        straight = fit_line(part, order)
        path = fit_circle(part, order) if straight.p < DECIDED else straight
        size = np.sqrt((path.residual**2).sum(axis=1))
        bad = size > GROSS
        if not bad.any() or len(rows) - bad.sum() < 3:
            break
        worst = bad & (size >= size.max() * 0.5)
        out += [
            (int(row), f"off its path by {s:.0f} deviations") for row, s in zip(rows[worst], size[worst], strict=True)
        ]
        rows = rows[~worst]
    if len(out) > LOST_SHARE * len(seen.sweeps.rows(joint)) or (path.dof > 0 and path.p < POOR):
        raise Inconsistent(
            f"the path of joint {joint + 1} is neither a line nor a circle ({len(out)} readings off)",
            consequence="The joint is not identified",
            cure="Two joints may have moved, or a reflection was taken for the beacon: look at its points, sweep again",
        )
    return _Found(
        path=path,
        rows=rows,
        discarded=tuple(out),
        p_line=straight.p,
        line_chi2=straight.chi2,
        decided=_decided(straight, part),
    )


def _check_moved(seen: Seen, joint: int, sigma: float | None) -> None:
    xyz = seen.sweeps.xyz_m
    spread, _ = seen.residuals(np.tile(xyz.mean(axis=0), (len(xyz), 1)), np.zeros((len(xyz), 3, 1)))
    if np.sqrt(np.mean((spread**2).sum(axis=1)) / seen.rows) < STILL:
        raise NotEnoughData(
            f"the beacon did not move beyond the noise in the sweep of joint {joint + 1}",
            consequence="Its axis cannot be found",
            cure="The joint stood still, or the beacon lies on its axis: move it further, or put the beacon elsewhere",
        )


def _decided(straight: PathFit, seen: Seen) -> bool:
    """Whether the type is beyond doubt: the line is rejected, or no arc worth the name could hide in the noise.

    The arc's angle is the bend of the path, by weighted least squares of t^2 in the directions across the line, times
    the stroke.
    """
    if straight.p < DECIDED:
        return True
    t = straight.phase - straight.phase.mean()
    xyz = seen.sweeps.xyz_m
    across = basis(straight.direction)[:, :2]
    C = seen.sweeps.covariance_m2
    variance = np.tile(seen.sigma**2 * np.eye(3), (len(t), 1, 1)) if C is None else seen.relative**2 * C
    A = np.stack([np.ones_like(t), t, t**2], axis=1)
    if len(t) < 4:
        return False
    bend, doubt = 0.0, 0.0
    for e in across.T:
        w = 1.0 / np.sqrt(np.einsum("i,mij,j->m", e, variance, e))
        H = np.linalg.inv((A * w[:, None]).T @ (A * w[:, None]))
        b = H @ (A * (w**2)[:, None]).T @ (xyz @ e - xyz.mean(axis=0) @ e)
        bend, doubt = np.hypot(bend, b[2]), np.hypot(doubt, np.sqrt(H[2, 2]))
    return bool(2.0 * (bend + 3.0 * doubt) * np.ptp(t) < HIDDEN_RAD)


def _notes(found: Sequence[_Found]) -> list[str]:
    notes = []
    for j, item in enumerate(found, 1):
        if not item.decided:
            notes.append(
                f"joint {j}: its path is straight as far as the noise tells, but an arc would look the same; taken as "
                "sliding, move it further to be sure"
            )
        if item.path.kind == "circle":
            std = item.path.fit.std().get("radius_m", np.inf)
            arc = float(np.ptp(item.path.phase))
            if std > 0.3 * item.path.radius_m:
                notes.append(
                    f"joint {j}: an arc of {np.rad2deg(arc):.0f} deg is too short for this noise: its centre is open"
                )
        notes += [f"reading {row + 1} (joint {j}) discarded: {why}" for row, why in item.discarded]
    return notes


def _measured(item: _Found, sweeps: Sweeps) -> Axis:
    point = item.path.point_m if item.path.kind == "circle" else sweeps.xyz_m[item.rows].mean(axis=0)
    return Axis(point_m=point, direction=item.path.direction, revolute=item.path.kind == "circle")


def _check_slopes(found: Sequence[_Found], sweeps: Sweeps) -> None:
    """Raise Inconsistent where the paths' lengths are not those of the commanded values: units, or not exact."""
    for j, item in enumerate(found):
        q = sweeps.q[item.rows, j]
        slope = abs(float(np.polyfit(q, item.path.phase, 1)[0]))
        if abs(slope - 1.0) < 4 * SLOPE_NEAR and slope > 0.2:
            continue
        near = min(SLOPES, key=lambda unit: abs(np.log(max(slope, 1e-9) / unit)))
        why = SLOPES[near] if abs(slope / near - 1.0) < SLOPE_NEAR and SLOPES[near] else "another unit, or not known"
        raise Inconsistent(
            f"joint {j + 1} moved {slope:.3g} times as far as its commanded values say",
            consequence="The arm is not identified",
            cure=f"Correct the values ({why}), or use only their order (--increments order)",
        )


def _whole(
    seen: Seen, found: list[_Found], base: Array, notes: list[str], name: str, sigma: float | None
) -> Identification:
    """Fit the whole arm to all readings with the joint values known."""
    sweeps = seen.sweeps
    _check_slopes(found, sweeps)
    rows = np.sort(np.concatenate([item.rows for item in found]))
    best = min(_starts(seen, found), key=lambda model: _start_cost(seen.take(rows), model))
    model, fit, rows, dropped = _fit_whole(seen, best, rows)
    scale2 = 2.0 * fit.cost / max(fit.dof, 1)
    if scale2 > SUSPECT:
        for other in _starts(seen, found):
            try:
                again = _fit_whole(seen, other, rows)
            except NotConverged:
                continue
            if again[1].cost < 0.9 * fit.cost and len(again[2]) >= len(rows):
                model, fit, rows, dropped = again
        scale2 = 2.0 * fit.cost / max(fit.dof, 1)
    if scale2 > 9.0:
        notes.append(
            f"the readings miss the arm by {np.sqrt(scale2):.1f} times their noise about single paths: the commanded "
            "values are not exact, or a joint gave way; deviations are widened accordingly"
        )
    widen = scale2 if sigma is None else max(scale2, 1.0)
    notes += [f"reading {row + 1} discarded: {why}" for row, why in dropped]
    p = fit.shared
    covariance = _covariance(fit.names, fit.covariance, widen)
    found_axes, beacon = model.axes_at(p)
    table, first, tool = place_frames(found_axes, beacon, base)

    def entries(x: Array) -> Array:
        at, there = model.axes_at(x)
        return place_frames(at, there, base)[0].ravel()

    std = carried(entries, p, covariance)
    predicted = model.predict(p, sweeps.q)[0]
    seen = seen.at(seen.sigma * float(np.sqrt(widen)))
    return _finish(seen, found, found_axes, beacon, table, std, (first, tool), predicted, notes, name, "ml", dropped)


def _starts(seen: Seen, found: Sequence[_Found]) -> list[ChainModel]:
    """Return starts of the whole arm: the paths as fitted, and each short arc's plane swung about its chord."""
    sweeps = seen.sweeps
    rests = [sweeps.q[item.rows[0], :j] for j, item in enumerate(found)]
    own = [_measured(item, sweeps) for item in found]
    rows = np.concatenate([item.rows for item in found])
    variants = [own]
    for j, item in enumerate(found):
        if item.path.kind == "circle" and np.ptp(item.path.phase) < SHORT_RAD:
            for centre, direction in swung_axes(seen.take(item.rows), sweeps.q[item.rows, j], SWINGS):
                variants.append([*own[:j], Axis(point_m=centre, direction=direction, revolute=True), *own[j + 1 :]])
    out = []
    for measured in variants:
        axes = at_zero(measured, rests)
        out.append(ChainModel(axes=tuple(axes), beacon_m=_beacon(axes, sweeps, rows)))
    return out


def _start_cost(seen: Seen, model: ChainModel) -> float:
    """Return the misfit of a start, gross readings counting little."""
    r, _ = seen.residuals(*model.predict(np.zeros(len(model.names)), seen.sweeps.q))
    size = np.nan_to_num((r**2).sum(axis=1), nan=1e30)
    return float(np.log1p(size).sum())


def _fit_whole(
    seen: Seen, model: ChainModel, rows: NDArray[np.intp]
) -> tuple[ChainModel, Fit, NDArray[np.intp], list[tuple[int, str]]]:
    """Fit the whole arm to the rows, discarding gross readings; return the rows kept and those discarded."""
    dropped: list[tuple[int, str]] = []
    robust = float(np.sqrt(chi2.ppf(0.999, seen.rows)))
    while True:
        fit = fit_chain(seen.take(rows), model, robust=robust)
        size = np.sqrt((fit.residuals.reshape(len(rows), -1) ** 2).sum(axis=1))
        scale = max(1.0, float(np.sqrt(np.median(size**2) / chi2.median(seen.rows))))
        bad = size > GROSS * scale
        if not bad.any() or len(dropped) > LOST_SHARE * len(rows):
            return model, fit, rows, dropped
        dropped += [(int(r), f"off the arm by {s:.0f} deviations") for r, s in zip(rows[bad], size[bad], strict=True)]
        rows = rows[~bad]


def _covariance(names: tuple[str, ...], covariance: object, widen: float) -> Array:
    """Return the covariance of all parameters; those the data leave open get an infinite-like variance."""
    out = np.zeros((len(names), len(names)))
    known = getattr(covariance, "names", ())
    index = [names.index(one) for one in known]
    if known:
        out[np.ix_(index, index)] = widen * covariance.matrix  # type: ignore[attr-defined]
    for i, one in enumerate(names):
        if one not in known:
            out[i, i] = 1e6
    return out


def _beacon(axes: Sequence[Axis], sweeps: Sweeps, rows: NDArray[np.intp]) -> Array:
    """Return the beacon with all joints at zero: every reading moved back, the median."""
    X = sweeps.xyz_m[rows]
    for axis, q in zip(axes, sweeps.q[rows].T, strict=True):
        X = moved_by(axis, -q, X)
    return np.asarray(np.median(X, axis=0))


def _joint_by_joint(seen: Seen, found: list[_Found], base: Array, notes: list[str], name: str) -> Identification:
    """Place the frames on the axes of the single paths; joint values count from the pose in which joints rest."""
    sweeps = seen.sweeps
    home = _home(sweeps)
    axes = [_measured(item, sweeps) for item in found]
    at = int(np.argmin(np.abs(sweeps.q - home).sum(axis=1)))
    beacon = sweeps.xyz_m[at]
    table, first, tool = place_frames(axes, beacon, base)
    sizes = [len(item.path.fit.shared) for item in found]
    p = np.concatenate([np.zeros(size) for size in sizes])
    covariance = np.zeros((len(p), len(p)))
    for item, k in zip(found, np.cumsum([0, *sizes[:-1]]), strict=True):
        own = _covariance(item.path.fit.names, item.path.fit.covariance, 1.0)
        covariance[k : k + len(own), k : k + len(own)] = own
    shifted = _shifter(found, axes, sizes)

    def entries(x: Array) -> Array:
        return place_frames(shifted(x), beacon, base)[0].ravel()

    std = carried(entries, p, covariance)
    notes = [*notes, "only the order of the commanded values was used: joint values count from the pose at rest"]
    predicted = sweeps.xyz_m.copy()
    return _finish(seen, found, axes, beacon, table, std, (first, tool), predicted, notes, name, "ml", [])


def _shifter(found: Sequence[_Found], axes: Sequence[Axis], sizes: Sequence[int]):  # type: ignore[no-untyped-def]
    """Return a function from changes of the paths' parameters to axes."""

    def shifted(x: Array) -> list[Axis]:
        out, k = [], 0
        for item, axis, size in zip(found, axes, sizes, strict=True):
            own = x[k : k + size]
            circle = item.path.kind == "circle"
            B = basis(axis.direction)
            tilt = own[3:5] if circle else own[2:4]
            direction, _ = Tilt(B=B).direction(tilt)
            point = axis.point_m + own[:3] if circle else axis.point_m
            out.append(Axis(point_m=point, direction=direction, revolute=axis.revolute))
            k += size
        return out

    return shifted


def _home(sweeps: Sweeps) -> Array:
    """Return the pose in which joints rest while others move; Inconsistent where it is not one."""
    home = np.empty(sweeps.n)
    for j in range(sweeps.n):
        held = sweeps.q[sweeps.joint != j, j] if sweeps.n > 1 else sweeps.q[:1, 0]
        if np.ptp(held) > 0.02:
            raise Inconsistent(
                f"joint {j + 1} rests at different values in the other joints' sweeps",
                consequence="Without exact values the axes cannot be brought together",
                cure="Begin every sweep from one pose, or give exact values (--increments known)",
            )
        home[j] = held[0]
    return home


def _from_paper(seen: Seen, found: list[_Found], base: Array, notes: list[str], name: str) -> Identification:
    """Place the frames on the axes of the paper's means, the joints' rests undone by the commanded values."""
    sweeps = seen.sweeps
    measured = []
    for j, item in enumerate(found):
        rows = sweeps.rows(j)
        if item.path.kind == "circle":
            centre, direction, _ = triple_circle(sweeps.xyz_m[rows], sweeps.q[rows, j])
            sense = 1.0 if direction @ item.path.direction >= 0.0 else -1.0
            measured.append(Axis(point_m=centre, direction=sense * direction, revolute=True))
        else:
            point, direction = pair_line(sweeps.xyz_m[rows], sweeps.q[rows, j])
            measured.append(Axis(point_m=point, direction=direction, revolute=False))
    axes = at_zero(measured, [sweeps.q[item.rows[0], :j] for j, item in enumerate(found)])
    beacon = _beacon(axes, sweeps, np.arange(len(sweeps)))
    table, first, tool = place_frames(axes, beacon, base)
    X = np.tile(beacon, (len(sweeps), 1))
    for axis, q in zip(axes[::-1], sweeps.q.T[::-1], strict=True):
        X = moved_by(axis, q, X)
    std = np.full(table.shape, np.nan)
    return _finish(seen, found, axes, beacon, table, std, (first, tool), X, notes, name, "paper", [])


def _finish(
    seen: Seen,
    found: Sequence[_Found],
    axes: Sequence[Axis],
    beacon: Array,
    table: Array,
    std: Array,
    ends: tuple[Array, Array],
    predicted: Array,
    notes: list[str],
    name: str,
    method: str,
    dropped: Sequence[tuple[int, str]],
) -> Identification:
    sweeps = seen.sweeps
    cases, known = say_cases(axes, table, std) if method != "paper" else ([], std)
    travel = np.array([[sweeps.q[sweeps.rows(j), j].min(), sweeps.q[sweeps.rows(j), j].max()] for j in range(sweeps.n)])
    arm = arm_of(name, axes, table, ends[0], ends[1], travel)
    pixels = None
    if seen.rig is not None:
        r, _ = seen.residuals(predicted, np.zeros((len(sweeps), 3, 1)))
        pixels = r * seen.sigma
    joints = []
    for j, item in enumerate(found):
        more = tuple((row, why) for row, why in dropped if row in item.rows)
        rows = np.setdiff1d(item.rows, [row for row, _ in more])
        off = np.linalg.norm(predicted[rows] - sweeps.xyz_m[rows], axis=1)
        joints.append(
            JointFound(
                axis=axes[j],
                measured=_measured(item, sweeps),
                radius_m=item.path.radius_m,
                p_line=item.p_line,
                decided=item.decided,
                std=dict(zip(KEYS, known[j].tolist(), strict=True)),
                travel=(float(travel[j, 0]), float(travel[j, 1])),
                rows=rows,
                discarded=(*item.discarded, *more),
                residual_rms_m=float(np.sqrt(np.mean(off**2))),
                residual_rms_px=None if pixels is None else float(np.sqrt(np.mean(pixels[rows] ** 2))),
            )
        )
    return Identification(
        arm=arm, joints=tuple(joints), method=method, notes=(*notes, *cases), sigma=seen.sigma,
        predicted_m=predicted, beacon_m=beacon,
    )  # fmt: skip
