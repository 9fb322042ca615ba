"""Cameras that share a USB bus, and whether it carries them all: what fails first where there are many webcams.

As Linux tells it in /sys; elsewhere nothing is known, and nothing is said.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

SYS = Path("/sys")

PERIODIC = {480.0: 0.8 * 480.0, 5000.0: 0.8 * 0.8 * 5000.0}
"""Mbit/s that pictures may take of a bus of such Mbit/s: 80 % is the most for what comes periodically (USB 2.0, 5.5.4;
USB 3.2, 4.4.8), of USB 3 after the 8b/10b code. Cameras of USB 2 share the 480 Mbit/s also on sockets of USB 3."""

UNTOLD_MBIT_S = 640 * 480 * 16 * 30 / 1e6
"""What a camera is taken to need that does not tell: two bytes a pixel, which OpenCV asks for, 30 times a second."""

OPENED = (640, 480)
"""The size in which OpenCV opens a camera that is asked for none."""

STREAMING = (14, 2)
"""Class and subclass of a video streaming interface (USB Video Class 1.5, A.1 and A.2)."""

INTERFACE, CLASS_SPECIFIC, UNCOMPRESSED, COMPRESSED = 0x04, 0x24, 0x05, 0x07
"""Kinds of descriptors, and of frames in them (USB Video Class 1.5, A.6)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UsbCamera:
    """device: such as video0. bus: controller and root hub. bus_mbit_s: its rate. needs_mbit_s: of the pictures."""

    device: str
    product: str
    bus: str
    bus_mbit_s: float
    needs_mbit_s: float


def usb_cameras(sys: Path | None = None) -> tuple[UsbCamera, ...]:
    """Return the cameras on USB, as the folder /sys tells of them."""
    found = []
    for video in sorted(
        ((sys or SYS) / "class" / "video4linux").glob("video*"), key=lambda it: (len(it.name), it.name)
    ):
        if _text(video / "index") not in ("", "0"):
            continue  # a camera's second device has no pictures, but what belongs to them
        device = (video / "device").resolve().parent  # the link leads to one of its interfaces
        root = next((one for one in device.parents if one.name.startswith("usb") and (one / "speed").exists()), None)
        if root is None:
            continue
        needs = picture_mbit_s(_bytes(device / "descriptors"))
        found.append(
            UsbCamera(
                device=video.name,
                product=_text(device / "product") or video.name,
                bus=f"{root.name} of {root.parent.name}",
                bus_mbit_s=float(_text(root / "speed") or 0.0),
                needs_mbit_s=UNTOLD_MBIT_S if needs is None else needs,
            )
        )
    return tuple(found)


def picture_mbit_s(descriptors: bytes) -> float | None:
    """Return what a camera's pictures take in Mbit/s as OpenCV opens it, from its descriptors; None where untold.

    That is uncompressed and OPENED, else the first size; where it has compressed pictures alone, at most what it says.
    """
    frames: dict[tuple[int, tuple[int, int]], float] = {}
    for kind, body in _descriptors(descriptors):
        if kind not in (UNCOMPRESSED, COMPRESSED) or len(body) < 26:
            continue
        size = struct.unpack_from("<HH", body, 5)
        most_bit_s, frame_bytes, interval = struct.unpack_from("<III", body, 13)
        raw = 8.0 * frame_bytes * 1e7 / interval if interval else 0.0  # the interval counts 100 ns
        frames.setdefault((kind, size), (raw if kind == UNCOMPRESSED else float(most_bit_s)) / 1e6)
    for kind in (UNCOMPRESSED, COMPRESSED):
        of_kind = {size: needs for (one, size), needs in frames.items() if one == kind}
        if of_kind:
            return of_kind.get(OPENED, next(iter(of_kind.values())))
    return None


def _descriptors(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield subtype and bytes of what is said of video streams; it ends where the lengths make no sense."""
    at, streaming = 0, False
    while at + 3 <= len(data) and data[at] >= 3:
        body = data[at : at + data[at]]
        if body[1] == INTERFACE and len(body) >= 7:
            streaming = (body[5], body[6]) == STREAMING
        if streaming and body[1] == CLASS_SPECIFIC:
            yield body[2], body
        at += data[at]


def crowded_buses(cameras: Sequence[UsbCamera], device: str = "") -> list[str]:
    """Return what to know of each bus that cannot carry all of its cameras at once; of the one of a device alone."""
    by_bus: dict[str, list[UsbCamera]] = defaultdict(list)
    for one in cameras:
        by_bus[one.bus].append(one)
    told = []
    for bus, on_it in by_bus.items():
        needs, room = sum(one.needs_mbit_s for one in on_it), PERIODIC.get(on_it[0].bus_mbit_s, 0.0)
        if not room or needs <= room or (device and all(one.device != device for one in on_it)):
            continue
        names = ", ".join(f"{one.device} ({one.product})" for one in on_it)
        told.append(
            f"The cameras {names} share the USB bus {bus}: together their pictures take {needs:.0f} Mbit/s, and it "
            f"carries {room:.0f}. Not all of them start at once. Plug some into sockets of another controller (a hub "
            "adds none), or take cameras that need less"
        )
    return told


def crowd_of(name: str, sys: Path | None = None) -> str:
    """Return why a camera, named by number or file, may get no room on its bus; empty where it has room."""
    device = f"video{name}" if name.isdecimal() else Path(name).resolve().name
    return "".join(crowded_buses(usb_cameras(sys), device))


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:
        return b""


def _text(path: Path) -> str:
    return _bytes(path).decode("utf-8", "replace").strip()
