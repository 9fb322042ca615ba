"""The cameras of a motion as people name them, live or as files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from armsight.clock import Clock
from armsight.drivers import CameraSettings, MomentSource
from armsight.ops.requests.motion import LATENCY_S
from armsight.ops.sources.cameras import named_cameras, open_rig, told_apart, told_later
from armsight.ops.sources.frames import complex_pairs, open_source
from armsight.optics import Rig
from armsight.records import Target


@dataclass(frozen=True, slots=True)
class CameraNames:
    """Cameras as people name them, or files of them: by the rig's names, or the one image of a mirror rig.

    exposure_s: None: as they choose it. latency_s: see ServoDevices.
    """

    cameras: Mapping[str, str]
    image: str | None
    exposure_s: float | None
    latency_s: float = LATENCY_S

    @classmethod
    def of(
        cls,
        cameras: Mapping[str, str] | None,
        left: str | None,
        right: str | None,
        image: str | None,
        exposure_s: float | None,
        latency_s: float = LATENCY_S,
    ) -> CameraNames:
        """Return them as an action's arguments name them. Raises UsageError."""
        return cls(named_cameras(cameras or {}, left, right), image, exposure_s, latency_s)

    def moments(self, rig: Rig, target: Target, clock: Clock | None = None) -> tuple[MomentSource, bool] | None:
        """Return their moments, not yet open, and whether one image holds both views; None where they are not said."""
        colour, settings = target.colour is not None, CameraSettings(exposure_s=self.exposure_s)
        if self.image is not None and not self.cameras:
            return complex_pairs(partial(open_source, self.image, colour=colour, settings=settings, clock=clock), rig)
        if self.image is not None or not self.cameras:
            return None
        moments = open_rig(rig.names, cameras=self.cameras, colour=colour, settings=settings, tell=told_later)
        return told_apart(moments, rig), False

    def named(self) -> dict[str, str]:
        """Return all sources by their flag's name."""
        return {**self.cameras, **({} if self.image is None else {"image": self.image})}
