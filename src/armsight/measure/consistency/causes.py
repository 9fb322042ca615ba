"""What can be wrong with a setup, as directions in the space of its parameters, and the words for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armsight.arrays import Array
from armsight.columns import POSITION
from armsight.measure.poses.setup import Setup
from armsight.optics import RigKind

K1 = 5  # among a camera's intrinsics
TURNS = 3  # numbers of a turn, before those of a place in "moved"

SCALE_WIDTH = 0.02
LIGHT_WIDTH_M = 2e-3
TURN_WIDTH_RAD = 5e-3
PLACE_WIDTH_M = 1e-3
FOCAL_WIDTH = 0.02
K1_WIDTH = 0.05
DELAY_WIDTH_S = 5e-3
"""How large a fault of each kind usually is, one standard deviation. They weigh causes against each other and matter
little: ten times the width costs a cause as much as a chi-square of 4.6."""

RECALIBRATE = "calibrate the cameras anew with `armsight calibrate stereo`"
REMEASURE = "measure the target with `armsight calibrate target`"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cause:
    """One thing that may be wrong. V (q, k): error of all parameters by its k numbers, in units of width (k,).

    labels (k,): of the numbers. same: other directions (q, k) that leave the same residuals and move the poses in
    another way. from_change: since some moment of the run, not from its beginning. unit: of the numbers, SI. cameras:
    whose fault it is, of a rig that is no pair. parts: causes of fewer numbers, tried at the moment found for this one.
    """

    key: str
    V: Array
    width: Array
    labels: tuple[str, ...]
    unit: str
    words: str
    advice: str
    same: tuple[Array, ...] = ()
    from_change: bool = False
    cameras: tuple[str, ...] = ()
    parts: tuple[Cause, ...] = ()

    @property
    def of_two_kinds(self) -> bool:
        """Whether its numbers are those of a turn and then those of a place."""
        return self.key.startswith("moved")

    def scaled(self) -> Array:
        """Return V (q, k) for numbers in units of their width."""
        return np.asarray(self.V * self.width)


def places_of(setup: Setup) -> tuple[int, int, int]:
    """Return where right.tx, right.rx and the target's begin among a pair's parameters."""
    place = 2 * setup.packed.n_intrinsics
    return place, place + 3, place + 6


def lens_widths(n: int) -> list[float]:
    """Return how far off each of the n intrinsics of a camera usually is where it is wrong."""
    return [10.0] * 4 + [1.0] + [K1_WIDTH] * 2 + [1e-3] * 2 + [K1_WIDTH] * (n - 9)


def parameter_widths(setup: Setup, q: int, *, scale_only: bool) -> Array:
    """Return (q,): how far off each parameter usually is where it is wrong; scale_only: of the target."""
    camera = lens_widths(setup.packed.n_intrinsics)
    target = [SCALE_WIDTH] if scale_only else [LIGHT_WIDTH_M] * (q - places_of(setup)[2] - 1)
    return np.array([*camera, *camera, *[PLACE_WIDTH_M] * 3, *[TURN_WIDTH_RAD] * 3, *target, DELAY_WIDTH_S])


def causes_of(setup: Setup, basis: Array) -> tuple[Cause, ...]:
    """Return all causes that this setup can have; basis (m, 3, p) of the target's parameters."""
    first = places_of(setup)[2]
    q = first + basis.shape[2] + 1
    out = [
        _scale(setup, basis, q),
        *lights(setup, basis, q, first),
        _turned(setup, q),
        _displaced(setup, q),
        *_lenses(setup, q),
    ]
    if setup.rig.kind is RigKind.STEREO and not setup.overlaid:
        out += [_delay(q), _moved(setup, q)]
    static = [cause for cause in out if not cause.from_change]
    rig = [cause for cause in static if cause.key in ("turned", "displaced", "focal", "distortion")]
    return (*out, *more_than_one(static, rig, RECALIBRATE))


def more_than_one(static: list[Cause], rig: list[Cause], recalibrate: str) -> list[Cause]:
    """Return the causes that several lights, several things of the rig, or several of all are wrong."""
    out, lights = [], [cause for cause in static if cause.key.startswith("light")]
    if lights:
        out.append(together("target", lights, "more than one light is not where the target's file says", REMEASURE))
    out.append(together("rig", rig, "the rig's calibration is wrong in more than one way", recalibrate))
    words = "the target, the rig or both are wrong in more than one way"
    out.append(together("several", static, words, f"first {recalibrate}, then {REMEASURE}"))
    return out


def together(key: str, parts: list[Cause], words: str, advice: str) -> Cause:
    """Return the cause that any of these may hold at once."""
    return Cause(
        key=key,
        V=np.hstack([cause.V for cause in parts]),
        width=np.concatenate([cause.width for cause in parts]),
        labels=tuple(f"{cause.key}.{label}" for cause in parts for label in cause.labels),
        unit="",
        words=words,
        advice=f"{advice[0].upper()}{advice[1:]}",
    )


def _zeros(q: int, k: int) -> Array:
    return np.zeros((q, k))


def _scale(setup: Setup, basis: Array, q: int) -> Cause:
    """Target against baseline: a larger target and a shorter baseline leave the same residuals."""
    target, baseline = _zeros(q, 1), _zeros(q, 1)
    place, turn, first = places_of(setup)
    target[first:-1, 0] = larger_target(setup, basis)
    baseline[place:turn, 0] = -setup.packed.baseline
    return scale(target, baseline, "baseline")


def scale(target: Array, smaller: Array, against: str) -> Cause:
    """Return the cause that the target is larger, by parameters (q, 1), against what is as much smaller then."""
    return Cause(
        key="scale",
        V=target,
        width=np.array([SCALE_WIDTH]),
        labels=(f"target_against_{against}",),
        unit="1",
        words=f"the target's scale against the {against} is off",
        advice=f"Check the target's measures with a calliper, or {REMEASURE}; if they hold, {RECALIBRATE}, with the "
        "board's true square size",
        same=(smaller,),
    )


def larger_target(setup: Setup, basis: Array) -> Array:
    """Return the target's p parameters that make it larger, by its own size."""
    m, p = basis.shape[0], basis.shape[2]
    larger, *_ = np.linalg.lstsq(basis.reshape(3 * m, p), setup.model.xyz_m.ravel(), rcond=None)
    return np.asarray(larger)


def lights(setup: Setup, basis: Array, q: int, first: int) -> list[Cause]:
    """Return the causes of each light beside its place, where the target's parameters, from `first` on, are these."""
    if basis.shape[2] < 3 * basis.shape[0] or len(setup.model) < 3:
        return []
    out = []
    for i, name in enumerate(setup.model.names):
        V = _zeros(q, 3)
        V[first + 3 * i : first + 3 * i + 3] = np.eye(3)
        out.append(
            Cause(
                key=f"light {name}",
                V=V,
                width=np.full(3, LIGHT_WIDTH_M),
                labels=POSITION,
                unit="m",
                words=f"light {name} is not where the target's file says",
                advice=f"Look whether {name} is loose or knocked, then {REMEASURE}",
            )
        )
    return out


def _axes(setup: Setup) -> Array:
    """Return (3, 3): the right camera's axes, in rig axes, as columns."""
    return np.asarray(setup.packed.R[1].T)


def _turned(setup: Setup, q: int) -> Cause:
    V = _zeros(q, 3)
    _, turn, first = places_of(setup)
    V[turn:first] = _axes(setup)
    return Cause(
        key="turned",
        V=V,
        width=np.full(3, TURN_WIDTH_RAD),
        labels=("about_x_rad", "about_y_rad", "about_z_rad"),
        unit="rad",
        words="the right camera is turned against the left one",
        advice=f"Fasten the cameras, then {RECALIBRATE}",
    )


def _displaced(setup: Setup, q: int) -> Cause:
    """Return the cause of a right camera beside its place, square to the baseline: along it is the scale."""
    along = setup.packed.baseline / np.linalg.norm(setup.packed.baseline)
    across = np.linalg.svd(along[None])[2][1:].T  # (3, 2)
    V = _zeros(q, 2)
    place, turn, _ = places_of(setup)
    V[place:turn] = across
    return Cause(
        key="displaced",
        V=V,
        width=np.full(2, PLACE_WIDTH_M),
        labels=("across_1_m", "across_2_m"),
        unit="m",
        words="the right camera stands beside its place",
        advice=f"Fasten the cameras, then {RECALIBRATE}",
    )


def _lenses(setup: Setup, q: int) -> list[Cause]:
    k = setup.packed.k
    focal, bend = _zeros(q, 2), _zeros(q, 2)
    for side, start in enumerate((0, setup.packed.n_intrinsics)):
        focal[start : start + 2, side] = k[side, :2]
        bend[start + K1, side] = 1.0
    sides = ("left", "right")
    return [
        Cause(
            key="focal",
            V=focal,
            width=np.full(2, FOCAL_WIDTH),
            labels=sides,
            unit="1",
            words="a focal length is wrong",
            advice=f"Look whether a lens was refocused or the frames scaled, then {RECALIBRATE}",
        ),
        Cause(
            key="distortion",
            V=bend,
            width=np.full(2, K1_WIDTH),
            labels=tuple(f"{side}_k1" for side in sides),
            unit="1",
            words="a lens's distortion is wrong",
            advice=f"With views of the board up to the images' corners, {RECALIBRATE}",
        ),
    ]


def _delay(q: int) -> Cause:
    V = _zeros(q, 1)
    V[-1] = 1.0
    return Cause(
        key="timing",
        V=V,
        width=np.array([DELAY_WIDTH_S]),
        labels=("right_later_s",),
        unit="s",
        words="the two cameras do not expose at one moment",
        advice="Trigger both cameras together, let the target stand still in each frame, or correct the times",
    )


def _moved(setup: Setup, q: int) -> Cause:
    turned, V = _turned(setup, q), _zeros(q, 6)
    V[:, :3] = turned.V
    place, turn, _ = places_of(setup)
    V[place:turn, 3:] = np.eye(3)
    return Cause(
        key="moved",
        V=V,
        width=np.concatenate([turned.width, np.full(3, PLACE_WIDTH_M)]),
        labels=(*turned.labels, *POSITION),
        unit="rad",
        words="a camera was moved during the run",
        advice=f"Fasten the cameras, then {RECALIBRATE}; measure anew",
        from_change=True,
    )
