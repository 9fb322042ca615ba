"""Which cameras share a USB bus and what they need of it, from a drawn /sys as Linux lays it out."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from armsight.drivers.usb import UNTOLD_MBIT_S, crowd_of, crowded_buses, usb_cameras

DEVICE = bytes([18, 1, 0, 2, 239, 2, 1, 64]) + bytes(10)


def frame(subtype: int, width: int, height: int, fps: float, most_bit_s: int = 0) -> bytes:
    size = struct.pack("<HH", width, height)
    rates = struct.pack("<IIII", 0, most_bit_s, 2 * width * height, round(1e7 / fps))
    body = bytes([subtype, 1, 0]) + size + rates + bytes([1]) + struct.pack("<I", round(1e7 / fps))
    return bytes([len(body) + 2, 0x24]) + body


def described(*frames: bytes, subclass: int = 2) -> bytes:
    return DEVICE + bytes([9, 4, 1, 0, 0, 14, subclass, 0, 0]) + b"".join(frames)


def webcam(fps: float = 30.0) -> bytes:
    """A camera whose control interface, which comes first, has bytes that look like a frame."""
    control = described(frame(5, 640, 480, 1e6), subclass=1)
    return control + described(frame(5, 1280, 720, 15.0), frame(5, 640, 480, fps), frame(7, 640, 480, 30.0))[18:]


class Tree:
    """A /sys with two root hubs, of USB 2 and 3, of one controller, and one more controller."""

    def __init__(self, path: Path) -> None:
        self.path, self._n = path, 0
        (path / "class/video4linux").mkdir(parents=True)
        for hub, speed in (("0000:00:14.0/usb1", "480"), ("0000:00:14.0/usb2", "5000"), ("0000:03:00.0/usb3", "480")):
            self.write(f"devices/pci0000:00/{hub}/speed", speed)

    def write(self, name: str, content: str | bytes) -> None:
        file = self.path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content if isinstance(content, bytes) else f"{content}\n".encode())

    def plug(self, at: str, descriptors: bytes | None, product: str = "HD Webcam") -> None:
        """Plug a camera in: it has two devices, of which the second has no pictures."""
        place = f"devices/pci0000:00/{at}"
        self.write(f"{place}/product", product)
        self.write(f"{place}/speed", "480")
        if descriptors is not None:
            self.write(f"{place}/descriptors", descriptors)
        for index in (0, 1):
            interface = f"{place}/{at.rsplit('/', 1)[1]}:1.0/video4linux/video{self._n}"
            self.write(f"{interface}/index", str(index))
            (self.path / interface / "device").symlink_to(self.path / interface / "../..")
            (self.path / f"class/video4linux/video{self._n}").symlink_to(self.path / interface)
            self._n += 1


@pytest.fixture
def tree(tmp_path: Path) -> Tree:
    return Tree(tmp_path / "sys")


def test_cameras_are_found_with_their_bus_and_what_they_need(tree: Tree) -> None:
    tree.plug("0000:00:14.0/usb1/1-2", webcam())
    tree.plug("0000:00:14.0/usb1/1-1/1-1.4", None, "")  # behind a hub, telling nothing of itself
    tree.plug("0000:00:14.0/usb2/2-3", described(frame(7, 1920, 1080, 30.0, 90_000_000)))
    found = usb_cameras(tree.path)
    assert [(one.device, one.bus.split()[0], one.bus_mbit_s) for one in found] == [
        ("video0", "usb1", 480.0),
        ("video2", "usb1", 480.0),
        ("video4", "usb2", 5000.0),
    ]
    assert [one.needs_mbit_s for one in found] == pytest.approx([147.456, UNTOLD_MBIT_S, 90.0], abs=0.01)
    assert (found[0].product, found[1].product) == ("HD Webcam", "video2")
    assert usb_cameras(tree.path / "nothing") == ()


def test_a_bus_that_cannot_carry_its_cameras_is_told_with_them(tree: Tree) -> None:
    for socket in (1, 2):
        tree.plug(f"0000:00:14.0/usb1/1-{socket}", webcam())
    assert crowded_buses(usb_cameras(tree.path)) == []  # 295 of 384 Mbit/s
    tree.plug("0000:00:14.0/usb1/1-3", webcam())
    tree.plug("0000:03:00.0/usb3/3-1", webcam(), "Other")
    (told,) = crowded_buses(usb_cameras(tree.path))
    assert all(word in told for word in ("video0", "video2", "video4", "442", "384", "another controller"))
    assert "Other" not in told
    assert crowd_of("4", tree.path) == crowd_of("/dev/video4", tree.path) == told
    assert crowd_of("6", tree.path) == ""
