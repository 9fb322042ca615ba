"""OptiTrack Motive, live, by NatNet: `natnet:HOST[:PORT][:unicast]`.

Rigid bodies in m, quaternions X, Y, Z, W, and whether each is tracked in this frame; names stand in the model
definitions, by number (NatNet SDK; the package natnet). The time is the frame's, s of Motive. Motive sends to a group
of computers (multicast 239.255.42.99, on the port after that of commands) or, where that is set, to each that asks
(unicast).
"""

from __future__ import annotations

import socket
import threading
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.drivers.trackers.source import BodyStream, host_and_port, not_there
from armsight.errors import DeviceNotFound

COMMAND_PORT = 1510
ANSWER_S = 5.0
UNICAST = ":unicast"


class NatNetStream(BodyStream):
    """A rigid body of Motive in real time."""

    def __init__(self, device: str, *, body: str, std_m: float, std_rad: float) -> None:
        super().__init__(device, body=body, std_m=std_m, std_rad=std_rad)
        self._unicast = device.endswith(UNICAST)
        self._host, self._port = host_and_port(device.removesuffix(UNICAST), COMMAND_PORT)
        self._client: Any = None
        self._number: int | None = None
        self._described, self._streams = threading.Event(), threading.Event()
        self._bodies: dict[int, str] = {}

    def _opened(self) -> None:
        try:
            import natnet
        except ImportError as error:
            raise not_there("natnet") from error
        client = natnet.NatNetClient(
            server_ip_address=self._host,
            local_ip_address=_own_address(self._host, self._port),
            command_port=self._port,
            data_port=self._port + 1,
            use_multicast=not self._unicast,
        )
        try:
            client.connect(timeout=ANSWER_S)
        except (OSError, natnet.NatNetError) as error:
            raise self._silent(error) from error
        self._client = client
        client.on_data_description_received_event.handlers.append(self._describe)
        client.on_data_frame_received_event.handlers.append(self._take)
        client.run_async()
        client.request_modeldef()
        if not self._described.wait(ANSWER_S):
            raise self._silent("it does not say which bodies it has")
        numbers = list(self._bodies)
        self._number = numbers[self.chosen(list(self._bodies.values()))]
        if not self._streams.wait(ANSWER_S):
            to = "this computer" if self._unicast else f"the group {client.multicast_address}, port {client.data_port}"
            raise self._silent(f"it names its bodies, and sends no frame to {to}")

    def _silent(self, error: object) -> DeviceNotFound:
        return DeviceNotFound(
            f"Motive at {self._host}:{self._port} does not stream: {error or type(error).__name__}",
            consequence="Nothing was done",
            cure=f"Set Motive's streaming to NatNet and this network, and its data port to the one after its command "
            f"port; {UNICAST} where it sends to each that asks",
        )

    def _describe(self, described: Any) -> None:
        self._bodies = {body.id_num: body.name or "" for body in described.rigid_bodies}
        self._described.set()

    def _take(self, frame: Any) -> None:
        self._streams.set()
        if self._number is None:
            return
        t_s, sequence = frame.suffix.timestamp, frame.prefix.frame_number
        body = next((one for one in frame.rigid_bodies if one.id_num == self._number), None)
        if body is None or body.tracking_valid is False or not np.any(body.rot):
            self.put(t_s, sequence, None, None)
            return
        self.put(t_s, sequence, np.array(body.pos), Rotation.from_quat(body.rot).as_matrix())

    def _closed(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            client.shutdown()


def _own_address(host: str, port: int) -> str:
    """Return the address of this computer that reaches a host. Raises DeviceNotFound for a host that is not known."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect((host, port))
            return str(probe.getsockname()[0])
    except OSError as error:
        raise DeviceNotFound(f"the computer {host} is not known: {error}", cure="Give its address") from error
