"""One client that floods a robot server, for benchmarks/stops.py; it needs nothing but Python, and begins at once.

FLOOD_TOKEN=... python benchmarks/flooding.py KIND PORT PATH
"""

from __future__ import annotations

import base64
import os
import socket
import struct
import sys
import threading
import time
from contextlib import suppress


def frame(text: bytes) -> bytes:
    head = bytes([0x81]) + (bytes([0x80 | len(text)]) if len(text) < 126 else b"\xfe" + struct.pack("!H", len(text)))
    return head + b"\0\0\0\0" + text


def flooding(kind: str, port: int, path: str, token: str) -> None:
    """Flood one port; connect again whenever it is closed."""
    key = base64.b64encode(os.urandom(16)).decode()
    head = (
        f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\nAuthorization: Bearer {token}\r\n\r\n"
    ).encode()
    held: list[socket.socket] = []
    os.setsid()  # Linux shares the processors between sessions first: flooders of other machines would take none
    while True:
        with suppress(OSError, ValueError, IndexError):
            link = socket.create_connection(("127.0.0.1", port), timeout=1.0)
            if kind == "half a request":
                link.sendall(head[: len(head) // 2])
                held = [*held[-299:], link]
                time.sleep(0.002)
                continue
            link.sendall(head)
            hello = link.recv(65536)
            if kind == "connects anew":
                link.close()
                continue
            while b"session" not in hello:
                hello += link.recv(65536)
            session = hello.split(b'"session":"')[1][:32].decode()
            if kind != "takes no answers":
                threading.Thread(target=drain, args=(link,), daemon=True).start()
            number = 0
            while True:
                if kind in ("reads", "takes no answers"):
                    texts = [f'{{"type":"read","session":"{session}","seq":{number + i + 1}}}' for i in range(200)]
                    number += 200
                elif kind == "no messages":
                    texts = ["{" * 20] * 200
                else:
                    texts = [" " * 16_000] * 10
                link.sendall(b"".join(frame(text.encode()) for text in texts))


def drain(link: socket.socket) -> None:
    with suppress(OSError):
        while link.recv(262_144):
            pass


if __name__ == "__main__":
    flooding(sys.argv[1], int(sys.argv[2]), sys.argv[3], os.environ["FLOOD_TOKEN"])
