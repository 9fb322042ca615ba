"""The emulated controllers of ABB and Universal Robots as the command starts them."""

from __future__ import annotations

import itertools
import socket

import numpy as np

from armsight.clock import ManualClock
from armsight.drivers.egm import parse
from armsight.geometry import is_close
from armsight_sim.twins.base import HOME, small_arm
from armsight_sim.twins.egm import EgmTwin


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
