"""Board views of some cameras, packed for the bundle adjustment, and what that is free to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.defaults import BOARD_ITERATIONS, FOLDS
from armsight.errors import Inconsistent, UsageError
from armsight.optics import SIDES, LensKind
from armsight.optics.camera import INTRINSICS_OF, names_beside
from armsight.records import BoardView, Target, require_count

SIGMA_FLOOR_PX = 0.02
"""No view is believed to be better than this: print, paper and JPEG leave more, whatever the detector's fit says."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Known:
    """What is known beforehand of shared parameters that move by addition: mean (m,), information (m, m) by name."""

    names: tuple[str, ...]
    mean: Array
    information: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observations:
    """G views of a board of n points by C cameras.

    X (n, 3) m, centred on the board's middle (`middle`, (3,) m) so that poses and shape are told apart well.
    uv (G, C, n, 2) px, zero where not seen. weight (G, C, n): 1 / sigma, 0 where not seen. sizes: (width, height) of
    each camera's images. sources: names of the images of each view. radius_m: of printed circles, 0 for points.
    one_lens: both views are of one camera (a mirror rig's) and share its intrinsics. lenses: of each camera. cameras:
    their names. t_s (G, C): each image's time by its own camera's clock, NaN where there is none; None where the board
    stood still or nothing is known of its times. known: beforehand, of the lenses. held: names of parameters that are
    held besides those that the options hold. n_front: of a board with two sides, whose points are stacked, each side's
    about its own middle (`middle` is the front's): how many are the front's; a view shows those of one side. None: one
    side. line (G, C, n): in which part of its picture, -0.5 to 0.5 from the first row to the last, each point counts as
    exposed, where cameras' read-outs are asked for.
    """

    X: Array
    middle: Array
    uv: Array
    weight: Array
    sizes: tuple[tuple[int, int], ...]
    sources: tuple[tuple[str, ...], ...]
    radius_m: float
    one_lens: bool = False
    lenses: tuple[LensKind, ...] = (LensKind.PINHOLE, LensKind.PINHOLE)
    cameras: tuple[str, ...] = SIDES
    t_s: Array | None = None
    known: Known | None = None
    held: frozenset[str] = frozenset()
    n_front: int | None = None
    line: Array | None = None

    @property
    def shows_back(self) -> NDArray[np.bool_]:
        """Whether each view (G, C) shows the back of a board with two sides."""
        return np.asarray(
            (self.weight[:, :, len(self.X) if self.n_front is None else self.n_front :] > 0.0).any(axis=2)
        )

    @property
    def chained(self) -> bool:
        """Whether views have poses of their own, which follow from the boards' by their times or by the side shown."""
        return self.t_s is not None or self.n_front is not None

    @property
    def n_views(self) -> int:
        """Number of views G."""
        return len(self.uv)

    @property
    def n_cameras(self) -> int:
        """Number of cameras C."""
        return int(self.uv.shape[1])

    @property
    def n_intrinsics(self) -> int:
        """Number of intrinsics of each camera, empty places among them."""
        return len(names_beside(self.lenses)[0])

    @property
    def has_wide(self) -> bool:
        """Whether a lens is no pinhole."""
        return any(lens is not LensKind.PINHOLE for lens in self.lenses)

    @property
    def n_points(self) -> int:
        """Points seen, over all views and cameras."""
        return int(np.count_nonzero(self.weight))

    def is_given(self, c: int) -> bool:
        """Tell whether the lens of camera c was known beforehand."""
        known = () if self.known is None else self.known.names
        return f"{self.cameras[c]}.fx" in {*known, *self.held}

    def take(self, views: Sequence[int] | NDArray[np.intp]) -> Observations:
        """Return some of the views."""
        i = np.asarray(views, dtype=np.intp)
        t_s, line = (None if one is None else one[i] for one in (self.t_s, self.line))
        sources = tuple(self.sources[k] for k in i)
        return replace(self, uv=self.uv[i], weight=self.weight[i], sources=sources, t_s=t_s, line=line)

    def camera(self, c: int) -> Observations:
        """Return what camera c alone has seen."""
        return replace(
            self,
            uv=np.ascontiguousarray(self.uv[:, c : c + 1]),
            weight=np.ascontiguousarray(self.weight[:, c : c + 1]),
            sizes=(self.sizes[c],),
            lenses=(self.lenses[c],),
            cameras=(self.cameras[c],),
            t_s=None,
            line=None,
            known=None,
            held=frozenset(),
            n_front=None,  # a single camera's view has the pose of the side that it shows
            sources=tuple((names[c],) for names in self.sources),
        )


def pack(
    views: Sequence[Sequence[BoardView | None]],
    board: Target,
    lenses: tuple[LensKind, ...] = (LensKind.PINHOLE, LensKind.PINHOLE),
    cameras: tuple[str, ...] = SIDES,
    back: Target | None = None,
) -> Observations:
    """Return the observations of C sequences of G views each (None where a camera saw nothing) of these lenses, names.

    back: the print on the board's other side; its points are numbered after the front's.

    Raises Inconsistent for images of unequal size.
    """
    n_front, G, C = len(board.names), len(views[0]), len(views)
    n = n_front + (0 if back is None else len(back.names))
    uv, weight = np.zeros((G, C, n, 2)), np.zeros((G, C, n))
    for c, camera in enumerate(views):
        _same_size([view for view in camera if view is not None])
        for g, view in enumerate(camera):
            if view is None:
                continue
            if len(view) and int(view.index.max()) >= n:
                raise Inconsistent(
                    f"{view.source}: point {int(view.index.max())} is named, but the board has {n}",
                    consequence="Nothing was calibrated",
                    cure="Give the board that the images show",
                )
            uv[g, c, view.index] = view.uv_px
            weight[g, c, view.index] = 1.0 / max(view.sigma_px, SIGMA_FLOOR_PX)
    middle = board.xyz_m.mean(axis=0)
    sides = [one.xyz_m - one.xyz_m.mean(axis=0) for one in (board, back) if one is not None]
    return Observations(
        X=np.concatenate(sides),
        middle=middle,
        uv=uv,
        weight=weight,
        sizes=tuple(next(((v.width, v.height) for v in camera if v is not None), (1, 1)) for camera in views),
        sources=tuple(tuple("" if v is None else v.source for v in moment) for moment in zip(*views, strict=True)),
        radius_m=0.5 * board.diameter_m if board.diameter_m and board.is_board else 0.0,
        lenses=tuple(lenses[:C]),
        cameras=tuple(cameras[:C]),
        n_front=None if back is None else n_front,
    )


def _same_size(views: Sequence[BoardView]) -> None:
    """Raise Inconsistent, naming the image, where the images of one camera differ in size."""
    for view in views:
        first = views[0]
        if (view.width, view.height) != (first.width, first.height):
            raise Inconsistent(
                f"{view.source} is {view.width}x{view.height} px, {first.source} is {first.width}x{first.height} px",
                consequence="Images of different sizes do not come from one calibration of a camera",
                cure="Give images of one camera at one resolution",
            )


# What a calibration from boards is free to do.


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardOptions:
    """Options of calibrate_camera and calibrate_stereo.

    fixed: intrinsics held at their start (zero for skew and distortion, the image's middle for cx and cy).
    automatic_k3: hold k3 at zero unless the data ask for it (by a score test); of a fisheye lens k3 and k4; a
    rational one has all. lens: of
    the camera, or of both. right_lens: of a pair's right camera, where it is another. reject: leave out views and
    points that do not fit the others, and say so. folds: of the left-out error (0: none; as many as views: leave one
    out). choose_lens: of each camera take the kind of lens that leaves least on images left out (lens_choice.py).
    """

    fixed: frozenset[str] = frozenset({"skew"})
    automatic_k3: bool = True
    reject: bool = True
    folds: int = FOLDS
    max_iterations: int = BOARD_ITERATIONS
    lens: LensKind = LensKind.PINHOLE
    right_lens: LensKind | None = None
    choose_lens: bool = False

    @property
    def lenses(self) -> tuple[LensKind, LensKind]:
        """The lenses of the left camera, or the only one, and of the right one."""
        return self.lens, self.right_lens or self.lens

    def of_camera(self, c: int) -> BoardOptions:
        """Return the options for camera c of a pair alone."""
        return replace(self, lens=self.lenses[c], right_lens=None)

    def __post_init__(self) -> None:
        every = [name for lens in self.lenses for name in INTRINSICS_OF[lens]]
        names = [name for name in dict.fromkeys(every) if name != "none"]
        unknown = set(self.fixed) - set(names)
        if unknown:
            raise UsageError(
                f"no intrinsic is called {', '.join(sorted(unknown))}; there are {', '.join(names)}",
                consequence="Nothing was calibrated",
            )
        require_count("folds", self.folds)
        require_count("max_iterations", self.max_iterations, least=1)
        if self.folds == 1:
            raise UsageError("1 fold leaves nothing to fit", cure="Give folds=0 for no left-out error, or 2 and more")
