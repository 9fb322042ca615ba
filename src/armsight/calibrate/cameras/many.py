"""Up to eight cameras from views of a printed board that never all of them see, each with the delay of its clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.cameras.board_shape import board_shape
from armsight.calibrate.cameras.bundle_adjustment import BACK, DELAY, READOUT, Bundle, adjust, bundle_of, names_of
from armsight.calibrate.cameras.calibrate import caveats, require_points, require_views, required
from armsight.calibrate.cameras.clocks import with_clocks
from armsight.calibrate.cameras.extended import (
    considered,
    held_beside,
    placed_beside,
    require_size_of_back,
    with_doubt_of,
    with_standing,
)
from armsight.calibrate.cameras.graph import placed, tilts_of
from armsight.calibrate.cameras.initial_guess import poses_by_rays, poses_of_lights
from armsight.calibrate.cameras.lens_choice import refuse_other_lens, start_of, with_chosen
from armsight.calibrate.cameras.observations import BoardOptions, Observations, pack
from armsight.calibrate.cameras.outlier_rejection import RobustFit, fit_tilted, fit_without_outliers, left_out
from armsight.calibrate.cameras.pairing import as_pose, camera_of, in_frame
from armsight.calibrate.cameras.preconditions import (
    LEAST_POINTS,
    LEAST_VIEWS,
    KnownLens,
    beforehand,
    check_count,
    check_spread,
    on_exact,
    require_lenses,
    require_lists,
    require_one_clock,
    require_sizes,
)
from armsight.calibrate.cameras.two_sides import TwoSided, with_the_back
from armsight.errors import Inconsistent, NotConverged, NotEnoughData
from armsight.optics import Camera, Rig
from armsight.optics.mounted import MountedCamera
from armsight.records import BoardView, NamedCovariance, Progress, Target
from armsight.records.views import symmetries


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ManySolved:
    """What the bundle of some cameras found.

    covariance: of the free numbers of the 16 C - 6 and of the delays; delays_s (C,): by how much each clock is late
    behind the first one's, 0 where held; rejected: (source, why); advice: what would make it surer; timed: whether
    delays were estimated. known: cameras whose lens was given.
    """

    robust: RobustFit
    covariance: NamedCovariance
    holdout_rms_px: float | None
    rejected: tuple[tuple[str, str], ...]
    advice: tuple[str, ...]
    known: frozenset[str] = field(default_factory=frozenset)

    @property
    def observations(self) -> Observations:
        """What went into the last fit."""
        return self.robust.observations

    @property
    def state(self) -> Bundle:
        """What it found."""
        return bundle_of(self.robust.fit, self.observations.n_cameras)

    @property
    def delays_s(self) -> Array:
        """By how much each clock is late behind the first one's (C,), 0 where held."""
        delays = self.state.delays_s
        return np.concatenate([[0.0], delays if len(delays) else np.zeros(self.observations.n_cameras - 1)])

    @property
    def readouts_s(self) -> Array:
        """How long each camera takes to read a picture (C,), 0 where held so."""
        found = self.state.readouts_s
        return found if len(found) else np.zeros(self.observations.n_cameras)

    @property
    def of_cameras(self) -> NamedCovariance:
        """The covariance of what a rig holds: of lenses and places."""
        clocks, every = (f".{DELAY}", f".{READOUT}"), self.covariance.names
        names = tuple(one for one in every if not one.endswith(clocks) and not one.startswith(BACK))
        return NamedCovariance(names=names, matrix=self.covariance.block(names))

    @property
    def cameras(self) -> dict[str, Camera]:
        """The cameras by name."""
        seen = self.observations
        each = zip(seen.cameras, self.state.k, seen.sizes, seen.lenses, strict=True)
        return {name: camera_of(k, size, lens) for name, k, size, lens in each}


def solve_cameras(
    views: Mapping[str, Sequence[BoardView | None]],
    board: Target | TwoSided,
    options: BoardOptions | None = None,
    *,
    lenses: Mapping[str, KnownLens] | None = None,
    times_s: Mapping[str, Sequence[float]] | None = None,
    rig: Rig | None = None,
    progress: Progress | None = None,
) -> ManySolved:
    """Return cameras and where they stand, from what each saw of the board at the same moments, None where nothing.

    lenses: those known beforehand, by the camera's name. times_s: of each camera's images, by its own clock: the
    board's motion then tells the delays. rig: cameras that stay as they are, the first of `views`.

    Raises NotEnoughData (too few views, cameras that no moment connects),
    Inconsistent (lists out of step, mirrored images, a lens of another camera), Degenerate, Undetermined, NotConverged.
    """
    options, lenses = options or BoardOptions(), dict(lenses or {})
    exact = ", ".join(name for name, lens in lenses.items() if lens.covariance is None)
    if rig is not None:
        lenses |= {name: KnownLens(camera=rig.camera(name)) for name in views if name in rig.names}
    observations, rejected = moments_of(views, board, options, lenses, times_s)
    observations, on_lens = with_chosen(observations, options, lenses)
    poses, k, advice = each_alone(observations, options, lenses)
    poses, back = with_the_back(observations, poses)
    turns = symmetries(board) if isinstance(board, Target) else (np.arange(len(observations.X)),)
    observations, start, dropped = placed(observations, poses, k, turns)
    start = replace(start, back=back)
    rejected += dropped
    if rig is not None:
        held = observations.held | (held_beside(rig) & set(names_of(observations)))
        observations, start = replace(observations, held=held), with_standing(observations.cameras, start, rig)
    given = {} if rig is None else {one.name: one.timing.readout_s for one in rig.cameras if one.timing is not None}
    robust, told, lost = _fitted(observations, start, options, given, progress)
    require_lenses(robust, observations.known, lenses)
    require_size_of_back(robust)
    out = left_out(robust, options)
    covariance, more = _doubts(robust, board if isinstance(board, Target) else board.front, rig)
    return ManySolved(
        robust=robust,
        covariance=covariance,
        holdout_rms_px=None if out is None else out.rms_px,
        rejected=(*rejected, *lost, *robust.rejected),
        advice=(*on_lens, *advice, *more, *told, *caveats(covariance, robust), *robust.notes, *on_exact(exact)),
        known=frozenset(lenses),
    )


def _doubts(robust: RobustFit, front: Target, rig: Rig | None) -> tuple[NamedCovariance, Sequence[str]]:
    """Return the covariance with what the standing rig and the board's or target's own shape leave open, and advice."""
    covariance = required(robust) if rig is None else considered(robust, rig)
    covariance = with_doubt_of(front.covariance, robust, covariance)
    # a print's error of shape is told from moments that hang together by the board alone
    if robust.observations.chained or rig is not None or not front.is_board:
        return covariance, ()
    shape = board_shape(robust.observations, robust.fit, covariance)
    return shape.covariance, shape.advice


def _fitted(
    observations: Observations,
    start: Bundle,
    options: BoardOptions,
    given: Mapping[str, float],
    progress: Progress | None,
) -> tuple[RobustFit, list[str], list[tuple[str, str]]]:
    """Return the fit of what agrees, advice on the clocks, and (source, why) of moments that went for them."""
    times, known, held = observations.t_s, observations.known, observations.held
    lens = frozenset[str]() if known is None else frozenset(known.names) - held
    observations = replace(observations, t_s=None, known=None, held=held | lens)
    observations, start, told, lost = with_clocks(observations, start, options, times, given, progress)
    if known is not None:
        # what is known beforehand counts in units of the points' noise, which is asked with the lenses as given
        weight = observations.weight / fit_without_outliers(observations, start, options, progress).fit.scale
        observations = replace(observations, held=observations.held - lens, known=known, weight=weight)
    return fit_without_outliers(observations, start, options, progress), told, lost


def extend_rig(
    rig: Rig,
    name: str,
    views: Mapping[str, Sequence[BoardView | None]],
    board: Target | TwoSided,
    options: BoardOptions | None = None,
    *,
    lens: KnownLens | None = None,
    times_s: Mapping[str, Sequence[float]] | None = None,
    progress: Progress | None = None,
) -> tuple[ManySolved, Rig]:
    """Return what was found of one more camera, or of one of the rig's anew, and the rig with it.

    The rig's axes and its other cameras stay as they are. views: of the camera and of some or all of the rig's. lens:
    its own, known before; of a camera of the rig the one that it has. Raises as solve_cameras, and Inconsistent where
    the rig's cameras do not stand as the rig says.
    """
    others = [one for one in rig.names if one != name]
    seen = [g for g, one in enumerate(views[name]) if one is not None]
    olds = [old for old in others if old in views and any(views[old][g] is not None for g in seen)]
    if not olds:
        raise NotEnoughData(
            f"no moment shows the board to {name} and to another camera of the rig",
            consequence=f"Where {name} stands is open, and nothing was calibrated",
            cure=f"Take pictures in which {name} and one of {', '.join(others)} see the board at one moment",
        )
    # the fit's frame is that of a camera which stays and sees something
    first = rig.T_rig_camera(olds[0])
    standing = in_frame(rig.only(olds[0], *(one for one in others if one != olds[0])), first.inv())
    # moments without the new camera say nothing of it, since the others are held
    used = {one: [views[one][g] for g in seen] for one in (*olds, name)}
    times = None if times_s is None else {one: [times_s[one][g] for g in seen] for one in used}
    own = next((one for one in rig.cameras if one.name == name), None)
    if lens is None and own is not None:
        lens = KnownLens(camera=own.camera, covariance=_lens_doubt(rig, name))
    lenses = {} if lens is None else {name: lens}
    done = solve_cameras(used, board, options, lenses=lenses, times_s=times, rig=standing, progress=progress)
    T = as_pose(done.state.sides[-1])
    new = MountedCamera(name=name, camera=done.cameras[name], T_rig_camera=T)
    if own is not None:
        new = replace(own, camera=new.camera, T_rig_camera=T)
    return done, placed_beside(rig, standing, new, done.of_cameras)


def _lens_doubt(rig: Rig, name: str) -> NamedCovariance | None:
    """Return the covariance of the lens of one of a rig's cameras; None where nothing is known of it."""
    known = () if rig.covariance is None else rig.covariance.names
    lens = tuple(one for one in rig.camera(name).names if f"{name}.{one}" in known)
    if rig.covariance is None or not lens:
        return None
    return NamedCovariance(names=lens, matrix=rig.covariance.block(tuple(f"{name}.{one}" for one in lens)))


def moments_of(
    views: Mapping[str, Sequence[BoardView | None]],
    board: Target | TwoSided,
    options: BoardOptions,
    lenses: Mapping[str, KnownLens],
    times_s: Mapping[str, Sequence[float]] | None,
) -> tuple[Observations, list[tuple[str, str]]]:
    """Return what the cameras saw at each moment, and (source, why) of views with too little of the board."""
    names = tuple(views)
    require_lists(views, lenses, times_s)
    front, back = (board, None) if isinstance(board, Target) else board
    if front.is_board:
        require_views([one for each in views.values() for one in each if one is not None], front)
    kinds = tuple(lenses[name].camera.lens if name in lenses else options.lens for name in names)
    for kind in set(kinds):
        require_points(front, kind)
    observations = pack(list(views.values()), front, kinds, names, back)
    require_sizes(observations, lenses)
    count = (observations.weight > 0.0).sum(axis=2)
    few = (count > 0) & (count < LEAST_POINTS)
    rejected = [
        (observations.sources[g][c], f"only {count[g, c]} points of the board are seen, {LEAST_POINTS} are needed")
        for g, c in zip(*np.nonzero(few), strict=True)
    ]
    observations = replace(observations, weight=observations.weight * ~few[:, :, None])
    if times_s is not None:
        t_s = np.array([times_s[name] for name in names], float).T
        seen = count >= LEAST_POINTS
        if np.isfinite(t_s[seen]).all():
            require_one_clock(t_s, seen, names)
            observations = replace(observations, t_s=t_s)
    kept = np.flatnonzero((count >= LEAST_POINTS).any(axis=1))
    if len(kept) < LEAST_VIEWS:
        raise NotEnoughData(
            f"{len(kept)} moments show enough of the board, {LEAST_VIEWS} are needed",
            consequence="Nothing was calibrated",
            cure="Take ten to sixty, the board turned to all cameras",
        )
    held, known = beforehand(lenses)
    return replace(observations.take(kept), held=held, known=known), rejected


def each_alone(
    observations: Observations, options: BoardOptions, lenses: Mapping[str, KnownLens]
) -> tuple[Array, Array, list[str]]:
    """Return T_camera_board (G, C, 2, 6) by the two tilts of each view, the likelier first, the lenses k (C, n), and
    advice."""
    G, C = observations.n_views, observations.n_cameras
    flat = not observations.X[:, 2].any()
    poses, k, advice = np.full((G, C, 2, 6), np.nan), np.zeros((C, observations.n_intrinsics)), []
    for c, name in enumerate(observations.cameras):
        g = np.flatnonzero((observations.weight[:, c] > 0.0).any(axis=1))
        if name in lenses:
            own = lenses[name].camera.intrinsics
            k[c, : len(own)] = own
        if not len(g):
            continue
        part, of = observations.camera(c).take(g), f"the camera {name}"
        if name in lenses:
            camera = lenses[name].camera
            found = poses_by_rays(part, camera) if flat else poses_of_lights(part, camera)
            if found is None:
                raise Inconsistent(
                    f"points of the board in the images of {name} lie where the lens given for it sees nothing",
                    consequence="The lens is another camera's, and nothing was calibrated",
                    cure=f"Check which camera.yaml is that of {name}",
                )
        else:
            single = replace(options, lens=observations.lenses[c], right_lens=None)
            advice += check_count(len(g)) + check_spread(part, 0, of)
            robust, on_tilt = fit_tilted(part, start_of(part), single, of)
            advice += on_tilt + refuse_other_lens(part, robust, single, 0, of)
            own = bundle_of(robust.fit, 1).k[0]
            k[c, : len(own)] = own
            found = poses_by_rays(part, camera_of(own, part.sizes[0], part.lenses[0]))
            if found is None:
                found = start_of(part).poses
        poses[g, c] = _two_tilts(part, k[c, : part.n_intrinsics], found, options)
    return poses, k, advice


def _thinnest(X: Array) -> Array:
    """Return the direction (3,) along which points (n, 3) reach least: a board's normal."""
    return np.array([0.0, 0.0, 1.0]) if not X[:, 2].any() else np.asarray(np.linalg.svd(X - X.mean(axis=0))[2][2])


def _two_tilts(part: Observations, k: Array, poses: Array, options: BoardOptions) -> Array:
    """Return T_camera_board (G, 2, 6) by the two tilts that fit each view, the better one first."""
    everything, found = frozenset(names_of(part)), []
    for start in (poses, tilts_of(poses, _thinnest(part.X))):
        try:
            fit = adjust(part, Bundle(k=k[None], poses=start), everything, max_iterations=options.max_iterations)
        except NotConverged:
            found.append((start, np.full(len(poses), np.inf)))
        else:
            found.append((fit.local, (fit.residuals**2).sum(axis=1)))
    both = np.stack([one for one, _ in found], axis=1)
    order = np.argsort(np.stack([cost for _, cost in found], axis=1), axis=1, kind="stable")
    return np.asarray(np.take_along_axis(both, order[:, :, None], axis=1))
