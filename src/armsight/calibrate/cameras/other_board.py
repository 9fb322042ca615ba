"""Whether the board is another one than it is said to be, where corners miss by far more than their noise.

A board that was printed stretched, or whose gaps are others, bends the lens to fit it: it is asked before the lens is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from armsight.arrays import Array
from armsight.calibrate.cameras.lens_choice import KEPT, lens_alone
from armsight.calibrate.cameras.observations import BoardOptions, Observations
from armsight.calibrate.cameras.outlier_rejection import RobustFit
from armsight.errors import Inconsistent
from armsight.optics import LensKind
from armsight.records import Target, TargetKind
from armsight.units import MM

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
    found = minimize_scalar(missed, bounds=around, method="bounded", options={"xatol": TOLERANCE})
    return float(found.x), float(found.fun)
