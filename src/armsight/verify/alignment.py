"""Base and tool laid where they fit best, robustly; what the measurements leave open; gross rows by name."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.calibrate.arm.fit import ENOUGH, is_tool_turn, mounts_by_turns, placed
from armsight.errors import DataRefused, Degenerate, Inconsistent, NotConverged, NotEnoughData
from armsight.fitting.quantiles import MEDIAN_3
from armsight.units import DEG, MM
from armsight.verify.model import Model, ModelFit, Mounts, fit_model, mount_names, nothing_more
from armsight.verify.records import Measured, Rejected

GROSS = 8.0
"""Errors beyond so many robust standard deviations are gross: a wrong zero's errors reach 4 of theirs, a normal
distribution's 8 never."""
GAP = 1.5
"""... and so many times as far as the next one before."""
GROSS_LEAST_M, GROSS_LEAST_RAD = 1e-4, 1e-3
"""Smaller errors are no gross ones, however well all others fit."""
MOST_GROSS = 0.4
"""Share of gross rows beyond which nobody can say which ones are wrong."""
FOREIGN = "misses what the other rows agree on"
"""How the reason of a gross row begins."""
TRIMMED, TRIM_ROUNDS = 0.6, 6
"""Share of the rows, the best ones, that the search for gross rows fits; how often it chooses anew."""
TRIM_SETTLED = 1e-3
"""Share of the median error by which no row's error changes any more where choosing anew has come to its end."""
DRAWS, DRAWN, DRAW_SEED = 40, 5, 3
"""Draws of so many rows from which that search begins as well: at 30 % wrong rows one of six has none."""
SENSELESS = 0.1
"""Errors of a larger share of how far the tool moved are not of this arm: 2 degrees of all zeros give 0.02 to 0.04."""
MIRRORED = 0.3
"""A reflection that leaves less than this share of the error is what happened."""
TOOL_M, TOOL_SHARE = 5e-3, 0.3
"""How far a tool that was not laid is off at least where it is named, since lengths within what arms are made to may be
taken up by a tool a millimetre or two off; and the share of the errors that it leaves then."""
STARTS_M = 0.25
"""Positions of an unknown tool that are tried, to either side of the flange."""


class Align(StrEnum):
    """What is laid where it fits best."""

    NONE = "none"
    BASE = "base"
    TOOL = "tool"
    BOTH = "both"

    @property
    def parts(self) -> tuple[str, ...]:
        """base, tool, both or none of them."""
        return {"none": (), "base": ("base",), "tool": ("tool",), "both": ("base", "tool")}[self.value]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Aligned:
    """The fit of base and tool to the rows kept; rejected: gross rows and why, by the file's row; kept (k,): the
    positions of the others."""

    fitted: ModelFit
    kept: NDArray[np.intp]
    rejected: Rejected
    free: tuple[str, ...]


def free_names(measured: Measured, align: Align) -> tuple[str, ...]:
    """Return the names of the parameters of base and tool that are fitted; of positions no tool's rotation."""
    turned = measured.rotation is not None
    return tuple(
        name
        for name in mount_names(measured.labels)
        if name.split(":")[0].split(".")[0] in align.parts and (turned or not is_tool_turn(name))
    )


def align(F: Array, measured: Measured, nominal: Mounts, how: Align) -> Aligned:
    """Return base and tool fitted to the rows that agree.

    F (m, 4, 4): base to flange. Raises Inconsistent for left-handed positions, for those of another arm, and where no
    majority agrees; NotEnoughData for too few rows; Degenerate.
    """
    _check_count(measured, how)
    guess, kept = _start(F, measured, nominal, how)
    free = free_names(measured, how)
    try:
        fitted = fit_model(Model(measured=measured.take(kept), expected=nothing_more(F[kept])), guess, free)
    except NotConverged:  # of what is not of this arm
        start = Mounts.of(guess, len(measured.labels))
        _check_misfit(_sizes(F, measured, start)[kept], measured.take(kept))
        raise
    for _ in range(TRIM_ROUNDS):
        model = Model(measured=measured, expected=nothing_more(F))
        residual, _ = model.linearised(fitted.p)
        again = np.flatnonzero(~gross(residual, fitted.residual))
        if np.array_equal(again, kept):
            break
        kept = again
        _check_majority(kept, measured, residual)
        fitted = fit_model(Model(measured=measured.take(kept), expected=nothing_more(F[kept])), fitted.p, free)
    if how is not Align.NONE:
        _check_sense(F, measured, kept, nominal, fitted, how)
    return _aligned(F, measured, fitted, kept, free)


def realign(F: Array, measured: Measured, before: Aligned, kept: NDArray[np.intp]) -> Aligned:
    """Return base and tool fitted to these rows (k,)."""
    model = Model(measured=measured.take(kept), expected=nothing_more(F[kept]))
    return _aligned(F, measured, fit_model(model, before.fitted.p, before.free), kept, before.free)


def _aligned(F: Array, measured: Measured, fitted: ModelFit, kept: NDArray[np.intp], free: tuple[str, ...]) -> Aligned:
    residual, _ = Model(measured=measured, expected=nothing_more(F)).linearised(fitted.p)
    out = np.setdiff1d(np.arange(len(measured)), kept)
    rejected = tuple((int(measured.rows[i]), _why(residual[i])) for i in out)
    return Aligned(fitted=fitted, kept=kept, rejected=rejected, free=free)


def gross(residual: Array, typical: Array) -> NDArray[np.bool_]:
    """Return which residuals (m, rows) are gross beside typical ones (k, rows): far out, and apart from all others.

    A wrong zero or geometry has tails too; theirs have no gap.
    """
    out = np.zeros(len(residual), bool)
    for k, least in zip(range(residual.shape[1] // 3), (GROSS_LEAST_M, GROSS_LEAST_RAD), strict=False):
        part = slice(3 * k, 3 * k + 3)
        sigma = np.sqrt(np.median((typical[:, part] ** 2).sum(axis=1)) / MEDIAN_3)
        size = np.linalg.norm(residual[:, part], axis=1)
        order = np.argsort(size)
        grown = size[order]
        apart = (grown[1:] > max(GROSS * sigma, least)) & (grown[1:] > GAP * grown[:-1])
        if apart.any():
            out[order[int(np.argmax(apart)) + 1 :]] = True
    return out


def _why(residual: Array) -> str:
    rotated = f" and {np.linalg.norm(residual[3:]) / DEG:.3g} deg" if len(residual) == 6 else ""
    return f"{FOREIGN} by {np.linalg.norm(residual[:3]) / MM:.3g} mm{rotated}"


def _check_count(measured: Measured, how: Align) -> None:
    wanted = 4 + 2 * len(how.parts)
    if len(measured) < wanted:
        raise NotEnoughData(
            f"{len(measured)} rows are left to compare; {wanted} is the least",
            consequence="Nothing is verified",
            cure="Measure more poses; see the rows rejected for what was left out",
        )


def _check_majority(kept: NDArray[np.intp], measured: Measured, residual: Array) -> None:
    if len(kept) < (1.0 - MOST_GROSS) * len(measured):
        size = np.linalg.norm(residual[:, :3], axis=1)
        raise Inconsistent(
            f"{len(measured) - len(kept)} of {len(measured)} rows miss what the others agree on, by "
            f"{np.median(np.delete(size, kept)) / MM:.3g} mm in the middle",
            consequence="Which ones are right cannot be told; nothing is verified",
            cure="Look for readings and measurements out of step, for another arm's rows, or for a base that was moved",
        )


def _start(F: Array, measured: Measured, nominal: Mounts, how: Align) -> tuple[Array, NDArray[np.intp]]:
    """Return base and tool to begin with, and the rows that they fit: the best of a start from all rows and of starts
    from a few drawn ones, each trimmed; least median error counts."""
    every = np.arange(len(measured))
    if how is Align.NONE:
        return nominal.vector, every
    rng = np.random.default_rng(DRAW_SEED)
    rows = every if len(every) <= ENOUGH else np.unique(np.linspace(0, len(every) - 1, ENOUGH).astype(np.intp))
    best, least = closed_form(F[rows], measured.take(rows), nominal, how), np.inf
    best, least, share = _trimmed(F[rows], measured.take(rows), best, how)
    if share > 3.0:  # some rows miss by far: look for a start that they have no part in
        for _ in range(DRAWS):
            drawn = rng.choice(rows, min(DRAWN + 2 * len(measured.labels), len(rows)), replace=False)
            try:
                found = closed_form(F[drawn], measured.take(drawn), nominal, how)
            except Degenerate:
                continue
            found, miss, _ = _trimmed(F[rows], measured.take(rows), found, how)
            best, least = (found, miss) if miss < least else (best, least)
    residual, _ = Model(measured=measured, expected=nothing_more(F)).linearised(best.vector)
    kept = np.flatnonzero(~gross(residual, residual))
    return best.vector, kept if len(kept) >= (1.0 - MOST_GROSS) * len(every) else every


def _trimmed(F: Array, measured: Measured, mounts: Mounts, how: Align) -> tuple[Mounts, float, float]:
    """Return the mounts fitted to the best rows, their median error in m, and how far the worst tenth lies from it."""
    if set(measured.labels) == set() or len(mounts.tools) != len(measured.labels):
        return mounts, np.inf, 0.0
    before = np.full(len(measured), np.inf)
    for _ in range(TRIM_ROUNDS):
        size = _sizes(F, measured, mounts)
        if np.abs(size - before).max() < TRIM_SETTLED * np.median(size):
            break
        before = size
        chosen = np.sort(np.argsort(size)[: max(round(TRIMMED * len(size)), 4)])
        part = measured.take(chosen)
        if part.labels != measured.labels:
            break
        try:
            mounts = closed_form(F[chosen], part, mounts, how, near=True)
        except Degenerate:
            break
    size = _sizes(F, measured, mounts)
    middle = float(np.median(size))
    return mounts, middle, float(np.quantile(size, 0.97) / max(middle, 1e-12))


def _sizes(F: Array, measured: Measured, mounts: Mounts) -> Array:
    """Return by how much each position is missed (m,), in m."""
    at = np.array([T.translation for T in mounts.tools])[measured.which]
    local = np.einsum("mij,mj->mi", F[:, :3, :3], at) + F[:, :3, 3]
    return np.asarray(np.linalg.norm(measured.xyz_m - mounts.base.apply(local), axis=1))


def closed_form(F: Array, measured: Measured, nominal: Mounts, how: Align, *, near: bool = False) -> Mounts:
    """Return base and tools in closed form, what is not free as nominal. near: the tool is sought there only."""
    which = measured.which
    at = np.array([T.translation for T in nominal.tools])
    if len(at) != len(measured.labels):  # a draw that does not see every point of the tool
        raise Degenerate("not every point of the tool is there")
    base = nominal.base
    if how is Align.BOTH:
        beside = [] if near else [np.tile(v, (len(at), 1)) for v in STARTS_M * np.vstack([np.eye(3), -np.eye(3)])]
        firsts = [at, *beside] if near else [at, 0.0 * at, *beside]
        base, at = mounts_by_turns(F, measured.xyz_m, which, firsts)
    elif how is Align.BASE:
        base = placed(measured.xyz_m, np.einsum("mij,mj->mi", F[:, :3, :3], at[which]) + F[:, :3, 3])
    R_base, t = base.rotation.as_matrix(), base.translation
    if how is Align.TOOL:
        local = np.einsum("mji,mj->mi", R_base @ F[:, :3, :3], measured.xyz_m - (F[:, :3, 3] @ R_base.T + t))
        at = np.stack([np.median(local[which == k], axis=0) for k in range(len(at))])
    turns = [T.rotation for T in nominal.tools]
    if measured.rotation is not None and "tool" in how.parts:
        local_turn = np.swapaxes(R_base @ F[:, :3, :3], 1, 2) @ measured.rotation
        turns = [_middle(local_turn[which == k]) for k in range(len(at))]
    return Mounts(base=base, tools=tuple(RigidTransform.from_components(x, R) for x, R in zip(at, turns, strict=True)))


def _middle(R: Array) -> Rotation:
    """Return the middle of rotations (k, 3, 3), which a few wrong ones hardly move."""
    turns = Rotation.from_matrix(R)
    mean = turns.mean()
    for _ in range(3):
        size = (turns * mean.inv()).magnitude()
        near = np.flatnonzero(size <= 2.0 * max(float(np.median(size)), 1e-12))
        mean = turns[near].mean()
    return mean


def _check_sense(
    F: Array, measured: Measured, kept: NDArray[np.intp], nominal: Mounts, fitted: ModelFit, how: Align
) -> None:
    """Raise Inconsistent where the best fit misses by much of what the tool moved: mirrored, inverted, foreign."""
    part, G = measured.take(kept), F[kept]
    position = np.linalg.norm(fitted.residual[:, :3], axis=1)
    error = float(np.quantile(position, 0.5))
    if error > 0.01 * _spread_m(part):
        _check_mirrored(G, part, nominal, error, how)
    _check_misfit(position, part)
    if part.rotation is not None:
        _check_turns(G, part, fitted)


def _spread_m(measured: Measured) -> float:
    return float(np.median(np.linalg.norm(measured.xyz_m - np.median(measured.xyz_m, axis=0), axis=1)))


def _check_misfit(position: Array, measured: Measured) -> None:
    """Raise Inconsistent where half of the errors (m,) are a large share of how far the tool moved."""
    error, spread = float(np.quantile(position, 0.5)), _spread_m(measured)
    if error > SENSELESS * spread:
        raise Inconsistent(
            f"the best fit misses half of the positions by {error / MM:.3g} mm or more, and the tool moved by "
            f"{spread / MM:.3g} mm",
            consequence="The measurements are not of this arm at these readings; nothing is verified",
            cure="Give the file of this arm, and `--align both` where base or tool are not known; look for readings "
            "and positions out of step, another unit of the joints, another arm's rows",
        )


def _check_mirrored(F: Array, measured: Measured, nominal: Mounts, error: float, how: Align) -> None:
    flipped = Measured(xyz_m=measured.xyz_m * [1.0, 1.0, -1.0], point=measured.point)
    again = Align.BOTH if how is Align.BOTH else Align.BASE
    try:
        other = float(np.median(_sizes(F, flipped, closed_form(F, flipped, nominal, again))))
    except Degenerate:
        return
    if other < MIRRORED * error:
        raise left_handed(f"they miss the arm's by {error / MM:.3g} mm, and by {other / MM:.3g} mm when mirrored")


def left_handed(what: str) -> Inconsistent:
    """Return the refusal of mirrored positions; told: by what they are known, in words."""
    return Inconsistent(
        f"the positions are left-handed: {what}",
        consequence="No turn lays a mirrored path on the arm's; nothing is verified",
        cure="Change the sign of one axis in the export (and the rotations with it), or swap two axes",
    )


def _check_turns(F: Array, measured: Measured, fitted: ModelFit) -> None:
    """Raise Inconsistent for rotations that fit only when they are read the other way about."""
    size = float(np.median(np.linalg.norm(fitted.residual[:, 3:], axis=1)))
    if size < 10.0 * DEG or measured.rotation is None:
        return
    R_flange = fitted.mounts(measured.labels).base.rotation.as_matrix() @ F[:, :3, :3]
    quat = Rotation.from_matrix(measured.rotation).as_quat()
    ways = {
        "inverted (frame in target, not target in frame)": np.swapaxes(measured.rotation, 1, 2),
        "quaternions with the scalar first": Rotation.from_quat(quat[:, [1, 2, 3, 0]]).as_matrix(),
    }
    found = {}
    for way, R in ways.items():
        local = np.swapaxes(R_flange, 1, 2) @ R
        off = (Rotation.from_matrix(local) * _middle(local).inv()).magnitude()
        found[way] = float(np.median(off))
    way = min(found, key=lambda key: found[key])
    rival = f"; they fit to {found[way] / DEG:.3g} deg as {way}" if found[way] < MIRRORED * size else ""
    raise Inconsistent(
        f"the rotations miss the arm's by {size / DEG:.3g} deg though the positions fit{rival}",
        consequence="Nothing is verified",
        cure="Check the order of the quaternion's columns and which frame they turn; leave them out to compare places",
    )


def check_tool(F: Array, measured: Measured, nominal: Mounts, how: Align, left: ModelFit) -> None:
    """Raise Inconsistent where the tool was not laid and explains the errors that are left of rows."""
    left_m = _rms_m(left)
    if "tool" in how.parts or left_m < TOOL_SHARE * TOOL_M:
        return
    try:
        free = align(F, measured, nominal, Align.TOOL if how is Align.NONE else Align.BOTH).fitted
    except DataRefused:
        return
    tools = zip(nominal.tools, free.mounts(measured.labels).tools, strict=True)
    off_m = max(float(np.linalg.norm((was.inv() * found).translation)) for was, found in tools)
    if off_m > TOOL_M and _rms_m(free) < TOOL_SHARE * left_m:
        raise Inconsistent(
            f"the tool is {off_m / MM:.3g} mm from where the arm's file has it: the errors are {left_m / MM:.3g} mm "
            f"(RMS), and {_rms_m(free) / MM:.3g} mm with the tool laid where it fits best",
            consequence="They would be laid to the arm; nothing is verified",
            cure="Give --align both, or the arm with its tool in its file",
        )


def _rms_m(fitted: ModelFit) -> float:
    return float(np.sqrt((fitted.residual[:, :3] ** 2).sum(axis=1).mean()))


def undetermined(aligned: Aligned, measured: Measured, how: Align) -> tuple[str, ...]:
    """Return the parameters of base and tool asked for that the rows leave open."""
    open_ = [name for group in aligned.fitted.fit.undetermined for name in group]
    asked = [name for name in mount_names(measured.labels) if name.split(":")[0].split(".")[0] in how.parts]
    return tuple(dict.fromkeys(name for name in asked if name in open_ or name not in aligned.free))
