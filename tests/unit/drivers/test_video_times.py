"""Videos whose stamps say more than their number: lost frames, a rate that varies, a late beginning, repeats, turns."""

import struct

import cv2
import numpy as np
import pytest

from armsight.drivers import VideoFile, open_source
from armsight.ops.sources.cameras import open_rig
from armsight.optics import SIDES

PERIOD_MS = 40


SEGMENT, INFO, DURATION, CLUSTER, CLUSTER_TIME, BLOCK = 0x18538067, 0x1549A966, 0x4489, 0x1F43B675, 0xE7, 0xA3


def video(path, at_ms, grey):
    """A Matroska file of small even pictures, one at each time; their grey says which moment it is.

    OpenCV writes it at a steady rate; the times of blocks and the length are then written over where they stand.
    """
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 1000 / PERIOD_MS, (32, 24))
    for level in grey:
        writer.write(np.full((24, 32, 3), level, np.uint8))
    writer.release()
    data, times, began = bytearray(path.read_bytes()), iter(at_ms), 0
    for kind, start, size in elements(data, 0, len(data)):
        if kind == DURATION:
            data[start : start + size] = struct.pack(">d" if size == 8 else ">f", max(at_ms) + PERIOD_MS)
        elif kind == CLUSTER_TIME:
            began = int.from_bytes(data[start : start + size], "big")
        elif kind == BLOCK:  # number of the track in one byte, then the time since the cluster's
            data[start + 1 : start + 3] = struct.pack(">h", next(times) - began)
    assert next(times, None) is None
    path.write_bytes(data)
    return str(path)


def elements(data, at, end):
    """Kind, place and size of the EBML elements between two places, those of the folders that matter gone into."""
    while at < end:
        n = 9 - data[at].bit_length()
        kind = int.from_bytes(data[at : at + n], "big")
        at += n
        n = 9 - data[at].bit_length()
        size = int.from_bytes(data[at : at + n], "big") - (1 << 7 * n)
        at += n
        size = min(size, end - at)  # of a segment that states none
        if kind in (SEGMENT, INFO, CLUSTER):
            yield from elements(data, at, at + size)
        else:
            yield kind, at, size
        at += size


def moments(lost):
    kept = [k for k in range(30) if k not in lost]
    return [PERIOD_MS * k for k in kept], [8 * k for k in kept]


def test_frames_lost_at_different_places_leave_pairs_of_one_moment(tmp_path):
    left = video(tmp_path / "left.mkv", *moments({4, 15, 16}))
    right = video(tmp_path / "right.mkv", *moments({9, 20, 25}))
    with open_rig(SIDES, left, right) as pairs:
        grey = [(round(a.image.mean() / 8), round(b.image.mean() / 8)) for a, b in pairs]
        dropped = pairs.skew.n_dropped
    assert all(a == b for a, b in grey) and [a for a, _ in grey] == [
        k for k in range(30) if k not in {4, 15, 16, 9, 20, 25}
    ]
    assert dropped == 6
    with open_rig(SIDES, left, right, fps=25.0) as by_number:  # as the cure says
        assert sum(1 for _ in by_number) == 27


def test_a_rate_that_varies_or_a_late_beginning_is_no_file_that_broke_off(tmp_path):
    for at_ms in ([40, 80, 400, 440, 480, 900, 1600, 2400], [2000, 2040, 2080, 2120, 2160, 2200]):
        path = video(tmp_path / "a.mkv", at_ms, range(0, 8 * len(at_ms), 8))
        with VideoFile(path) as source:
            t_s = [frame.t_s for frame in source]
        np.testing.assert_allclose(np.diff(t_s), np.diff(at_ms) / 1e3, atol=1.1e-3)


class Stamped:
    """A capture of pictures with stamps of its own."""

    def __init__(self, stamps_s):
        self.stamps_s, self.at = stamps_s, -1

    def isOpened(self):
        return True

    def read(self):
        self.at += 1
        return (True, np.zeros((4, 6), np.uint8)) if self.at < len(self.stamps_s) else (False, None)

    def get(self, key, /):
        return {
            cv2.CAP_PROP_POS_MSEC: 1e3 * self.stamps_s[min(self.at, len(self.stamps_s) - 1)],
            cv2.CAP_PROP_FPS: 10.0,
        }.get(key, 0.0)

    def set(self, key, value, /):
        return True

    def release(self):
        pass


@pytest.mark.parametrize("at", [1, 7])
def test_a_repeated_stamp_costs_its_frame_and_no_other(tmp_path, at):
    stamps = [0.11 * k for k in range(20)]
    stamps[at] = stamps[at - 1]
    (tmp_path / "a.mp4").touch()
    with VideoFile(str(tmp_path / "a.mp4"), open_capture=lambda _: Stamped(stamps)) as source:
        frames = list(source)
    assert [k for k, frame in enumerate(frames) if frame.unreadable] == [at]
    assert all(frame.t_s == stamps[k] for k, frame in enumerate(frames) if k != at)
    assert (np.diff([frame.t_s for frame in frames]) > 0.0).all()


def test_pictures_are_not_turned_as_a_player_would(tmp_path):
    path = tmp_path / "a.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 25.0, (64, 48))
    for _ in range(3):
        writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    data = path.read_bytes()
    track = data.index(b"tkhd")  # its matrix: 9 numbers of 16.16 and 2.30 from byte 44 on
    turned = b"".join(int(v).to_bytes(4, "big", signed=True) for v in (0, 65536, 0, -65536, 0, 0, 48 << 16, 0, 1 << 30))
    path.write_bytes(data[: track + 44] + turned + data[track + 80 :])
    capture = cv2.VideoCapture(str(path))
    assert capture.read()[1].shape[:2] == (64, 48)  # the file does say so
    with open_source(str(path)) as source:
        assert {frame.image.shape for frame in source} == {(48, 64)}
