"""Locked settings of live cameras: what the driver is told, and cameras that keep their automatics."""

from __future__ import annotations

from itertools import islice

import cv2
import numpy as np
import pytest

from armsight.clock import ManualClock
from armsight.drivers import CameraSettings, OpenCvCamera
from armsight.drivers.live import SETTLED
from armsight.errors import DeviceFailed
from refusals import refuses

ALL = CameraSettings(exposure_s=0.004, gain=20.0, focus=35.0, white_balance_k=4600.0)


class Wire:
    """A camera as Video4Linux shows one: a property set is a property read back, but for those that are stubborn."""

    def __init__(self, stubborn: dict[int, float] | None = None, later: dict[int, float] | None = None) -> None:
        self.values = {
            cv2.CAP_PROP_AUTO_EXPOSURE: 3.0,
            cv2.CAP_PROP_EXPOSURE: 333.0,
            cv2.CAP_PROP_GAIN: 64.0,
            cv2.CAP_PROP_AUTOFOCUS: 1.0,
            cv2.CAP_PROP_FOCUS: 0.0,
            cv2.CAP_PROP_AUTO_WB: 1.0,
            cv2.CAP_PROP_WB_TEMPERATURE: 5000.0,
        }
        self.stubborn, self.later = stubborn or {}, later or {}
        self.values |= self.stubborn
        self.reads, self.released, self.sets = 0, False, 0

    def isOpened(self) -> bool:
        return True

    def getBackendName(self) -> str:
        return "V4L2"

    def read(self):
        self.reads += 1
        if self.reads == 10:
            self.values |= self.later
        return True, np.zeros((4, 6, 3), np.uint8)

    def get(self, key: int, /) -> float:
        return self.values.get(key, -1.0)

    def set(self, key: int, value: float, /) -> bool:
        self.sets += 1
        if key in self.stubborn:
            return False
        self.values[key] = value
        return True

    def release(self) -> None:
        self.released = True


def camera(wire: Wire, settings: CameraSettings = ALL) -> OpenCvCamera:
    return OpenCvCamera("0", clock=ManualClock(), settings=settings, open_capture=lambda _: wire)


def test_everything_asked_for_is_set_with_its_automatic_off() -> None:
    wire = Wire()
    with camera(wire) as source:
        next(iter(source))
    assert wire.values == {
        cv2.CAP_PROP_AUTO_EXPOSURE: 1.0,
        cv2.CAP_PROP_EXPOSURE: 40.0,  # in 0.1 ms
        cv2.CAP_PROP_GAIN: 20.0,
        cv2.CAP_PROP_AUTOFOCUS: 0.0,
        cv2.CAP_PROP_FOCUS: 35.0,
        cv2.CAP_PROP_AUTO_WB: 0.0,
        cv2.CAP_PROP_WB_TEMPERATURE: 4600.0,
    }


@pytest.mark.parametrize(
    ("stubborn", "flag"),
    [
        ({cv2.CAP_PROP_AUTO_EXPOSURE: 3.0}, "--exposure stays automatic"),
        ({cv2.CAP_PROP_EXPOSURE: 333.0}, "--exposure reads back 0.0333"),
        ({cv2.CAP_PROP_FOCUS: 0.0}, "--focus reads back 0"),
        ({cv2.CAP_PROP_WB_TEMPERATURE: -1.0}, "--white-balance reads back -1"),
    ],
)
def test_a_camera_that_does_otherwise_is_refused_and_closed(stubborn: dict[int, float], flag: str) -> None:
    wire = Wire(stubborn)
    with pytest.raises(DeviceFailed) as info, camera(wire):
        pass
    assert flag in info.value.cause
    assert "measured" in info.value.consequence
    assert info.value.cure
    assert wire.released


def test_a_camera_that_takes_to_its_automatic_while_it_runs_is_found_out() -> None:
    wire = Wire(later={cv2.CAP_PROP_AUTO_EXPOSURE: 3.0})
    with refuses(DeviceFailed, "--exposure", "automatic"), camera(wire) as source:
        list(islice(source, SETTLED + 1))
