"""What a probe that did not come out as sent says of the controller, in words, with the cure."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.units import DEG

TOLERANCE = 0.06
"""Share by which an axis may move more or less than sent. A scale of 1.1 is found, in 20 of 20 trials of each link."""

HALF_STEP = 5e-6
"""Half a step of a common encoder, in rad (m at the flange): by so much may all readings of a probe be off alike, and
those of a flange's turn, which several encoders make, by twice as much. One axis alone may be off by this too, all of
them together may not: their median is held to TOLERANCE."""

ALIKE = 0.15
EARLY = 0.4
"""Hypotheses of a cause fit where every axis is as they say but for this share of its way; EARLY where the probe was
ended while little more than noise had been sent."""

MANY = 10.0
"""No gear ratio that was set wrongly moves all axes so many times as far."""

STILL_SHARE = 0.2
"""An axis that moves by less than this share of what was sent does not move."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """What a probe showed, each (n,) in the axes' units.

    sent, read: areas under what was sent and what was read, times a cycle. end: where the axes stand at last, from
    where they stood; zeros where they came back. added: sum of all that was sent. noise: of a reading. beyond: the
    probe was ended because an axis of these went too far; early: or another one. peak: the largest way of any axis, as
    a share of its amplitude. cycles: that it took.
    """

    names: tuple[str, ...]
    sent: Array
    read: Array
    end: Array
    added: Array
    noise: Array
    beyond: bool
    early: bool
    peak: float
    cycles: int

    @property
    def tolerance(self) -> Array:
        """Share by which each axis (n,) may move more or less than sent."""
        steps = np.array([2.0 if "R" in name else 1.0 for name in self.names]) * HALF_STEP
        return TOLERANCE + np.minimum(steps * self.cycles / np.abs(self.sent), 0.5 * ALIKE)

    @property
    def n_wrong(self) -> int:
        """How many axes do not move as sent."""
        return int((np.abs(self.read / self.sent - 1.0) > (ALIKE if self.early else self.tolerance)).sum())


def cause_of(seen: Evidence) -> str:
    """Return why the link is not proven; empty where it is."""
    if seen.end.any():
        return _not_back(seen)
    gain = seen.read / seen.sent
    fits = (np.abs(gain - 1.0) <= seen.tolerance).all() and abs(np.median(gain) - 1.0) <= TOLERANCE
    if not seen.beyond and fits:
        return ""
    if (np.abs(gain) < STILL_SHARE).all() and seen.peak > STILL_SHARE:
        return (
            "its controller takes each answer as the whole way from where it began: set it to ways that add up "
            "(cumulative)"
        )
    if (np.abs(gain) < STILL_SHARE).all():
        return "no axis moves: its controller takes the answers, but motion is not enabled or corrections are not used"
    found = _scaled(gain, EARLY if seen.early else ALIKE) or _exchanged(seen) or _units(gain) or _single(seen, gain)
    return found or f"its axes do not move as sent: {_listed(seen, gain)}{_by_pose(seen.names)}"


def _not_back(seen: Evidence) -> str:
    share = seen.end / seen.added
    middle = float(np.median(share))
    if middle > 0.0 and (np.abs(seen.end - middle * seen.added) <= ALIKE * np.abs(seen.end) + 3.0 * seen.noise).all():
        return (
            "its controller adds each answer to the last (relative mode): set it to absolute corrections "
            "(RSI: AXISCORR and POSCORR absolute)"
        )
    far = int(np.argmax(np.abs(seen.end) / seen.noise))
    way = abs(seen.end[far])
    stands = f"{way / DEG:.3f} degrees (or {1e3 * way:.3f} mm) away"
    return f"{seen.names[far]} did not come back from the probe: it stands {stands}"


def _scaled(gain: Array, alike: float) -> str:
    scale = float(np.median(gain))
    if abs(scale) < STILL_SHARE * 0.05 or np.abs(gain / scale - 1.0).max() > alike:
        return ""
    if np.abs(scale - 1.0) <= TOLERANCE:
        return ""
    if 1.0 - alike <= abs(scale * DEG) <= 1.0 + alike:
        return "its controller takes radians for degrees (every axis moves 57 times as far as sent)"
    if scale < 0.0 and abs(scale + 1.0) <= ALIKE:
        return "all axes are reversed"
    return f"every axis moves {scale:.3g} times as far as sent: the units or the scale of the corrections differ"


def _units(gain: Array) -> str:
    """Return the cause where all axes go far beyond what any gear makes of it, as far as each got before the stop."""
    if gain.min() < MANY:
        return ""
    return (
        f"every axis moves {gain.min():.0f} to {gain.max():.0f} times as far as sent: its controller takes radians for "
        "degrees, which is 57 times, or another unit"
    )


def _exchanged(seen: Evidence) -> str:
    n, alike = len(seen.names), EARLY if seen.early else TOLERANCE

    def off(order: NDArray[np.int64]) -> float:
        foretold = seen.sent[order]
        return float((np.abs(seen.read - foretold) / np.maximum(np.abs(foretold), np.abs(seen.sent))).max())

    def swapped(pair: tuple[int, int]) -> NDArray[np.int64]:
        order = np.arange(n)
        order[list(pair)] = pair[::-1]
        return order

    pairs = list(combinations(range(n), 2))
    i, j = min(pairs, key=lambda pair: off(swapped(pair)))
    second = float(np.sort(np.abs(seen.read / seen.sent - 1.0))[-2])  # what is left where one axis alone is wrong
    if off(swapped((i, j))) <= alike and off(swapped((i, j))) < second:
        return f"{seen.names[i]} and {seen.names[j]} are exchanged"
    nearest = np.abs(seen.read[:, None] - seen.sent[None, :]).argmin(axis=1)
    if not seen.early and len(set(nearest.tolist())) == n and off(nearest) <= alike:
        moved = ", ".join(
            f"{seen.names[k]} moves as {seen.names[nearest[k]]}" for k in np.flatnonzero(nearest != range(n))
        )
        return f"its axes come in another order, as those of another robot: {moved}"
    return ""


def _single(seen: Evidence, gain: Array) -> str:
    names, wrong = seen.names, np.flatnonzero(np.abs(gain - 1.0) > (EARLY if seen.early else seen.tolerance))
    if len(wrong) == 0 or len(wrong) > max(1, len(gain) // 2):
        return ""
    words = []
    for k in wrong:
        if abs(gain[k] + 1.0) <= ALIKE:
            words.append(f"{names[k]} is reversed")
        elif abs(gain[k]) < STILL_SHARE:
            words.append(f"{names[k]} does not move")
        else:
            words.append(f"{names[k]} moves {gain[k]:.3g} times as far as sent (its gear ratio or its scale)")
    return "; ".join(words)


def _listed(seen: Evidence, gain: Array) -> str:
    wrong = np.flatnonzero(np.abs(gain - 1.0) > seen.tolerance)
    return ", ".join(f"{seen.names[k]} by {gain[k]:.3g} of its way" for k in wrong) or "farther than sent on the way"


def _by_pose(names: tuple[str, ...]) -> str:
    """Return what moves a flange otherwise on several axes at once."""
    flange = any("flange" in name for name in names)
    return "; a gear ratio, or a length, on the controller is not the arm's" if flange else ""
