"""Image files of 9 to 16 bits, and those among others that cannot be read."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from armsight.drivers import ImageReading, open_source
from armsight.drivers.images import read_image
from armsight.errors import BadImage, UsageError
from armsight.ops.calibration.board_images import see_board
from armsight.records import NotSeen, TargetKind, board_target
from refusals import names_it, refuses

BOARD = board_target(TargetKind.CHECKERBOARD, 9, 6, 0.025)
RAMP = np.linspace(0.0, 1.0, 64 * 48).reshape(48, 64)
LENIENT = ImageReading(strict=False)


def deep(path: Path, bits: int) -> np.ndarray:
    pixels = np.rint(RAMP * (2**bits - 1)).astype(np.uint16)
    cv2.imwrite(str(path), pixels)
    return pixels


@pytest.mark.parametrize("bits", [10, 12, 16])
def test_full_scale_of_the_bits_named_is_255(tmp_path: Path, bits: int) -> None:
    pixels = deep(tmp_path / "a.png", bits)
    image = read_image(tmp_path / "a.png", bits=bits)
    assert image.dtype == np.uint8
    assert np.abs(image - pixels / (2**bits - 1) * 255.0).max() <= 0.5
    assert (image.min(), image.max()) == (0, 255)


def test_bits_are_asked_for_and_checked_against_the_image(tmp_path: Path) -> None:
    deep(tmp_path / "a.png", 12)
    with refuses(BadImage, "says") as refusal:
        read_image(tmp_path / "a.png")
    assert names_it(refusal.value.cure, "4095", "12 bits")
    with refuses(BadImage, "4095", "12 bits", "10"):
        read_image(tmp_path / "a.png", bits=10)
    cv2.imwrite(str(tmp_path / "b.png"), np.zeros((48, 64), np.uint8))
    with refuses(BadImage, "8 bits", "12"):
        read_image(tmp_path / "b.png", bits=12)
    for bits in (8, 17):
        with refuses(UsageError, f"--bits {bits}"):
            ImageReading(bits=bits)


@pytest.mark.parametrize("broken", [0, 1])
def test_a_file_among_others_that_cannot_be_read_says_so_and_the_rest_goes_on(tmp_path: Path, broken: int) -> None:
    for i in range(3):
        cv2.imwrite(str(tmp_path / f"{i}.png"), np.full((48, 64), 90, np.uint8))
    path = tmp_path / f"{broken}.png"
    path.write_bytes(path.read_bytes()[:40])
    with open_source(str(tmp_path), reading=LENIENT) as source:
        frames = list(source)
    assert [bool(frame.unreadable) for frame in frames] == [i == broken for i in range(3)]
    assert [frame.t_s for frame in frames] == [0.0, 1 / 30, 2 / 30]
    assert {frame.image.shape for frame in frames} == {(48, 64)}
    assert not frames[broken].image.any()
    seen = see_board(frames[broken], BOARD)
    assert isinstance(seen, NotSeen)
    assert names_it(seen.why, "whole image", "breaks off")
    with open_source(str(tmp_path)) as source, refuses(BadImage, "whole image"):
        list(source)
