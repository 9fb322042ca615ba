"""The emulated controllers of ABB and Universal Robots as the command starts them."""

from __future__ import annotations

import itertools
import os
import socket

import numpy as np
import pytest

from armsight.clock import ManualClock
from armsight.drivers.egm import parse
from armsight.errors import ArmsightError, DeviceFailed, UsageError
from armsight.geometry import is_close
from armsight_sim.twins.base import HOME, small_arm
from armsight_sim.twins.egm import EgmTwin
from armsight_sim.twins.rtde import RtdeTwin
from refusals import refuses

SLIDE = {"joints": [{"name": "j1", "type": "prismatic", "a_m": 0.0, "alpha_rad": 0.0, "d_m": 0.0, "theta_rad": 0.0}]}


def times(n: int) -> object:
    left = itertools.count(n, -1)
    return lambda: next(left) > 0


def test_the_abb_controller_sends_one_state_a_cycle_that_the_driver_reads() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as driver:
        driver.bind(("127.0.0.1", 0))
        driver.settimeout(5.0)
        port = driver.getsockname()[1]
        with EgmTwin(port=str(port), clock=ManualClock()) as twin:
            assert twin.address == f"egm:{port}"
            twin.run(times(5))  # type: ignore[arg-type]
            packets = [parse(driver.recv(4096), 6) for _ in range(5)]
    assert [packet.sequence for packet in packets] == [0, 1, 2, 3, 4]
    assert np.all(np.diff([packet.tm_ms for packet in packets]) == 4)
    for packet in packets:
        assert np.abs(packet.q - HOME).max() <= 0.5e-5 + 1e-12
        assert packet.why_still == ""
        assert packet.T_base_flange is not None
        assert is_close(packet.T_base_flange, small_arm().flange(packet.q), tol_m=2e-5, tol_rad=5e-5)


def test_the_controller_of_universal_robots_listens_where_it_says() -> None:
    host = f"127.8.{os.getpid() // 250 % 250}.{os.getpid() % 250}"
    with RtdeTwin(port=f"{host}:41234", clock=ManualClock()) as twin:
        assert twin.address == f"rtde:{host}:41234"
        for port in (41234, 41233, 41232, 41229):
            socket.create_connection((host, port)).close()
        twin.run(times(3))  # type: ignore[arg-type]
        assert twin.server.controller.time_s == pytest.approx(0.006)
    with refuses(DeviceFailed, "not open"):
        _ = twin.server


@pytest.mark.parametrize(
    ("kind", "more"),
    [
        (EgmTwin, {"connect": "nowhere"}),
        (EgmTwin, {"port": "1", "connect": "a:2"}),
        (EgmTwin, {"arm": SLIDE}),
        (EgmTwin, {"cycle_s": 5.0}),
        (RtdeTwin, {"connect": "a:2"}),
        (RtdeTwin, {"port": "x"}),
        (RtdeTwin, {"arm": SLIDE}),
    ],
)
def test_what_cannot_be_is_refused(kind: type, more: dict[str, object]) -> None:
    with pytest.raises(UsageError) as caught:
        kind(**more)
    assert isinstance(caught.value, ArmsightError)
