"""What the measuring station shows, snapshot by snapshot: the target's pose, or one light of it, an arm's beacon."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress

import numpy as np

from armsight.app.live.station import MeasurementProcess, Snapshot
from armsight.app.live.views import SideView
from armsight.app.operator.robot_cell import RobotCell
from armsight.arrays import Array
from armsight.clock import Clock
from armsight.control.joint_sweep import Observation
from armsight.defaults import LOOK_S, LOST_LOOKS
from armsight.errors import ArmsightError, DeviceFailed, NotEnoughData
from armsight.optics import Rig, as_pair, triangulate
from armsight.records import TargetPose
from armsight.records.motion import JointHistory

WAIT_S = 10.0
"""A station that shows nothing new for so long is taken for lost."""
FOLLOWED_S = 0.004
"""Between two looks of a thread that follows a station."""
LEAST_CYCLE_S = 0.02
"""Readings are looked at by a thread of Python beside a page: it may miss some."""
FASTEST_PX_S, STILL_PX, WIDEST_PX = 150.0, 3.0, 30.0
"""How far a light may be from where it was, for it to be the same: by its speed, at rest, and at most."""


class Snapshots:
    """What a measuring station shows, each snapshot once. station: asked anew each time, as it may be replaced."""

    def __init__(self, station: Callable[[], MeasurementProcess | None], clock: Clock) -> None:
        self._station, self._clock = station, clock
        self.begin()

    def begin(self) -> None:
        """Take what is shown for new, and count silence from now on."""
        self._last: Snapshot | None = None
        self._newest_s = self._clock.now_s()

    @property
    def silent_s(self) -> float:
        """For how long nothing new has come."""
        return self._clock.now_s() - self._newest_s

    @property
    def failure(self) -> str:
        """Why the station does not measure; empty while it does, and where there is none."""
        station = self._station()
        return "" if station is None else station.failure

    def newer(self) -> Snapshot | None:
        """Return the newest snapshot; None where it was returned before, or nothing is shown yet."""
        station = self._station()
        shown = None if station is None else station.shown
        if shown is None or shown is self._last:
            return None
        self._last, self._newest_s = shown, self._clock.now_s()
        return shown

    def next(self, while_: str) -> Snapshot:
        """Wait for a newer one and return it. Raises DeviceFailed where no pictures come."""
        until_s = self._clock.now_s() + WAIT_S
        while (shown := self.newer()) is None:
            if self.failure or self._clock.now_s() > until_s:
                why = self.failure or "no pictures come"
                raise DeviceFailed(f"{why} {while_}", consequence="The robot is held", cure="Look at the cameras")
            self._clock.sleep_until(self._clock.now_s() + LOOK_S)
        return shown


class StationFollower:
    """Takes each snapshot of a station in a thread of its own, from `follow` on until it is closed.

    robot: its joints are read between pictures too, so that those at each exposure are known.
    """

    does = "following"
    """What the thread is called."""

    def __init__(self, snapshots: Snapshots, robot: RobotCell | None = None) -> None:
        self._snapshots, self._robot = snapshots, robot
        cycle_s = 0.0 if robot is None else robot.service.authority.robot.cycle_s
        self._history = JointHistory(max(cycle_s, LEAST_CYCLE_S))
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name=self.does, daemon=True)

    def follow(self) -> None:
        """Begin."""
        self._snapshots.begin()
        self._thread.start()

    def close(self) -> None:
        """End it; legal before it began."""
        self._ended.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(FOLLOWED_S):
            self._read()
            self._look()
            shown = self._snapshots.newer()
            if shown is not None:
                self._take(shown)

    def _read(self) -> None:
        if self._robot is not None:
            with suppress(ArmsightError):
                reading = self._robot.service.host.status().reading
                if reading is not None:
                    self._history.add(reading)

    def _look(self) -> None:
        """Do what is to be done between pictures as well."""

    def _take(self, shown: Snapshot) -> None:
        raise NotImplementedError


class StationPoses:
    """The target's pose as the measuring station shows it."""

    def __init__(self, station: MeasurementProcess, clock: Clock) -> None:
        self._snapshots, self._clock = Snapshots(lambda: station, clock), clock

    def observe(self, while_: str) -> tuple[float, TargetPose]:
        """Return the next snapshot's. Raises DeviceFailed where no pictures come."""
        shown = self._snapshots.next(while_)
        return self._clock.now_s() - shown.view.latency_s, shown.pose


class StationObserver:
    """The beacon as the measuring station shows it: one light of the target, by its name where the station tells it.

    Where it does not, for three lights seen askew may fit several names, the light is followed from picture to picture.
    Of other rigs than pairs the cameras that show it count, of which there are to be two: one alone places no light.
    """

    def __init__(self, station: MeasurementProcess, rig: Rig, light: str, clock: Clock) -> None:
        self._snapshots, self._light, self._clock = Snapshots(lambda: station, clock), light, clock
        self._rig = rig
        self._uv: tuple[float, Array] | None = None
        self._lost = 0

    def observe(self, while_: str) -> Observation:
        """Return what the next moment shows. Raises NotEnoughData where the beacon is lost, DeviceFailed."""
        shown = self._snapshots.next(while_)
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
                    cure="Free the view of it, or narrow the ranges to where two cameras see it",
                )
            return Observation(taken_s=taken_s, why="it is not in the pictures of two cameras")
        uv, covariance = found
        self._lost, self._uv = 0, (view.t_s, uv)
        at = [s for s, one in enumerate(uv) if np.isfinite(one).all()]
        pair = as_pair(self._rig, *at[:2])  # where it is, roughly: the fit takes the pixels of all
        xyz_m = triangulate(pair, *(uv[s : s + 1] for s in at[:2]), *(covariance[s] for s in at[:2])).xyz_m[0]
        worst = np.linalg.eigvalsh(covariance[at])[:, 1].max()  # of all views, each in its worse direction
        return Observation(taken_s=taken_s, uv_px=uv, xyz_m=xyz_m, std_px=float(np.sqrt(worst)))

    def _found(self, shown: Snapshot) -> tuple[Array, Array] | None:
        """Return the light's uv_px (v, 2) in the pictures and its covariances (v, 2, 2), NaN where one does not show
        it; None where it is lost. It is found by its name, or as what it has become.
        """
        v, view = len(self._rig.cameras), shown.view
        centres, covariances = np.full((v, 2), np.nan), np.full((v, 2, 2), np.nan)
        for side, (pictured, spots) in enumerate(zip(view.cameras.values(), shown.spots, strict=True)):
            if pictured.left_out is not None:  # it was knocked: what it shows is elsewhere
                continue
            centre = _named(pictured, self._light)
            if centre is None and self._uv is not None and np.isfinite(self._uv[1][side]).all():
                centre = _followed(pictured, self._uv[1][side], view.t_s - self._uv[0])
            if centre is not None and len(spots):
                centres[side] = centre
                covariances[side] = spots.covariance_px2[np.argmin(np.linalg.norm(spots.uv_px - centre, axis=1))]
        return (centres, covariances) if np.isfinite(centres[:, 0]).sum() > 1 else None


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
