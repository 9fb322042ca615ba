"""The proof of a link: what a controller makes of what it is sent, shown by a motion of a few hundredths of a degree.

All axes leave their rest together, each by its own amplitude and to its own side, and come back. The amplitude grows
exponentially: a controller that adds up, or that scales by fifty, is seen while next to nothing was sent. The judgement
is by areas: for any linear lag or delay, the area under the readings is that under what was sent times the gain at rest
(the transfer function at zero frequency), so that nothing has to be known of the drives, and nothing waited for.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations, product

import numpy as np

from armsight.arrays import Array
from armsight.drivers.proof_causes import Evidence, cause_of
from armsight.units import DEG

PROBE_RAD = (0.04 * DEG, 0.025 * DEG)
"""Amplitudes of the first and of the last axis; those between are spaced geometrically, so that no two are alike."""

PROBE_M = (3e-4, 2e-4)
"""... of a flange along x and along z: at half a metre as far as the joints' amplitudes bring it."""

LEAST_SHARE = 0.2
"""An axis of the flange that the joints' probe moves by less than this share of a flange's is not judged: rounding."""

FLANGE_AXES = tuple(f"{axis} of the flange" for axis in ("X", "Y", "Z", "RX", "RY", "RZ"))

FIRST_SHARE = 1.0 / 40.0
"""Share of the amplitude that is sent first: radians taken for degrees make 0.06 degrees of it."""

LAG_S = 0.05
ADDED_SHARE = 0.25
MOST_RATE = 27.0
"""The amplitude grows by the rate r, in 1/s, at which r T (1 + r LAG_S) is ADDED_SHARE for a cycle T: behind a lag of
LAG_S a controller that adds up then shows four times what was sent. Never faster than MOST_RATE: 1 degree/s."""

LEAST_CYCLES = 5
"""... and the amplitude doubles at most: where the controller tells in each cycle what it took, that is slow enough."""

PLATEAU_S = 0.04
RETURN_S = 0.06
STILL_S = 0.02
"""Time at full amplitude, of the way back, and for which readings at rest must agree."""

BEYOND = 1.7
"""An axis that is farther than this times what was sent until now ends the probe at once. Drives overshoot by a third
at most; the amplitudes of any two axes differ by less."""

FINEST = 2e-5
"""Readings differ by so much in rad or m without meaning anything: two steps of a common encoder."""

NOISIEST = 1e-4
"""Readings at rest that differ by more, in rad or m, hide the probe. 17 bits of a turn are half of that."""

GAIN_STD = 0.015
"""The plateau, and the rest before it, last until noise leaves so much of a gain."""

MOST_RESTING = 48
"""Readings at rest that are kept: a mean of so few is the larger part of a noisy gain's deviation."""

BACK_S = 0.6
"""Time for the arm to come to rest behind the probe: twelve times a lag of LAG_S."""

CALM_S = 1.0
"""Time for an arm that moves when the first motion is asked for to come to rest."""

STANDS_S, STANDS_RAD = 0.1, 0.02 * DEG
STOPPING_S = 1.0
"""An arm whose readings differ by less than so much in rad or m within STANDS_S stands. One that was told to stand and
does not after STOPPING_S goes on by itself: five times the slowest servo's lookahead."""

LONGEST_S = 4.0
MOST_CYCLES_A_STEP = 8
SOME_STEPS = 5
"""A line that needs so many cycles for each of several steps is too slow, or loses too much, to guide an arm by."""


class ProofState(StrEnum):
    """How far the proof of a link is."""

    NEEDED = "needed"
    RUNNING = "running"
    PASSED = "passed"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Probe:
    """What is moved: amplitudes (n,) in rad or m, with their signs, and what each axis is called.

    An amplitude of zero: that axis is neither moved nor watched. parts: axes that are judged together, those first in
    which a cause is named best.
    """

    amplitude: Array
    names: tuple[str, ...]
    parts: tuple[slice, ...] = (slice(None),)


def joint_probe(lower: Array, upper: Array) -> Probe:
    """Return the probe of joints that are lower and upper (n,) in rad from their ranges' ends; it stays within them."""
    n = len(lower)
    sizes = np.geomspace(*PROBE_RAD, n)
    signs = np.where(np.arange(n) % 2, -1.0, 1.0)  # of neighbours the amplitudes are nearly alike
    signs = np.where(upper < sizes, -1.0, np.where(-lower < sizes, 1.0, signs))
    return Probe(amplitude=sizes * signs, names=tuple(f"axis {i}" for i in range(1, n + 1)))


def flange_probe(joints: int = 0) -> Probe:
    """Return the probe of a flange: way in m and turn in rad (6,) in base axes, and so many joints not watched."""
    amplitude = np.concatenate([np.geomspace(*PROBE_M, 3), np.geomspace(*PROBE_RAD, 3)]) * [1, -1, 1, -1, 1, -1]
    return Probe(amplitude=np.append(amplitude, np.zeros(joints)), names=FLANGE_AXES + ("",) * joints)


def flange_probe_by_joints(n: int, moved: Callable[[Array], Array]) -> Probe:
    """Return the probe of a flange whose signs are those by which the least moved of n joints moves most.

    moved: as in flange_and_joint_probe. A joint that the flange's probe hardly moves would not be proven.
    """
    probe = flange_probe()
    by_joint = np.array([moved(row) for row in PROBE_RAD[1] * np.eye(n)])  # (n, 6)
    signs = np.array(list(product((1.0, -1.0), repeat=6)))
    ways = signs * np.abs(probe.amplitude)
    least = np.abs(ways @ np.linalg.pinv(by_joint)).min(axis=1)
    return Probe(amplitude=ways[int(least.argmax())], names=probe.names)


def flange_and_joint_probe(lower: Array, upper: Array, moved: Callable[[Array], Array]) -> Probe:
    """Return the probe of joints, as joint_probe, behind a flange's way and turn (6,); both are watched.

    moved: returns way and turn (6,) for joints moved by (n,). The joints' signs are those by which the flange's least
    moved axis moves most, and no two axes of it alike, so that exchanged ones are seen.
    """
    joints, flange = joint_probe(lower, upper), flange_probe()
    n, sizes = len(lower), np.abs(joints.amplitude)
    by_joint = np.array([moved(row) for row in np.diag(sizes)])  # (n, 6)
    signs = np.array(list(product((1.0, -1.0), repeat=n)))  # (2^n, n)
    inside = ((signs * sizes <= upper) & (signs * sizes >= lower)).all(axis=1)
    signs = signs[inside] if inside.any() else np.sign(joints.amplitude)[None]
    ways = signs @ by_joint  # (m, 6)
    shares = np.abs(ways) / np.abs(flange.amplitude)
    best = int(np.minimum(shares.min(axis=1), _unlike(ways)).argmax())
    way = np.where(np.abs(ways[best]) >= LEAST_SHARE * np.abs(flange.amplitude), ways[best], 0.0)
    return Probe(
        amplitude=np.concatenate([way, signs[best] * sizes]),
        names=flange.names + joints.names,
        parts=(slice(0, 6), slice(6, 6 + n)),
    )


def _unlike(ways: Array) -> Array:
    """Return by which share of the larger one the two most alike of a flange's ways, or turns, differ (m,)."""
    pairs = [(i, j) for i, j in combinations(range(6), 2) if i // 3 == j // 3]
    differ = [np.abs(ways[:, i] - ways[:, j]) / np.maximum(np.abs(ways[:, i]), np.abs(ways[:, j])) for i, j in pairs]
    return np.asarray(np.min(differ, axis=0))


class Standing:
    """Whether an arm that was told to stand does."""

    def __init__(self, cycle_s: float, within: float = STANDS_RAD) -> None:
        """within: readings (rad or m) of an arm that stands differ by less; of coarse encoders that is two steps."""
        self._cycle_s, self._within = cycle_s, within
        self._rows: deque[Array] = deque(maxlen=max(4, round(STANDS_S / cycle_s)))
        self._cycles: int | None = None
        self.stands = False

    def begin(self) -> None:
        """It is told to stand now."""
        self._rows.clear()
        self._cycles, self.stands = 0, False

    def moves(self, y: Array) -> bool:
        """Take where its axes are read, y (n,), once a cycle; tell, once, that it does not come to rest."""
        if self._cycles is None:
            return False
        self._cycles += 1
        self._rows.append(y)
        full = len(self._rows) == self._rows.maxlen
        self.stands = full and bool(np.ptp(np.array(self._rows), axis=0).max() <= self._within)
        if self.stands:
            self._cycles = None
            return False
        return self._cycles * self._cycle_s > STOPPING_S


class Proof:
    """The proof of one link. The link's thread tells it each of the controller's cycles, and sends what it says."""

    def __init__(self, cycle_s: float, *, lags: bool = True) -> None:
        """lags: readings lag behind what is sent; else what controller and arm do is told as soon as it is taken."""
        self._cycle_s, self._lags = cycle_s, lags
        self._force = 0.0
        self._still = max(2, math.ceil(STILL_S / cycle_s))
        self._window: deque[Array] = deque(maxlen=MOST_RESTING)
        self.state = ProofState.NEEDED

    @property
    def in_force(self) -> Array:
        """What the controller took last of a probe that runs, (n,) from where the axes stood."""
        return self._force * self._probe.amplitude

    def forget(self) -> None:
        """Take nothing for proven: the next motion begins with a probe."""
        self.state, self._force = ProofState.NEEDED, 0.0
        self._window.clear()

    def rest(self, y: Array) -> None:
        """Note where the axes are read, y (n,), while nothing moves."""
        self._window.append(y)

    def begin(self, probe: Probe) -> None:
        """Begin; what is sent from the next cycle on is told by step()."""
        self.state = ProofState.RUNNING
        self._probe = probe
        self._moved = np.flatnonzero(probe.amplitude)
        self._size = np.abs(probe.amplitude[self._moved])
        self._shares: Array | None = None
        self._cycles = self._taken = self._given = self._waited = 0
        self._sent_share = self._force = self._largest = 0.0
        self._areas = np.zeros((2, len(self._moved)))
        self._added = self._peak = 0.0
        self._beyond = np.zeros(len(self._moved), dtype=bool)
        self._zeros = 0

    def step(self, y: Array, cycles: int, *, taken: bool) -> tuple[Array, str | None]:
        """Return what is to be sent, (n,) from where the axes stood, and the verdict: None as long as there is none.

        y (n,): where the axes are read, so many cycles after the last time; taken: whether what was sent last was. The
        verdict is empty where the link is proven; else it is the cause, and the axes are sent to where they stood.
        """
        self._window.append(y)
        if self._shares is None and not self._calm():
            self._waited += cycles
            late = self._waited * self._cycle_s > CALM_S
            return np.zeros_like(y), self._ended(
                "the arm does not stand still, or its readings are too noisy"
            ) if late else None
        self._note(y, cycles, taken=taken)
        return self._sent_share * self._probe.amplitude, self._verdict()

    def _calm(self) -> bool:
        """Plan the probe where the axes stand still; tell whether they do."""
        rows = np.array(self._window)[:, self._moved]
        least = max(6, 2 * self._still)
        spread = np.ptp(rows[-least:], axis=0)
        noise = float((spread / 3.0 / self._size).max())
        shares = _shares(self._cycle_s, noise, lags=self._lags)
        # the mean of those at rest is taken off every reading of the probe, to its slowest drive's end
        each = (len(shares) + 3.0 * LAG_S / self._cycle_s) / float(shares.sum())
        wanted = int(np.clip(math.ceil((each * noise / GAIN_STD) ** 2), least, MOST_RESTING))
        if len(rows) < wanted or np.ptp(rows[-wanted:], axis=0).max() > NOISIEST:
            return False
        self._rest, self._noise, self._shares = rows[-wanted:].mean(axis=0), np.maximum(spread, FINEST), shares
        return True

    def _note(self, y: Array, cycles: int, *, taken: bool) -> None:
        shares = self._shares if self._shares is not None else np.zeros(0)
        away = y[self._moved] - self._rest
        if taken:
            self._force = self._sent_share
            self._taken += 1
            self._added += self._force
        self._cycles += cycles
        self._peak = max(self._peak, float((np.abs(away) / self._size).max()))
        self._areas += cycles * np.array([self._force * self._probe.amplitude[self._moved], away])
        self._beyond |= np.abs(away) > BEYOND * self._largest * self._size + 2.0 * self._noise
        if self._beyond.any():
            self._given = len(shares)
        if self._given < len(shares) and (taken or not self._given):
            self._sent_share = float(shares[self._given])
            self._given += 1
        elif self._given >= len(shares) and (taken or self._beyond.any()):
            self._sent_share = 0.0
        self._largest = max(self._largest, self._sent_share)
        self._zeros = self._zeros + cycles if self._given >= len(shares) and self._sent_share == 0.0 else 0

    def _verdict(self) -> str | None:
        cycle_s = self._cycle_s
        slow = self._cycles > MOST_CYCLES_A_STEP * max(self._taken, SOME_STEPS)
        if slow or self._cycles * cycle_s > LONGEST_S:
            each = self._cycles / max(self._taken, 1)
            return self._ended(
                f"its controller takes an answer only every {each:.0f} cycles ({1e3 * each * cycle_s:.0f} ms): "
                "the line is too slow, or loses too much, to guide an arm"
                if self._taken > 1
                else "its controller takes none of the answers that it is sent"
            )
        if self._zeros < self._still:
            return None
        rows = np.array(self._window)[-self._still :, self._moved] - self._rest
        far, size = np.abs(rows.mean(axis=0)), self._size
        waited_s = self._zeros * cycle_s
        back = bool((far <= 0.6 * self._noise + (0.02 if self._lags else 0.04) * size).all())
        if not back and waited_s < 0.5 * BACK_S:
            return None
        # friction may hold an axis a little off; what comes from a controller that adds up stands still far off
        back = back or bool((far <= 1.5 * self._noise + 0.05 * size).all())
        stands = bool((np.ptp(rows, axis=0) <= self._noise).all())
        if not (back or stands or waited_s > BACK_S):
            return None
        return self._ended(self._judged(rows.mean(axis=0), back=back))

    def _judged(self, end: Array, *, back: bool) -> str:
        """Return the cause by that part of the axes in which fewest are wrong, from where they stand, end (m,)."""
        end = np.zeros_like(end) if back else end
        seen = [self._evidence(part, end) for part in self._probe.parts]
        found = [(one.n_wrong, cause) for one in seen if (cause := cause_of(one))]
        return min(found, key=lambda one: one[0])[1] if found else ""

    def _evidence(self, part: slice, end: Array) -> Evidence:
        sent, read = self._areas
        inside = np.isin(self._moved, np.arange(len(self._probe.names))[part])
        return Evidence(
            names=tuple(self._probe.names[i] for i in self._moved[inside]),
            sent=sent[inside],
            read=read[inside],
            end=end[inside],
            added=self._added * self._probe.amplitude[self._moved][inside],
            noise=self._noise[inside],
            beyond=bool(self._beyond[inside].any()),
            early=bool(self._beyond.any()),
            peak=self._peak,
            cycles=self._cycles,
        )

    def _ended(self, cause: str) -> str:
        self.state = ProofState.NEEDED if cause else ProofState.PASSED
        return cause


def _shares(cycle_s: float, noise: float, *, lags: bool) -> Array:
    """Return the shares of the amplitude that go out, one a cycle; noise: of a reading, as a share of the smallest."""
    rate = min(MOST_RATE, (math.sqrt(1.0 + 4.0 * ADDED_SHARE * LAG_S / cycle_s) - 1.0) / (2.0 * LAG_S))
    n = max(LEAST_CYCLES, math.ceil(-math.log(FIRST_SHARE) / (rate * cycle_s)) if lags else 0)
    ramp = FIRST_SHARE ** (1.0 - np.arange(n) / n)
    # a mean of m readings of noise s, less one of as many, is known to s sqrt(2 / m)
    plateau = min(max(PLATEAU_S / cycle_s, 2.0 * (noise / GAIN_STD) ** 2), 1.0 / cycle_s)
    back = max(2, round(RETURN_S / cycle_s))
    fall = 0.5 + 0.5 * np.cos(math.pi * np.arange(1, back + 1) / back)
    return np.concatenate([ramp, np.ones(max(1, math.ceil(plateau))), fall])
