"""The pictures' socket: each page says how wide it shows them, and all get what the widest needs."""

import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import cast

import pytest
import uvicorn
from fastapi import FastAPI
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from armsight.app.live.station import MeasurementProcess, Snapshot
from armsight.app.live.views import Counts, LiveView, SideView
from armsight.console.routes import WIDEST_PX, add_pictures
from armsight.console.state import Console
from armsight.records import PoseStatus, Spots, TargetPose

UNSEEN = TargetPose(t_s=0.0, status=PoseStatus.LOST, parent="rig")
NO_SPOTS = (Spots.none(), Spots.none())


class PartialRequest:
    """A station that has something new at every look, and keeps the widths that it is asked for."""

    def __init__(self) -> None:
        self.widths_px: list[int] = []

    @property
    def shown(self) -> Snapshot:
        side = SideView(
            width=640, height=480, spots=[], epipolar=[], advice="good", background=0.0, brightest=0.0, sigma_px=None
        )
        view = LiveView(
            sequence=0, t_s=0.0, fps=30.0, latency_s=0.0, measuring_s=0.0, status="lost", why="", parent="rig",
            xyz_m=None, euler_rad=None, quat_xyzw=None, std=None, residual_px=None,
            counts=Counts(ok=0, doubtful=0, position_only=0, lost=1), cameras={"left": side, "right": side},
        )  # fmt: skip
        return Snapshot(pose=UNSEEN, spots=NO_SPOTS, view=view, jpegs={"left": b"left", "right": b"right"})

    def show_width(self, width_px: int) -> None:
        self.widths_px.append(width_px)


@pytest.fixture
def served(tmp_path: Path) -> Iterator[tuple[str, PartialRequest]]:
    console, station, pages = Console(folder=tmp_path), PartialRequest(), FastAPI()
    console.station = cast(MeasurementProcess, station)
    add_pictures(pages, console)
    listener = socket.create_server(("127.0.0.1", 0))
    server = uvicorn.Server(uvicorn.Config(pages, log_level="error", ws="websockets-sansio"))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
    thread.start()
    yield f"ws://127.0.0.1:{listener.getsockname()[1]}/console/pictures", station
    server.should_exit = True
    thread.join(30.0)


def picture(page: ClientConnection, width: str | bytes) -> bytes:
    """Ask for the next picture as a page of that width does."""
    page.send(width)
    return bytes(page.recv(timeout=30.0, decode=False))


def test_the_widest_page_is_what_counts_until_it_goes(served: tuple[str, PartialRequest]) -> None:
    address, station = served
    with connect(f"{address}/left") as small:
        assert picture(small, "390").endswith(b"left")
        with connect(f"{address}/right") as large:
            assert picture(large, "900").endswith(b"right")
            picture(small, "400")
            assert station.widths_px == [390, 900, 900]
        assert any(picture(small, "410") and station.widths_px[-1] == 410 for _ in range(100)), "the large one is gone"


def test_a_width_that_is_none_is_every_width(served: tuple[str, PartialRequest]) -> None:
    address, station = served
    with connect(f"{address}/left") as page:
        for said in ("next", "0", "-5", "1e3", "9" * 30, "9" * 5000, "²", "٣٩٠", b"390", ""):
            picture(page, "390")
            picture(page, said)
            assert station.widths_px[-2:] == [390, WIDEST_PX], said


def test_a_side_that_is_none_is_refused(served: tuple[str, PartialRequest]) -> None:
    address, _ = served
    with pytest.raises(InvalidStatus), connect(f"{address}/top"):
        pass
