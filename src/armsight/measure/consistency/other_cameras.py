"""Why a camera that sees lights has no part in the others' poses: the usual mistakes undone, and which one fits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.measure.consistency.cameras import again
from armsight.measure.consistency.findings import LeftOut
from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.views import measure_views
from armsight.optics import Camera
from armsight.records import PoseStatus, Spots
from armsight.units import DEG, MM

Seen = tuple[Spots, ...]
"""All spots of one moment, by camera."""

LIGHTS = 3
"""Spots of a camera from which it may see the target."""
WHOLE = 5
"""... and from which it mostly has a pose by itself."""
FEWEST = 3
"""Moments by which something is told."""
MOST = 0.7
"""Share of the moments that must agree."""
SAME_PX = 0.5
"""How near the spots of two pictures of one camera are."""
STEADY = 0.2
STEADY_RAD, STEADY_M = 0.02, 0.03
"""How much the way from where a camera is said to stand to where it stands by its own poses may vary, as a share of it
and beside that: one view knows its depth to some millimetres."""


class CameraChecks:
    """Tests of cameras that take no part, on some moments: their spots, and the poses that the others gave."""

    def __init__(self, setup: Setup, moments: Sequence[Measured]) -> None:
        self._setup, self._moments, self._names = setup, moments, setup.rig.names

    def mistaken(self, k: int) -> LeftOut | None:
        """Return what makes all of a camera's spots fit as they are: another camera's pictures, or mirrored ones."""
        return self._given_twice(k) or self._exchanged(k) or self._turned_over(k)

    def elsewhere(self, k: int) -> LeftOut | None:
        """Return where a camera stands by the poses that it has by itself, beside those of the others."""
        name = self._names[k]
        ways, unfit = self._ways(k)
        if len(ways) < FEWEST:
            if unfit < max(FEWEST, MOST * (unfit + len(ways))):
                return None
            words = (
                f"the camera {name} sees lights of which no pose takes any: it is turned by several degrees, or is not "
                "the camera of the rig's file, in its lens, focus and size of picture"
            )
            cure = f"Look whether {name} is that camera, as it was calibrated. {again(name)}"
            return LeftOut(names=(name,), words=capital(words), cure=cure)
        turned = np.array([way.rotation.as_rotvec() for way in ways])
        eye = np.asarray(self._setup.rig.cameras[k].T_rig_camera.translation)
        beside = np.array([way.inv().apply(eye) - eye for way in ways])
        turn, place = (float(np.linalg.norm(np.median(part, axis=0))) for part in (turned, beside))
        if turn < STEADY_RAD and place < STEADY_M:
            return None
        if not (_spread(turned) <= STEADY * turn + STEADY_RAD and _spread(beside) <= STEADY * place + STEADY_M):
            words = f"the camera {name} shows the target, but not where the others see it at the same time"
            cure = (
                f"Look whether the pictures of {name} are of this run and begin with the others': give those of one "
                "time, or sources that bring their own times"
            )
            return LeftOut(names=(name,), words=capital(words), cure=cure)
        words = (
            f"the camera {name} is not where the rig's file says: it is turned by {turn / DEG:.2g}° and stands "
            f"{place / MM:.2g} mm beside its place, or is a camera of another rig"
        )
        return LeftOut(names=(name,), words=capital(words), cure=again(name))

    def _showing(self, k: int) -> list[Measured]:
        return [one for one in self._moments if len(one.seen[k]) >= LIGHTS]

    def _moving(self, k: int) -> list[tuple[Measured, Spots]]:
        """Return the moments with what does not stand still in a camera's pictures: no lamp, no hot pixel."""
        every = [one.seen[k].uv_px for one in self._moments]
        out = []
        for one in self._showing(k):
            uv = one.seen[k].uv_px
            near = [(np.linalg.norm(uv[:, None] - other[None], axis=2) < SAME_PX).any(axis=1) for other in every]
            moving = np.flatnonzero(np.mean(near, axis=0) < 1.0 - MOST)
            out.append((one, one.seen[k].take(moving)))
        return [(one, spots) for one, spots in out if len(spots) > LIGHTS]

    def _ways(self, k: int) -> tuple[list[RigidTransform], int]:
        """Return the ways from the others' poses to a camera's own, in rig axes, and how often it should have one."""
        alone = replace(self._setup, rig=self._setup.rig.only(self._names[k]), masks=())
        ways, unfit = list[RigidTransform](), 0
        for one, spots in self._moving(k):
            own = measure_views(alone, one.pose.t_s, [spots])
            others = measure_views(self._setup, one.pose.t_s, _replaced(one.seen, k, Spots.none()))
            if others.pose.status is not PoseStatus.OK:
                continue
            if own.pose.status is PoseStatus.OK:
                T, S = np.asarray(own.pose.T_parent_target), np.asarray(others.pose.T_parent_target)
                ways.append(RigidTransform.from_matrix(T) * RigidTransform.from_matrix(S).inv())
            else:
                unfit += WHOLE <= len(spots) <= len(self._setup.model) + 1
        return ways, unfit

    def _given_twice(self, k: int) -> LeftOut | None:
        showing, a = self._showing(k), self._names[k]
        for s, b in enumerate(self._names):
            same = sum(_same(one.seen[k], one.seen[s]) for one in showing) if s != k else 0
            if same >= max(FEWEST, MOST * len(showing)):
                words = f"the pictures of the camera {a} are those of the camera {b}"
                return LeftOut(names=(a,), words=capital(words), cure=f"Give {a} the pictures of its own source")
        return None

    def _exchanged(self, k: int) -> LeftOut | None:
        a = self._names[k]
        for s, b in enumerate(self._names):
            if s != k and self._fits((k, s), lambda seen, s=s: _exchange(seen, k, s)):  # type: ignore[misc]
                words = f"the pictures of the cameras {a} and {b} are exchanged"
                cure = f"Give {a} the source of {b}, and {b} that of {a}"
                return LeftOut(names=(a, b), words=capital(words), cure=cure)
        return None

    def _turned_over(self, k: int) -> LeftOut | None:
        name, camera = self._names[k], self._setup.rig.cameras[k].camera
        for over, words in ((_mirrored, "mirrored"), (_upside_down, "upside down")):
            if self._fits((k,), lambda seen, over=over: _replaced(seen, k, over(seen[k], camera))):  # type: ignore[misc]
                cure = f"Turn that off in the driver of {name} or where it was recorded"
                return LeftOut(names=(name,), words=f"The pictures of the camera {name} are {words}", cure=cure)
        return None

    def _fits(self, which: tuple[int, ...], change: Callable[[Seen], Seen]) -> bool:
        """Whether with changed spots most moments have a pose in which these cameras have a part."""
        showing, fits = self._showing(which[0]), 0
        for i, one in enumerate(showing):
            found = measure_views(self._setup, one.pose.t_s, change(one.seen))
            there = found.pose.status is PoseStatus.OK and all(len(found.spots[k]) >= LIGHTS for k in which)
            fits += there
            if i + 1 - fits > (1.0 - MOST) * len(showing):
                return False
        return fits >= FEWEST


def capital(words: str) -> str:
    """Return words as a sentence begins."""
    return f"{words[0].upper()}{words[1:]}"


def _spread(values: Array) -> float:
    """Return how far values (n, 3) usually are from their median."""
    return float(np.median(np.linalg.norm(values - np.median(values, axis=0), axis=1)))


def _same(a: Spots, b: Spots) -> bool:
    """Whether all spots of that view which has fewer of them are the other's too."""
    fewer, more = sorted((a, b), key=len)
    apart = np.linalg.norm(fewer.uv_px[:, None] - more.uv_px[None], axis=2)
    return len(fewer) >= LIGHTS and bool((apart.min(axis=1) < SAME_PX).all())


def _exchange(seen: Seen, a: int, b: int) -> Seen:
    return tuple(seen[{a: b, b: a}.get(s, s)] for s in range(len(seen)))


def _replaced(seen: Seen, k: int, spots: Spots) -> Seen:
    return tuple(spots if s == k else one for s, one in enumerate(seen))


def _mirrored(spots: Spots, camera: Camera) -> Spots:
    sign = np.array([[1.0, -1.0], [-1.0, 1.0]])
    uv = np.column_stack([camera.width - 1.0 - spots.uv_px[:, 0], spots.uv_px[:, 1]])
    return replace(spots, uv_px=uv, covariance_px2=spots.covariance_px2 * sign)


def _upside_down(spots: Spots, camera: Camera) -> Spots:
    return replace(spots, uv_px=np.array([camera.width - 1.0, camera.height - 1.0]) - spots.uv_px)
