"""The zoom of live cameras on a fake wire, and of simulated ones."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from armsight.clock import ManualClock
from armsight.drivers import AUTOMATIC, CameraSettings, OpenCvCamera, open_source
from armsight.drivers.aravis import AravisCamera
from armsight.drivers.camera_settings import ZOOM_S
from armsight.drivers.live import SETTLED
from armsight.errors import DeviceFailed, UsageError
from armsight.ops.simulation import scenarios
from armsight.ops.simulation.scenarios import VIEW
from armsight.ops.sources.cameras import open_rig
from armsight.optics import SIDES
from armsight.store.yamls import parse_yaml
from armsight_sim.scenario_builder import build_world
from armsight_sim.scenario_schema import Scenario
from refusals import refuses


class Wire:
    """A camera with a motor that takes whole steps from 100 to 500.

    stuck: it takes the order and stays. falls: how far it goes back once frames flow.
    """

    def __init__(self, *, takes: bool = True, stuck: bool = False, falls: float = 0.0) -> None:
        self.takes, self.stuck, self.falls, self.zoom, self.released, self.reads = takes, stuck, falls, 100.0, False, 0

    def isOpened(self) -> bool:
        return True

    def set(self, key: int, value: float, /) -> bool:
        assert key == cv2.CAP_PROP_ZOOM
        if self.takes and not self.stuck:
            self.zoom = float(round(value))
        return self.takes

    def get(self, key: int, /) -> float:
        return self.zoom if key == cv2.CAP_PROP_ZOOM else 0.0

    def getBackendName(self) -> str:
        return "V4L2"

    def read(self) -> tuple[bool, np.ndarray]:
        self.reads += 1
        self.zoom -= self.falls if self.reads == 10 else 0.0
        return True, np.full((4, 6, 3), int(self.zoom / 10.0), np.uint8)

    def release(self) -> None:
        self.released = True


def opened(wire: Wire, zoom: float | None) -> Callable[[], OpenCvCamera]:
    asked = CameraSettings(zoom=zoom)
    return lambda: OpenCvCamera("0", clock=ManualClock(), open_capture=lambda _: wire, settings=asked)


def test_the_first_frame_is_of_the_zoom_that_was_set() -> None:
    with opened(Wire(), 250.0)() as camera:
        assert next(iter(camera)).image[0, 0] == 25
    with opened(Wire(), None)() as camera:
        assert next(iter(camera)).image[0, 0] == 10


@pytest.mark.parametrize(
    ("wire", "why"),
    [(Wire(takes=False), ("--set-zoom 250", "not taken")), (Wire(stuck=True), ("--set-zoom", "100", "250"))],
)
def test_a_camera_that_does_not_zoom_is_refused_and_closed(wire: Wire, why: str) -> None:
    with refuses(DeviceFailed, why) as info, opened(wire, 250.0)():
        pass
    assert wire.released
    assert info.value.consequence and "--set-zoom" in info.value.cure


@pytest.mark.parametrize("zoom", [250.4, 250.0])
def test_half_a_step_is_all_that_a_zoom_may_be_off(zoom: float) -> None:
    with opened(Wire(), zoom)() as camera:
        assert next(iter(camera)).image[0, 0] == 25
    with refuses(DeviceFailed, "--set-zoom", "249"), opened(Wire(falls=1.0), 250.0)() as camera:
        list(islice(camera, SETTLED + 1))  # looked at again once frames flow; 1 in 250 would do for an exposure


def test_a_zoom_that_is_no_number_when_read_back_is_refused() -> None:
    wire = Wire()
    wire.get = lambda key: float("nan")  # type: ignore[method-assign]
    with refuses(DeviceFailed, "nan"), opened(wire, 250.0)():
        pass


def test_the_motor_gets_its_time_before_the_zoom_is_read_back() -> None:
    wire, clock = Wire(), ManualClock()
    begun_s, there = clock.now_s(), wire.get
    read_at_s: list[float] = []

    def get(key: int, /) -> float:
        read_at_s.append(clock.now_s())
        return there(key)

    wire.get = get  # type: ignore[method-assign]
    with OpenCvCamera("0", clock=clock, open_capture=lambda _: wire, settings=CameraSettings(zoom=250.0)):
        pass
    assert min(read_at_s) >= begun_s + ZOOM_S


def test_each_camera_of_a_pair_gets_its_own_zoom(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, CameraSettings] = {}

    def make(
        device: str, *, colour: bool, clock: object, origin_s: float, settings: CameraSettings = AUTOMATIC
    ) -> None:
        asked[device] = settings

    monkeypatch.setattr("armsight.drivers.opening.load", lambda *_: make)
    left, right = CameraSettings(zoom=100.0, gain=2.0), CameraSettings(zoom=300.0, gain=2.0)
    open_rig(SIDES, "camera:mine:1", "camera:mine:2", settings=(left, right))
    assert asked == {"1": left, "2": right}
    open_rig(SIDES, "camera:mine:1", "camera:mine:2", settings=left)
    assert asked == {"1": left, "2": left}


def test_what_is_not_live_and_what_sets_no_zoom_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    zoomed = CameraSettings(zoom=100.0)
    for refused in (
        lambda: open_source("folder", settings=zoomed),
        lambda: open_rig(SIDES, "a", "b", settings=(AUTOMATIC, zoomed)),
    ):
        with refuses(UsageError, "--set-zoom", "live"):
            refused()
    monkeypatch.setattr("armsight.drivers.opening.load", lambda *_: lambda device, *, colour, clock, origin_s: None)
    with refuses(UsageError, "camera:mine:1", "--set-zoom"):
        open_source("camera:mine:1", settings=zoomed)
    with refuses(UsageError, "camera:aravis:x", "--set-zoom"):
        AravisCamera("x", settings=zoomed)


def scenario(zoom: str) -> Scenario:
    return Scenario.model_validate(content(zoom))


def content(zoom: str) -> dict[str, Any]:
    from importlib.resources import files

    text = (files("armsight_sim") / "scenarios/webcam-cell.yaml").read_text()
    cell: dict[str, Any] = parse_yaml(text.encode(), "webcam-cell")
    cell["room"] = "dark"
    for side in ("left", "right"):
        cell["cameras"][side].pop("distortion", None)
        if zoom:
            cell["cameras"][side]["zoom"] = parse_yaml(zoom.encode(), "zoom")
    return cell


def test_a_simulated_camera_zooms() -> None:
    focal = [
        build_world(scenario("ratio: 4.0"), frames=1, zoom=zoom).rig["cameras"]["left"]["fx"]
        for zoom in (100.0, 300.0, 500.0)
    ]
    assert focal[0] < focal[1] < focal[2]
    assert focal[2] / focal[0] == pytest.approx(4.0, rel=0.02)  # but for the breathing of the focus


def test_a_simulated_live_camera_is_zoomed_by_its_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "zoom.yaml"
    path.write_text(yaml.safe_dump(content("ratio: 4.0")))
    load = scenarios.load
    monkeypatch.setattr(  # the world itself in place of the camera that looks at it
        scenarios, "load", lambda group, name: (lambda world, *_: world) if name == VIEW else load(group, name)
    )
    world: Any = open_source(f"camera:sim:{path}:left", settings=CameraSettings(zoom=300.0))
    expected = build_world(scenario("ratio: 4.0"), frames=1, zoom=300.0)
    assert world.rig["cameras"]["left"]["fx"] == expected.rig["cameras"]["left"]["fx"]
    with refuses(UsageError, "--focus") as info:
        open_source(f"camera:sim:{path}:left", settings=CameraSettings(zoom=300.0, focus=1.0))
    assert "--set-zoom" in info.value.cure


def test_a_scenario_without_zoom_lens_and_a_zoom_beyond_its_ends_are_refused() -> None:
    from armsight.errors import Inconsistent

    with refuses(Inconsistent, "zoom lens"):
        build_world(scenario(""), frames=1, zoom=100.0)
    with refuses(Inconsistent, "100", "500", "501"):
        build_world(scenario("ratio: 4.0"), frames=1, zoom=501.0)
