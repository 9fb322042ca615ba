"""Servers of QTM and Motive for tests: their packets, laid out as the makers' protocols say."""

import socket
import struct
import threading

import numpy as np
from scipy.spatial.transform import Rotation

N = 30
BODIES = ("Base", "Flange")
LOST = {4, 5}
R = Rotation.from_rotvec(np.outer(np.linspace(0.1, 2.0, N), [0.3, -0.5, 0.8]))
T_M = np.stack([np.linspace(-1.0, 1.0, N), np.full(N, 0.25), np.linspace(0.5, 0.9, N)], axis=1)


class Qtm(threading.Thread):
    """QTM's real-time protocol 1.x, little endian: size, type, content."""

    def __init__(self, rotations=R, places_m=T_M):
        super().__init__(daemon=True)
        self.R, self.t = rotations, places_m
        self.socket = socket.create_server(("127.0.0.1", 0))
        self.port = self.socket.getsockname()[1]
        self.ending = threading.Event()

    def run(self):
        link, _ = self.socket.accept()
        with link:
            self.send(link, 1, b"QTM RT Interface connected\0")
            while not self.ending.is_set():
                head = link.recv(8, socket.MSG_WAITALL)
                if len(head) < 8:
                    return
                said = link.recv(struct.unpack("<II", head)[0] - 8, socket.MSG_WAITALL).rstrip(b"\0").lower()
                if said.startswith(b"version"):
                    self.send(link, 1, b"Version set to 1.25\0")
                elif said.startswith(b"getparameters"):
                    names = "".join(f"<Body><Name>{name}</Name></Body>" for name in BODIES)
                    self.send(link, 2, f"<QTM_Parameters><The_6D>{names}</The_6D></QTM_Parameters>\0".encode())
                elif said.startswith(b"streamframes all"):
                    for k in range(N):
                        self.send(link, 3, self.frame(k))
                    return  # QTM ends

    @staticmethod
    def send(link, kind, content):
        link.sendall(struct.pack("<II", 8 + len(content), kind) + content)

    def frame(self, k):
        nothing = [np.nan] * 12
        flange = (
            nothing if k in LOST else [*(1e3 * self.t[k]), *self.R[k].as_matrix().T.ravel()]
        )  # mm, column by column
        bodies = struct.pack("<24f", *[10.0, 20.0, 30.0, *np.eye(3).ravel()], *flange)
        component = struct.pack("<IIihh", 16 + len(bodies), 5, 2, 0, 0) + bodies
        return struct.pack("<qII", 1_000_000 + 10_000 * k, k, 1) + component


GROUP = "239.255.42.99"


class Motive(threading.Thread):
    """NatNet 3.1: number, size, content; frames follow the definitions, to each that asks or to a group: the first
    again and again until it is known that they are heard."""

    def __init__(self, rotations=R, places_m=T_M, *, multicast=False):
        super().__init__(daemon=True)
        self.multicast = multicast
        self.R, self.t = rotations, places_m
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.05)
        self.socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        self.port = self.socket.getsockname()[1]
        self.group = GROUP, self.port + 1
        self.ending, self.heard = threading.Event(), threading.Event()
        self.k = 0

    def run(self):
        streaming = None
        while not self.ending.is_set():
            try:
                data, asker = self.socket.recvfrom(65536)
            except TimeoutError:
                data, asker = b"", None
            kind = struct.unpack("<H", data[:2])[0] if data else None
            if kind == 0:
                info = b"Motive".ljust(256, b"\0") + bytes([3, 0, 0, 0, 3, 1, 0, 0])
                self.send(asker, 1, info)
            elif kind == 4:
                self.send(asker, 5, self.definitions())
                streaming = asker
            if streaming and self.k < N:
                self.send(self.group if self.multicast else streaming, 7, self.frame(self.k))
                self.k += self.heard.is_set()

    def send(self, to, kind, content):
        self.socket.sendto(struct.pack("<HH", kind, len(content)) + content, to)

    @staticmethod
    def definitions():
        out = struct.pack("<I", 2)
        for number, name in enumerate(BODIES, 7):
            out += struct.pack("<I", 1) + name.encode() + b"\0" + struct.pack("<II3fI", number, 0, 0, 0, 0, 0)
        return out

    def frame(self, k):
        out = struct.pack("<III", k, 0, 0)  # number, marker sets, unlabelled markers
        out += struct.pack("<I", 2)
        still = struct.pack("<I3f4ffH", 7, 1.0, 2.0, 3.0, 0, 0, 0, 1, 1e-4, 1)
        out += still + struct.pack("<I3f4ffH", 8, *self.t[k], *self.R[k].as_quat(), 1e-4, 0 if k in LOST else 1)
        out += struct.pack("<IIII", 0, 0, 0, 0)  # skeletons, labelled markers, force plates, devices
        return out + struct.pack("<IIdQQQH", 0, 0, 1.0 + 0.01 * k, 1, 2, 3, 0)
