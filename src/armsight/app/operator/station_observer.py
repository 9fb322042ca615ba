"""One light of the target as the measuring station shows it: the beacon of an arm's identification."""

from __future__ import annotations

import numpy as np

from armsight.app.live.station import Shown, Station
from armsight.app.live.views import SideView
from armsight.arrays import Array
from armsight.clock import Clock
from armsight.control.joint_sweep import Observation
from armsight.defaults import LOOK_S, LOST_LOOKS
from armsight.errors import DeviceFailed, NotEnoughData
from armsight.optics import Rig, triangulate

WAIT_S = 10.0
"""A station that shows nothing new for so long is taken for lost."""
FASTEST_PX_S, STILL_PX, WIDEST_PX = 150.0, 3.0, 30.0
"""How far a light may be from where it was, for it to be the same: by its speed, at rest, and at most."""
SPARE = 1.25
"""A target seems larger where it comes nearer, or is turned to the camera."""


class StationObserver:
    """The beacon as the measuring station shows it: one light of the target, by its name where the station tells it.

    Where it does not, for three lights seen askew may fit several names, the light is followed from picture to picture.
    """

    def __init__(self, station: Station, rig: Rig, light: str, clock: Clock) -> None:
        self._station, self._rig, self._light, self._clock = station, rig, light, clock
        self._last: Shown | None = None
        self._uv: tuple[float, Array] | None = None
        self._lost = 0

    def observe(self, while_: str) -> Observation:
        """Return what the next moment shows. Raises NotEnoughData where the beacon is lost, DeviceFailed."""
        shown = self._next(while_)
        view = shown.view
        taken_s = self._clock.now_s() - view.latency_s
        found = self._found(shown)
        if found is None:
            self._lost += 1
            if self._lost >= LOST_LOOKS:
                why = f" ({view.why})" if view.why else ""
                raise NotEnoughData(
                    f"the light {self._light} is lost {while_}{why}",
                    consequence="The robot is held",
                    cure="Free the view of it, or narrow the ranges to where both cameras see it",
                )
            return Observation(taken_s=taken_s, why="it is not in both pictures")
        uv, covariance = found
        self._lost, self._uv = 0, (view.t_s, uv)
        xyz_m = triangulate(self._rig, uv[:1], uv[1:], covariance[0], covariance[1]).xyz_m[0]
        worst = np.linalg.eigvalsh(covariance)[:, 1].max()  # of both views, each in its worse direction
        return Observation(taken_s=taken_s, uv_px=uv, xyz_m=xyz_m, std_px=float(np.sqrt(worst)))

    def _next(self, while_: str) -> Shown:
        """Wait for a newer moment."""
        until_s = self._clock.now_s() + WAIT_S
        while (shown := self._station.shown) is None or shown is self._last:
            if self._station.failure or self._clock.now_s() > until_s:
                why = self._station.failure or "no pictures come"
                raise DeviceFailed(f"{why} {while_}", consequence="The robot is held", cure="Look at the cameras")
            self._clock.sleep_until(self._clock.now_s() + LOOK_S)
        self._last = shown
        return shown

    def _found(self, shown: Shown) -> tuple[Array, Array] | None:
        """Return the light's uv_px (2, 2) in both pictures and its covariances (2, 2, 2); None where it is lost.

        It is found by its name, or as what it has become.
        """
        centres, covariances, view = [], [], shown.view
        for pictured, spots, side in zip((view.left, view.right), shown.spots, (0, 1), strict=True):
            centre = _named(pictured, self._light)
            if centre is None and self._uv is not None:
                centre = _followed(pictured, self._uv[1][side], view.t_s - self._uv[0])
            if centre is None:
                return None
            centres.append(centre)
            covariances.append(spots.covariance_px2[np.argmin(np.linalg.norm(spots.uv_px - centre, axis=1))])
        return np.array(centres), np.array(covariances)


def _named(view: SideView, name: str) -> Array | None:
    return next((np.array([spot.u_px, spot.v_px]) for spot in view.spots if spot.name == name), None)


def _followed(view: SideView, before_px: Array, passed_s: float) -> Array | None:
    """Return the spot that a light at before_px (2,) has become; None where none or more than one may be it."""
    positions = np.array([[spot.u_px, spot.v_px] for spot in view.spots]).reshape(-1, 2)
    away = np.sort(np.linalg.norm(positions - before_px, axis=1))
    gate = min(FASTEST_PX_S * passed_s + STILL_PX, WIDEST_PX)
    if not len(away) or away[0] > gate or (len(away) > 1 and away[1] < 2.0 * gate):
        return None
    return np.asarray(positions[np.argmin(np.linalg.norm(positions - before_px, axis=1))])


def around_px(shown: Shown | None, light: str) -> float:
    """Return how far the target's other lights are from this one in the pictures of now, with SPARE; 0 unseen.

    Where they stay in the pictures too, a light is told by its name all the way.
    """
    far = [0.0]
    for view in () if shown is None else (shown.view.left, shown.view.right):
        own = _named(view, light)
        if own is not None:
            far += [float(np.hypot(spot.u_px - own[0], spot.v_px - own[1])) for spot in view.spots if spot.name]
    return SPARE * max(far)
