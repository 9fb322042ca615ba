"""Image files: which belong to a folder or pattern, in what order, and reading one of them."""

from __future__ import annotations

import glob
import re
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight.errors import BadFile, BadImage, NotEnoughData

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp")
PNG_END = b"IEND\xaeB`\x82"
JPEG_SCAN = b"\xff\xda"
JPEG_END = b"\xff\xd9"


def natural_key(text: str) -> tuple[tuple[tuple[int, int | str], ...], str]:
    """Return a sort key under which frame2 comes before frame10."""
    parts = (part for part in re.split(r"(\d+)", text) if part)
    return tuple((0, int(part)) if part.isdecimal() else (1, part.lower()) for part in parts), text


def list_images(text: str) -> tuple[Path, ...]:
    """Return the image files of a folder or of a pattern such as 'shots/left*.png', in natural order.

    Raises BadFile where there is no such folder, NotEnoughData where it holds no image.
    """
    folder = Path(text)
    if folder.is_dir():
        files = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and not path.name.startswith(".")]
        where = f"the folder {text}"
    elif glob.has_magic(text):
        files = [Path(name) for name in glob.glob(text, recursive=True)]  # noqa: PTH207  absolute patterns as well
        files = [path for path in files if path.suffix.lower() in SUFFIXES and path.is_file()]
        where = f"the pattern {text}"
    elif folder.suffix.lower() in SUFFIXES and folder.is_file():
        return (folder,)
    else:
        raise BadFile(
            f"{text} is neither a folder, nor a pattern, nor a file that can be read",
            consequence="There are no frames",
            cure="Give a folder of images, a quoted pattern ('left*.png'), a video file, bag:FILE:/topic or camera:0",
        )
    if not files:
        raise NotEnoughData(
            f"{where} holds no image",
            consequence="There are no frames",
            cure=f"Images end in {', '.join(SUFFIXES)}; give the folder that holds them itself",
        )
    return tuple(sorted(files, key=lambda path: natural_key(str(path))))


def read_image(path: Path, *, colour: bool = False) -> NDArray[np.uint8]:
    """Return the image in path, grey (h, w) or BGR (h, w, 3), in the sensor's own orientation.

    A rotation noted by a telephone in the file's header is not applied: the pixels of one camera keep their
    place. Raises BadFile where the file cannot be read, BadImage where it is no whole 8-bit image.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BadFile(
            f"{path} cannot be read ({error.strerror or error})", consequence="The frame is missing", cure="Check it"
        ) from error
    return decode_image(data, str(path), colour=colour)


def decode_image(data: bytes, where: str, *, colour: bool = False) -> NDArray[np.uint8]:
    """Return the image in the bytes of an image file, as read_image does. Raises BadImage that begins with where."""
    why = "it is empty" if not data else _broken_off(data)
    image = None
    if not why:
        flags = cv2.IMREAD_COLOR if colour else cv2.IMREAD_GRAYSCALE
        try:
            image = cv2.imdecode(
                np.frombuffer(data, np.uint8), flags | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
            )
        except cv2.error as error:
            why = f"OpenCV cannot decode it ({_one_line(error)})"
    if image is None:
        raise BadImage(
            f"{where} is not a whole image: {why or 'its content is damaged, or of no known kind'}",
            consequence="The frame cannot be used",
            cure="Copy it again from where it was recorded, or take it and its partner away",
        )
    if image.dtype != np.uint8:
        raise BadImage(
            f"{where} has {image.dtype.itemsize * 8} bits per pixel, and nothing says which of them carry the light",
            consequence="The frame cannot be used",
            cure="Convert the images to 8 bits, all with the same factor",
        )
    return np.asarray(image)


def _broken_off(data: bytes) -> str:
    """Say why a PNG or JPEG file is not whole, or ''; decoders fill a truncated JPEG with grey and say nothing."""
    if data.startswith(b"\x89PNG") and PNG_END not in data:
        return "it breaks off before its end"
    if data.startswith(b"\xff\xd8") and data.rfind(JPEG_END) < data.rfind(JPEG_SCAN):
        return "it breaks off before its end"
    return ""


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
