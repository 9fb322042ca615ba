"""The zoom of live cameras on a fake wire, and of simulated ones."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from armsight.clock import ManualClock
from armsight.drivers import OpenCvCamera, open_source
from armsight.errors import DeviceFailed, UsageError
from armsight.sim.scenario_builder import build_world
from armsight.sim.scenario_schema import Scenario
from armsight.store.yamls import parse_yaml


class Wire:
    """A camera with a motor that takes whole steps from 100 to 500; stuck: it takes the order and stays."""

    def __init__(self, *, takes: bool = True, stuck: bool = False) -> None:
        self.takes, self.stuck, self.zoom, self.released, self.read_at = takes, stuck, 100.0, False, 0

    def isOpened(self) -> bool:
        return True

    def set(self, key: int, value: float, /) -> bool:
        assert key == cv2.CAP_PROP_ZOOM
        if self.takes and not self.stuck:
            self.zoom = float(round(value))
        return self.takes

    def get(self, key: int, /) -> float:
        return self.zoom if key == cv2.CAP_PROP_ZOOM else 0.0

    def read(self) -> tuple[bool, np.ndarray]:
        return True, np.full((4, 6, 3), int(self.zoom / 10.0), np.uint8)

    def release(self) -> None:
        self.released = True


def opened(wire: Wire, zoom: float | None) -> Callable[[], OpenCvCamera]:
    return lambda: OpenCvCamera("0", clock=ManualClock(), open_capture=lambda _: wire, zoom=zoom)


def test_the_first_frame_is_of_the_zoom_that_was_set() -> None:
    with opened(Wire(), 250.0)() as camera:
        assert next(iter(camera)).image[0, 0] == 25
    with opened(Wire(), None)() as camera:
        assert next(iter(camera)).image[0, 0] == 10


@pytest.mark.parametrize(
    ("wire", "why"), [(Wire(takes=False), "does not take it"), (Wire(stuck=True), "stands at 100")]
)
def test_a_camera_that_does_not_zoom_is_refused_and_closed(wire: Wire, why: str) -> None:
    with pytest.raises(DeviceFailed, match=why) as info, opened(wire, 250.0)():
        pass
    assert wire.released
    assert info.value.consequence and "--set-zoom" in info.value.cure


def test_what_is_not_live_and_what_sets_no_zoom_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UsageError, match="no live camera"):
        open_source("folder", zoom=100.0)
    monkeypatch.setattr("armsight.drivers.opening.load", lambda *_: lambda device, *, colour, clock, origin_s: None)
    with pytest.raises(UsageError, match="sets no zoom"):
        open_source("camera:mine:1", zoom=100.0)


def scenario(zoom: str) -> Scenario:
    from importlib.resources import files

    text = (files("armsight") / "sim/scenarios/webcam-cell.yaml").read_text()
    content = parse_yaml(text.encode(), "webcam-cell")
    for side in ("left", "right"):
        content["cameras"][side].pop("distortion", None)
        if zoom:
            content["cameras"][side]["zoom"] = parse_yaml(zoom.encode(), "zoom")
    return Scenario.model_validate(content)


def test_a_simulated_camera_zooms() -> None:
    focal = [
        build_world(scenario("ratio: 4.0"), frames=1, zoom=zoom).rig["cameras"]["left"]["fx"]
        for zoom in (100.0, 300.0, 500.0)
    ]
    assert focal[0] < focal[1] < focal[2]
    assert focal[2] / focal[0] == pytest.approx(4.0, rel=0.02)  # but for the breathing of the focus


def test_a_scenario_without_zoom_lens_and_a_zoom_beyond_its_ends_are_refused() -> None:
    from armsight.errors import Inconsistent

    with pytest.raises(Inconsistent, match="no zoom lens"):
        build_world(scenario(""), frames=1, zoom=100.0)
    with pytest.raises(Inconsistent, match="zooms from 100 to 500, not to 501"):
        build_world(scenario("ratio: 4.0"), frames=1, zoom=501.0)
