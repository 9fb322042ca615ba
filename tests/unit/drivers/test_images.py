"""Image files: their order, and every way in which one may be broken."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from armsight.drivers import read_image
from armsight.drivers.images import natural_key
from armsight.errors import BadImage, DataRefused

NOISE = np.random.default_rng(5).integers(0, 256, (60, 80), dtype=np.uint8)


def test_natural_order() -> None:
    names = ["f10.png", "f9.png", "F1.png", "f1b2.png", "f1b10.png", "a.png", "f01.png"]
    assert sorted(names, key=natural_key) == [
        "a.png",
        "F1.png",
        "f01.png",
        "f1b2.png",
        "f1b10.png",
        "f9.png",
        "f10.png",
    ]


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tiff", ".webp", ".pgm"])
@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.97])
def test_a_truncated_image_is_refused_by_name(tmp_path: Path, suffix: str, share: float) -> None:
    data = cv2.imencode(suffix, NOISE)[1].tobytes()
    path = tmp_path / f"cut{suffix}"
    path.write_bytes(data)
    assert read_image(path).shape == NOISE.shape
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(BadImage, match="cut") as info:
        read_image(path)
    assert "again" in info.value.cure


def test_sixteen_bits_are_refused_and_colour_is_kept_on_request(tmp_path: Path) -> None:
    path = tmp_path / "deep.png"
    cv2.imwrite(str(path), NOISE.astype(np.uint16) * 16)
    with pytest.raises(BadImage, match="16 bits"):
        read_image(path)
    cv2.imwrite(str(path), np.dstack([NOISE, NOISE // 2, NOISE // 4]))
    assert read_image(path, colour=True).shape == (60, 80, 3)
    assert read_image(path).shape == (60, 80)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.floats(0.0, 1.0, exclude_max=True), value=st.integers(0, 255), suffix=st.sampled_from([".png", ".jpg"]))
def test_a_flipped_byte_never_crashes_the_reader(tmp_path: Path, place: float, value: int, suffix: str) -> None:
    data = bytearray(cv2.imencode(suffix, NOISE)[1].tobytes())
    data[int(place * len(data))] = value
    path = tmp_path / f"flipped{suffix}"
    path.write_bytes(bytes(data))
    try:
        assert read_image(path).dtype == np.uint8
    except DataRefused as error:
        assert str(path) in error.cause
