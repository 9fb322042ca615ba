"""What the search for spots is told, and how long it may take."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import NoneType
from typing import Literal, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Mask
from armsight.errors import UsageError
from armsight.records import Colour, require_count, require_kind, require_numbers

METHODS = ("likelihood", "seed")
MODELS = ("auto", "gaussian", "ellipse")
"""Models that may be asked for; auto lets the data choose, streaks and touching spots included."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SpotSettings:
    """How spots are searched and measured.

    threshold: grey level (0..255; after inversion, if inverted) that a spot's pixels exceed. None: background plus
    five standard deviations of the noise, both estimated from the image tile by tile.
    inverted: dark spots on light; grey then means 255 - grey, everywhere in these settings.
    mask: (h, w), True where spots may be; pixels outside count for nothing.
    min_pixels: least area above the threshold. max_radius_px: larger areas are reflections or windows.
    max_spots: the strongest so many are measured.
    model: 'auto', 'gaussian' (round, narrow lights) or 'ellipse' (flat lights with a blurred edge).
    saturation: grey level from which a pixel is clipped and its value unknown.
    gain: variance in grey levels^2 that the light adds per grey level (shot noise; full-scale / full-well electrons).
    None: as far as the residuals of the image's spots prove it.
    colour: a beacon's colour; the image must then be BGR.
    method: 'likelihood' (a model of light and noise is fitted) or 'seed' (Pachidis 2005: a 9x9 cross finds a seed in
    the binary image, which is propagated over the shape; the centre is the mean of its pixels; needs a threshold or
    takes one; lights at least nine pixels wide, or five where none is).
    """

    threshold: float | None = None
    inverted: bool = False
    mask: Mask | None = None
    min_pixels: int = 3
    max_radius_px: float = 32.0
    max_spots: int = 64
    model: Literal["auto", "gaussian", "ellipse"] = "auto"
    saturation: int = 255
    gain: float | None = None
    colour: Colour | None = None
    method: str = METHODS[0]
    options: NDArray[np.float64] = field(init=False, repr=False)
    mask_bytes: NDArray[np.uint8] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._check_kinds()
        self._check()
        options = np.array(
            [
                -1.0 if self.threshold is None else np.floor(self.threshold),
                255.0 if self.inverted else 0.0,
                self.saturation,
                self.min_pixels,
                self.max_radius_px,
                self.max_spots,
                MODELS.index(self.model),
                -1.0 if self.gain is None else self.gain,
            ]
        )
        options.setflags(write=False)
        mask = np.zeros((0, 0), np.uint8) if self.mask is None else np.array(self.mask, dtype=np.uint8, order="C")
        mask.setflags(write=False)
        object.__setattr__(self, "options", options)
        object.__setattr__(self, "mask_bytes", mask)

    def _check_kinds(self) -> None:
        require_numbers(self, "threshold", "max_radius_px", "gain")
        for name in ("min_pixels", "max_spots", "saturation"):
            require_count(name, getattr(self, name))
        require_kind("inverted", self.inverted, bool, np.bool_)
        require_kind("colour", self.colour, Colour, NoneType)
        if self.mask is not None and np.asarray(self.mask).dtype.kind not in "bu":
            raise UsageError(
                f"the mask is of type {np.asarray(self.mask).dtype}",
                consequence="No spots are searched",
                cure="Give truth values (h, w), True where spots may be",
            )

    def _check(self) -> None:
        def refuse(cause: str) -> None:
            raise UsageError(cause, consequence="No spots are searched", cure="Correct the spot settings")

        if self.threshold is not None and not 0.0 <= self.threshold < 255.0:
            refuse(f"a threshold of {self.threshold:g} is not a grey level from 0 to below 255")
        if not 1 <= self.saturation <= 255:
            refuse(f"a saturation of {self.saturation} is not a grey level from 1 to 255")
        if self.min_pixels < 1 or self.max_spots < 1 or not self.max_radius_px >= 1.0:
            refuse("min_pixels, max_spots and max_radius_px must be at least 1")
        if self.model not in MODELS:
            refuse(f"there is no model {self.model!r}; the models are {', '.join(MODELS)}")
        if self.method not in METHODS:
            refuse(f"there is no method {self.method!r}; the methods are {', '.join(METHODS)}")
        if self.method == "seed" and self.colour is not None:
            refuse("the seed method works on grey levels, not on colours")
        if self.gain is not None and not 0.0 <= self.gain < 255.0:
            refuse(f"a gain of {self.gain} is not from 0 to 255")
        if self.mask is not None and np.ndim(self.mask) != 2:
            refuse("the mask is not an image of rows and columns")


DEFAULTS = SpotSettings()


# How long a pair may take, and on how many cores: what a caller with a live rate says, and a batch does not.

T = TypeVar("T")

LIVE_S = 0.1
"""Deadline of a picture before which somebody waits."""


class Each(Protocol):
    """Does a piece of work for each of n views, 0 to n - 1, and returns what comes of them."""

    def __call__(self, work: Callable[[int], T], n: int, /) -> list[T]:
        """Return [work(0), work(1), ...]."""


def in_turn(work: Callable[[int], T], n: int) -> list[T]:
    """Do it for one view after the other."""
    return [work(s) for s in range(n)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """deadline_s: for a pair, on a machine like that of the benchmarks; None: as long as it takes. each: side by side
    on two cores where the caller has them."""

    deadline_s: float | None = None
    each: Each = in_turn

    def __post_init__(self) -> None:
        if self.deadline_s is not None and not self.deadline_s > 0.0:
            raise UsageError(f"a deadline of {self.deadline_s:g} s is not positive", cure="Give seconds, or none")

    @property
    def live(self) -> bool:
        """Whether somebody waits: what cannot be looked at in time is refused."""
        return self.deadline_s is not None

    def both(self, work: Callable[[int], T]) -> tuple[T, T]:
        """Return what comes of a piece of work for both views of a pair."""
        left, right = self.each(work, 2)
        return left, right

    def most(self, whole: int, each_s: float, share: float) -> int:
        """Return how many pieces of work of each_s fit into a share of the deadline; `whole` where there is none."""
        return whole if self.deadline_s is None else min(whole, int(share * self.deadline_s / each_s))


BATCH = Pace()
