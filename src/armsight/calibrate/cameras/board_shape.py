"""How far the points of a board are off, or whether it is another board than it is said to be.

Print and flatness are the same in every view: more views do not average them away, and residuals taken as independent
noise make a calibration surer than it is. The points' errors u (3 n numbers) are a Gaussian process over the board with
one variance and one length, both by restricted likelihood (Harville 1977) beside the detector's noise; what the fit,
which takes the board as exact, has made of them is T u with T from the normal equations, and T cov(u) T' joins the
covariance. A board that was printed stretched, or whose gaps are others, bends the lens to fit it: it is asked before
the lens is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy  # loads its optimize where it is used
from numpy.typing import NDArray
from scipy.special import chdtri

from armsight.arrays import Array
from armsight.calibrate.cameras.bundle_adjustment import BoardEquations, bundle_of, problem_of
from armsight.calibrate.cameras.lens_choice import KEPT, lens_alone
from armsight.calibrate.cameras.observations import BoardOptions, Observations
from armsight.calibrate.cameras.outlier_rejection import RobustFit
from armsight.errors import Inconsistent
from armsight.fitting import Fit
from armsight.optics import LensKind
from armsight.records import NamedCovariance, Target, TargetKind
from armsight.units import MM

LENGTHS = (0.0, 0.15, 1.0)
"""Shares of the board's diagonal over which its errors go together: a printer's jitter, waves of paper, a bend."""
RATIOS = np.geomspace(1e-4, 1e6, 81)
"""Variance of the points as the views see it, over the detector's: all that is looked through."""
BY_CHANCE = 1e-3
"""The board is taken as it is said to be where noise looks as much unlike it this often."""
STEP_M = 1e-6
"""Step of the differences by the points' positions: a thousandth of a pixel."""
CLEAR = 1e-9
"""Information of a direction, over the largest, below which it is none: where the board stands, and its size."""
TOLD = 0.25
"""Share of the residuals' variance that the board must make for it to be told."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardShape:
    """How far a printed board is off, and how sure the cameras are with that in it.

    covariance: of the free parameters, with the board's share. std_m: of each coordinate of its points, 0 where none
    shows. noise_px: RMS 2-D residual that the detector leaves, beside rms_px with the board in it. gain: by how much
    twice the log likelihood of the residuals is larger with it.
    """

    covariance: NamedCovariance
    std_m: float = 0.0
    noise_px: float = 0.0
    rms_px: float = 0.0
    gain: float = 0.0

    @property
    def advice(self) -> list[str]:
        """What to do about the board, where it makes much of the residuals."""
        if self.noise_px**2 >= (1.0 - TOLD) * self.rms_px**2:
            return []
        return [
            f"the board's points are off by {1e3 * self.std_m:.2g} mm (print, flatness): {self.rms_px:.2g} px of "
            f"residual, of which the detector makes {self.noise_px:.2g}. The deviations allow for it; glue the board "
            "on a flat plate, or have it made on one"
        ]


def board_shape(observations: Observations, fit: Fit, covariance: NamedCovariance) -> BoardShape:
    """Return what the residuals say of the board; covariance: of the fit, its board taken as exact."""
    n, names = len(observations.X), covariance.names
    fixed = frozenset(fit.names) - frozenset(names)
    problem = problem_of(observations, bundle_of(fit, observations.n_cameras), fixed)
    free = np.array([fit.names.index(name) for name in names], dtype=np.intp)
    normal = problem.normal_equations(problem.evaluate(fit.shared, fit.local), fit.shared, free)
    S, Ci = normal.reduced_system(), np.linalg.inv(normal.C)
    shared, local, own, score = _slopes(observations, fit, free)
    reduced = shared - np.einsum("gfl,glk,pgk->pf", normal.W, Ci, local)  # (3 n, F)
    T = -np.linalg.solve(S, reduced.T)  # (F, 3 n)
    N = own + reduced @ T - np.einsum("pgl,glk,qgk->pq", local, Ci, local)  # (3 n, 3 n)
    best, likelihood = (0.0, 0.0, np.zeros((3 * n, 3 * n))), 0.0
    plain = _profile(fit, np.zeros(0), np.zeros(0), 0.0)[0]
    for length in LENGTHS:
        K = _kernel(observations.X, length)
        root = np.linalg.cholesky(K + 1e-9 * np.eye(len(K)))
        values, vectors = np.linalg.eigh(root.T @ N @ root)
        clear = values > CLEAR * values[-1]
        z2 = (vectors[:, clear].T @ (root.T @ score)) ** 2 / values[clear]
        each = [(*_profile(fit, values[clear], z2, ratio / values[-1]), ratio / values[-1]) for ratio in RATIOS]
        found, noise2, ratio = max(each)
        if found - plain > likelihood:
            likelihood, best = found - plain, (noise2, ratio, K)
    if 2.0 * likelihood < chdtri(1.0, BY_CHANCE):
        return BoardShape(covariance=covariance)
    noise2, ratio, K = best
    matrix = noise2 / fit.scale**2 * covariance.matrix + noise2 * ratio * T @ K @ T.T
    residual, seen = fit.residuals, observations.weight > 0.0
    G, C, _ = observations.weight.shape
    px2 = (residual.reshape(G, C, n, 2)[seen] ** 2).sum(axis=1) / observations.weight[seen] ** 2
    return BoardShape(
        covariance=NamedCovariance(names=names, matrix=0.5 * (matrix + matrix.T)),
        std_m=float(np.sqrt(noise2 * ratio)),
        noise_px=float(np.sqrt(2.0 * noise2 / np.mean(observations.weight[seen] ** 2))),
        rms_px=float(np.sqrt(px2.mean())),
        gain=2.0 * likelihood,
    )


def _slopes(observations: Observations, fit: Fit, free: NDArray[np.intp]) -> tuple[Array, Array, Array, Array]:
    """Return how gradients follow each coordinate of the points: shared (3 n, F), local (3 n, G, L).

    And the points' own normal equations (3 n, 3 n) and (3 n,).
    """
    n, (G, L) = len(observations.X), fit.local.shape
    shared, local = np.empty((3 * n, len(free))), np.empty((3 * n, G, L))
    own, score = np.zeros((3 * n, 3 * n)), np.empty(3 * n)
    for i in range(n):
        one = replace(
            observations,
            X=observations.X[[i]],
            uv=np.ascontiguousarray(observations.uv[:, :, [i]]),
            weight=np.ascontiguousarray(observations.weight[:, :, [i]]),
        )
        at = [
            BoardEquations(replace(one, X=one.X + step)).evaluate(fit.shared, fit.local)
            for step in (np.zeros(3), *(STEP_M * np.eye(3)))
        ]
        here, *moved = [e.condensed for e in at if e.condensed is not None]
        J = np.stack([(e.residuals - at[0].residuals).ravel() / STEP_M for e in at[1:]])  # (3, R)
        part = slice(3 * i, 3 * i + 3)
        own[part, part], score[part] = J @ J.T, J @ at[0].residuals.ravel()
        for a, e in enumerate(moved):
            shared[3 * i + a] = (e.b - here.b)[free] / STEP_M
            local[3 * i + a] = (e.c - here.c) / STEP_M
    return shared, local, own, score


def _kernel(X: Array, length: float) -> Array:
    """Return the points' correlations (3 n, 3 n): alike along each axis, none between axes."""
    if length == 0.0:
        return np.eye(3 * len(X))
    reach = length * float(np.linalg.norm(np.ptp(X, axis=0)))
    apart = np.linalg.norm(X[:, None] - X[None], axis=2)
    return np.kron(np.exp(-apart / reach), np.eye(3))


def _profile(fit: Fit, values: Array, z2: Array, ratio: float) -> tuple[float, float]:
    """Return log likelihood and the noise's variance that it is largest at, for a ratio of the points' to it."""
    grown = 1.0 + values * ratio
    noise2 = (2.0 * fit.cost - float((z2 - z2 / grown).sum())) / fit.dof
    if not noise2 > 0.0:  # so much of it is the board that first order takes away more than there is
        return -np.inf, 0.0
    return -0.5 * float(np.log(grown).sum()) - 0.5 * fit.dof * float(np.log(noise2)), noise2


ASKED = 8.0
"""Median miss over the corners' noise from which it is asked: of printed boards on real cameras it is 2 to 6."""
ASKED_PX = 0.2
EXPLAINS = 0.3
"""Share of the miss that another board must leave to be named."""
GROSS = 2e-3
"""Median miss over the image's width with which nothing is calibrated: real sets leave up to 5e-4 of it."""
STRETCH = (0.8, 1.25)
"""Bounds of a board's rows' distance over its columns'."""
MARKERS = (0.5, 0.97)
"""Bounds of a tag's width over the distance from tag to tag."""
TOLERANCE = 1e-4
"""The stretch is found to so much: a print's own is larger."""


def refuse_other_board(given: Observations, board: Target, options: BoardOptions, name: str) -> None:
    """Raise Inconsistent where corners miss by far more than their noise, with the board that would fit if one does.

    given: of one camera, whatever was left out of a fit since.
    """
    lens = options.lens
    own = lens_alone(given, options, lens)
    if own is None or own.median_px < max(ASKED * noise_of(given), ASKED_PX):
        return
    seen = _told(given, own.median_px, name)
    for words, cure, shaped, bounds in _others(board):
        value, left_px = _best(given, options, lens, shaped, bounds)
        if left_px < EXPLAINS * own.median_px:
            raise Inconsistent(
                f"{seen}; {words(value)} they miss it by {left_px:.2g} px",
                consequence="Lens and distances would be bent to fit another board, and nothing is calibrated",
                cure=cure(value),
            )


def refuse_misfit(given: Observations, options: BoardOptions, name: str) -> None:
    """Raise Inconsistent where corners miss the board by pixels: after it is asked whether lens or board are others."""
    own = lens_alone(given, options, options.lens)
    if own is not None and own.median_px > GROSS * given.sizes[0][0]:
        raise Inconsistent(
            _told(given, own.median_px, name),
            consequence="No camera sees this board so, and nothing is calibrated",
            cure="Check what --board says: its kind, counts and sizes; and that it is flat and stands still",
        )


def doubtful(given: Observations, fit: RobustFit) -> bool:
    """Whether a fit leaves so much, or leaves so many points out, that the board is in doubt."""
    kept = int(np.count_nonzero(fit.observations.weight)) / max(int(np.count_nonzero(given.weight)), 1)
    return bool(fit.fit.scale > 0.5 * ASKED or kept < KEPT)


def noise_of(given: Observations) -> float:
    """Return the corners' noise in px, as the detector believes it."""
    return float(np.median(1.0 / given.weight[given.weight > 0.0]))


def _told(given: Observations, median_px: float, name: str) -> str:
    return f"{name}: corners good to {noise_of(given):.2g} px miss the board by {median_px:.2g} px (median)"


Other = tuple[Callable[[float], str], Callable[[float], str], Callable[[float], Array], tuple[float, float]]


def _others(board: Target) -> list[Other]:
    """Return boards in place of the given one: words, cure and points by a number, and the number's bounds."""
    X, pitch = board.xyz_m, board.pitch_m
    stretched: Other = (
        lambda ratio: (
            f"of a board whose rows stand {ratio:.3f} times as far apart as its columns "
            f"({pitch / MM:.4g} x {ratio * pitch / MM:.3g} mm)"
        ),
        lambda ratio: (
            "Measure the board with a calliper along both sides, over many squares, and print it anew "
            "without fitting it to the page"
        ),
        lambda ratio: X * np.array([1.0, ratio, 1.0]),
        STRETCH,
    )
    # gaps first: they are what a person types, and a grid of other gaps fits a stretched one in part
    return [*(_tags(board) if board.kind is TargetKind.APRILGRID else []), stretched]


def _tags(board: Target) -> list[Other]:
    """Return AprilGrids of other gaps, and of tags numbered as OpenCV's GridBoard has them."""
    head = f"--board aprilgrid:{board.columns}x{board.rows}:{board.marker_m:g}"
    along, down = np.meshgrid(np.arange(2 * board.columns), np.arange(2 * board.rows))
    corner = np.stack([along, down], axis=-1)  # (2 rows, 2 columns, 2)

    def spaced(share: float) -> Array:
        flat = board.marker_m * (corner // 2 / share + corner % 2)
        return np.concatenate([flat, np.zeros_like(flat[..., :1])], axis=-1).reshape(-1, 3)

    def numbered(share: float) -> Array:
        # OpenCV counts from the upper left, Kalibr from the lower left: half a turn and the rows the other way
        other = spaced(share).reshape(2 * board.rows, board.columns, 2, 3)[:, ::-1]
        return np.ascontiguousarray(other).reshape(-1, 3)

    return [
        (
            lambda share: f"of tags with gaps of {1.0 / share - 1.0:.3f} of their width",
            lambda share: f"Measure tag and gap with a calliper; perhaps {head}:{1.0 / share - 1.0:.3f} is meant",
            spaced,
            MARKERS,
        ),
        (
            lambda share: "with the tags numbered the other way along the rows, as in OpenCV's GridBoard",
            lambda share: (
                "Print an AprilGrid as Kalibr draws it, with black squares at the tags' corners, or a "
                "ChArUco board (--board charuco:...)"
            ),
            numbered,
            MARKERS,
        ),
    ]


def _best(
    given: Observations,
    options: BoardOptions,
    lens: LensKind,
    shaped: Callable[[float], Array],
    bounds: tuple[float, float],
) -> tuple[float, float]:
    """Return the number whose board fits best, and the median miss in px."""

    def missed(value: float) -> float:
        found = lens_alone(replace(given, X=shaped(value) - shaped(value).mean(axis=0)), options, lens)
        return np.inf if found is None else found.median_px

    # the median has more than one minimum over wide bounds: the best of a few places, then about it
    tried = np.linspace(bounds[0], bounds[1], 10)
    first, step = float(tried[np.argmin([missed(value) for value in tried.tolist()])]), float(tried[1] - tried[0])
    around = (max(bounds[0], first - step), min(bounds[1], first + step))
    found = scipy.optimize.minimize_scalar(missed, bounds=around, method="bounded", options={"xatol": TOLERANCE})
    return float(found.x), float(found.fun)
