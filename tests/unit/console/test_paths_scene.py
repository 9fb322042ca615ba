"""What is sent to the 3-D view: taught path, measured track and the tool's way, each from its own source."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from nicegui import Client, ui
from tests.unit.console.test_console_state import view

from armsight.app.operator.robot_cell import prepare_simulated, read_placement
from armsight.console.plots import APART_M, POINTS, Ticks, Tracks
from armsight.console.scene import Scene
from armsight.console.state import Console
from armsight.ops.arm_files import load_arm
from armsight.ops.requests.motion import RobotJob


class Page:
    """A scene on a page, its robot's joints, and what is sent to the browser."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        prepare_simulated(RobotJob(robot="sim:webcam-cell"), folder)
        self.arm = load_arm(str(folder / "arm.yaml"))
        self.q = np.array([0.1, -1.2, 1.4, -0.3, 0.2, 0.0])
        robot = SimpleNamespace(session=SimpleNamespace(arm=self.arm), joints=lambda: self.q)
        self.console = Console.of_folder(folder, robot)  # type: ignore[arg-type]
        self.sent: list[tuple[str, list[Any]]] = []
        self.scene = Scene(self.console)
        monkeypatch.setattr(ui.scene, "run_method", lambda scene, *said, **_: self._send(scene, *said))

    def _send(self, scene: Any, name: str, *args: Any) -> None:
        if name == "run_method_on_component":
            self.sent.append((scene.objects[args[0]].name, args[2]))

    def newest(self, name: str) -> Any:
        """The places of a curve as last sent."""
        return np.array([places for curve, places in self.sent if curve == f"curve-{name}"][-1])


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Page]:
    with Client(ui.page("/"), request=None):
        yield Page(tmp_path, monkeypatch)


def test_three_curves_are_sent_each_from_its_own_source(page: Page) -> None:
    T_world_rig = read_placement(page.console.folder, page.console.cell).rig_pose(page.arm, page.q)
    assert T_world_rig is not None
    seen = np.array([[0.0, 0.01 * i, 0.8] for i in range(5)])
    tool = [page.arm.fk(page.arm.values(page.q))[:3, 3]]
    for xyz in seen:
        page.q = page.q + 0.01
        tool.append(page.arm.fk(page.arm.values(page.q))[:3, 3])
        page.scene.show(replace(view(30.0), xyz_m=tuple(xyz)))
    page.scene.show_track()
    taught = np.array([[0.4, 0.0, 0.2], [0.4, 0.1, 0.2], [0.4, 0.1, 0.3]])
    page.scene.show_path(taught)
    for name, truth in (("taught", taught), ("measured", T_world_rig.apply(seen)), ("tool", tool)):
        assert np.allclose(page.newest(name), truth, atol=1e-5), name
    sent = len(page.sent)
    page.scene.show_track()
    page.scene.show_path(taught)
    assert len(page.sent) == sent, "the same is not sent again"


def test_a_page_loaded_anew_has_the_tracks_of_the_one_before_and_other_cameras_begin_anew(page: Page) -> None:
    page.scene.show(view(30.0))
    page.q = page.q + 0.1
    page.scene.show(view(30.0))
    anew = Scene(page.console)
    anew.show_track()
    assert (len(page.newest("measured")), len(page.newest("tool"))) == (1, 2)
    page.console.close()
    assert not page.console.tracks.measured and not page.console.tracks.tool


def test_a_target_at_rest_does_not_push_its_track_out() -> None:
    tracks, rng = Tracks(), np.random.default_rng(1)
    way = np.array([[0.002 * i, 0.0, 0.5] for i in range(50)])
    for xyz in way:
        tracks.add_measured(xyz, 1e-4)
    for _ in range(2 * POINTS):
        tracks.add_measured(way[-1] + rng.uniform(-0.3, 0.3, 3) * APART_M, 1e-4)
    assert np.allclose([place for place, _ in tracks.measured], way)


@pytest.mark.parametrize("span_mm", [0.0, 7.0, 1300.0])
def test_axes_hold_the_curves_with_the_same_round_step_on_each(span_mm: float) -> None:
    places = 1e-3 * np.array([[-912.3, 14.2, 254.9], [-912.3 + span_mm, 14.2, 254.9 + 0.4 * span_mm]])
    ticks = Ticks.about(places)
    low, high = np.array(ticks.low_mm), np.array(ticks.high_mm)
    assert (low <= 1e3 * places).all() and (1e3 * places <= high).all() and (high > low).all()
    assert not (low % ticks.step_mm).any() and not (high % ticks.step_mm).any()
    assert str(ticks.step_mm).rstrip("0") in {"1", "2", "5"} and (high - low).max() / ticks.step_mm <= 9
