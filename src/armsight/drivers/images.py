"""Image files: which belong to a folder or pattern, in what order; reading one of them, its size and pixel layout."""

from __future__ import annotations

import glob
import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight._files import read_file
from armsight.errors import BadFile, BadImage, NotEnoughData, UsageError

CHANNELS = {"mono": 1, "bgr": 3, "rgb": 3, "bgra": 4, "rgba": 4, "rggb": 1, "bggr": 1, "gbrg": 1, "grbg": 1}
CHANNELS |= {"uyvy": 2, "yuyv": 2}
"""Bytes of a pixel by its layout; a Bayer mosaic is named by its first two rows, two pixels each; YUV 4:2:2 by the
bytes of two pixels, which share U and V."""

_CODES: dict[tuple[str, bool], int] = {
    ("mono", True): cv2.COLOR_GRAY2BGR,
    ("bgr", False): cv2.COLOR_BGR2GRAY,
    ("rgb", False): cv2.COLOR_RGB2GRAY,
    ("rgb", True): cv2.COLOR_RGB2BGR,
    ("bgra", False): cv2.COLOR_BGRA2GRAY,
    ("bgra", True): cv2.COLOR_BGRA2BGR,
    ("rgba", False): cv2.COLOR_RGBA2GRAY,
    ("rgba", True): cv2.COLOR_RGBA2BGR,
    ("uyvy", False): cv2.COLOR_YUV2GRAY_UYVY,
    ("uyvy", True): cv2.COLOR_YUV2BGR_UYVY,
    ("yuyv", False): cv2.COLOR_YUV2GRAY_YUYV,
    ("yuyv", True): cv2.COLOR_YUV2BGR_YUYV,
    ("rggb", False): cv2.COLOR_BayerRGGB2GRAY,
    ("rggb", True): cv2.COLOR_BayerRGGB2BGR,
    ("bggr", False): cv2.COLOR_BayerBGGR2GRAY,
    ("bggr", True): cv2.COLOR_BayerBGGR2BGR,
    ("gbrg", False): cv2.COLOR_BayerGBRG2GRAY,
    ("gbrg", True): cv2.COLOR_BayerGBRG2BGR,
    ("grbg", False): cv2.COLOR_BayerGRBG2GRAY,
    ("grbg", True): cv2.COLOR_BayerGRBG2BGR,
}


def unpack_image(data: Any, height: int, width: int, step: int, layout: str) -> NDArray[np.uint8] | None:
    """Return the pixels of a buffer, (h, w) or (h, w, channels) as laid out; None where it cannot hold them.

    data: bytes, or an array of them. step: bytes from one row to the next, at least those of a row.
    """
    row = width * CHANNELS[layout]
    flat = np.frombuffer(data, np.uint8)
    odd = CHANNELS[layout] == 2 and width % 2  # two pixels share their colour
    if not height or not width or odd or step < row or len(flat) < step * (height - 1) + row:
        return None
    rows = np.lib.stride_tricks.as_strided(flat, (height, row), (step, 1), writeable=False)
    pixels = rows if CHANNELS[layout] == 1 else rows.reshape(height, width, CHANNELS[layout])
    return np.ascontiguousarray(pixels)


def grey_or_bgr(pixels: NDArray[np.uint8], layout: str, *, colour: bool) -> NDArray[np.uint8]:
    """Return pixels (h, w) or (h, w, channels) of a layout as BGR (h, w, 3), or as grey (h, w)."""
    code = _CODES.get((layout, colour))
    return pixels if code is None else np.asarray(cv2.cvtColor(pixels, code), dtype=np.uint8)


LARGEST_PX = 1 << 27
"""Pixels of an image: 134 million, more than any camera of machine vision has; in colour they take 0.4 GB."""

_PNM = re.compile(rb"P[1-6]\s+(?:#[^\n]*\n\s*)*(\d{1,9})\s+(?:#[^\n]*\n\s*)*(\d{1,9})\s")
_NO_FRAME = (0xC4, 0xC8, 0xCC)
"""Markers of a JPEG between 0xC0 and 0xCF that begin no frame."""
_TIFF_SIZES = {3: "H", 4: "I"}
_WIDTH, _HEIGHT = 256, 257


def said_size(data: bytes) -> tuple[int, int] | None:
    """Return (width, height) in px as the head says, None where it is of no known kind or breaks off."""
    try:
        return _said_size(data)
    except (struct.error, IndexError):
        return None


def _said_size(data: bytes) -> tuple[int, int] | None:
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        return _two(">II", data, 16)
    if data.startswith(b"\xff\xd8"):
        return _jpeg(data)
    if data.startswith(b"BM"):
        width, height = _two("<ii", data, 18)
        return abs(width), abs(height)
    if data[:4] in (b"II*\0", b"MM\0*"):
        return _tiff(data, "<" if data[:1] == b"I" else ">")
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return _webp(data)
    found = _PNM.match(data)
    return (int(found[1]), int(found[2])) if found else None


def _two(form: str, data: bytes, at: int) -> tuple[int, int]:
    first, second = struct.unpack_from(form, data, at)
    return first, second


def _jpeg(data: bytes) -> tuple[int, int] | None:
    """Return the size of the first frame: segments are gone through up to it."""
    at = 2
    while data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # filling
            at += 1
        elif 0xC0 <= marker <= 0xCF and marker not in _NO_FRAME:
            height, width = _two(">HH", data, at + 5)
            return width, height
        else:
            at += 2 + struct.unpack_from(">H", data, at + 2)[0]
    return None


def _tiff(data: bytes, order: str) -> tuple[int, int] | None:
    (start,) = struct.unpack_from(order + "I", data, 4)
    (count,) = struct.unpack_from(order + "H", data, start)
    found = {}
    for at in range(start + 2, start + 2 + 12 * count, 12):
        tag, kind = _two(order + "HH", data, at)
        if tag in (_WIDTH, _HEIGHT) and kind in _TIFF_SIZES:
            (found[tag],) = struct.unpack_from(order + _TIFF_SIZES[kind], data, at + 8)
    return (found[_WIDTH], found[_HEIGHT]) if len(found) == 2 else None


def _webp(data: bytes) -> tuple[int, int] | None:
    kind = data[12:16]
    if kind == b"VP8X":
        return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    if kind == b"VP8 ":
        width, height = _two("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    return None


SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp")
LARGEST_BYTES = 6 * LARGEST_PX
"""Of an image file: the largest image as it is, in colours of 16 bits."""
PNG_END = b"IEND\xaeB`\x82"
JPEG_SCAN = b"\xff\xda"
JPEG_END = b"\xff\xd9"


LEAST_BITS, MOST_BITS = 9, 16
"""Bits of light that --bits may name; images of 8 need no word."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageReading:
    """How image files are read.

    bits: how many of a 16-bit pixel's lower bits carry the light; None: only 8-bit images are taken. strict: a file
    that cannot be read stops the run, else its frame says so and is black. only: names of the files that are
    meant, or None for all. Raises UsageError for bits that no image has.
    """

    bits: int | None = None
    strict: bool = True
    only: frozenset[str] | None = None

    def __post_init__(self) -> None:
        if self.bits is not None and not LEAST_BITS <= self.bits <= MOST_BITS:
            raise UsageError(
                f"--bits {self.bits} cannot be", cure=f"Give {LEAST_BITS} to {MOST_BITS}, such as 10 or 12"
            )

    def require_none(self, source: str) -> None:
        """Raise UsageError where bits are named for a source that is no image files."""
        if self.bits is not None:
            raise UsageError(f"--bits is for image files, and {source} is none", cure="Leave --bits away")


AS_THEY_ARE = ImageReading()
"""8-bit images, each of which must be readable."""


def natural_key(text: str) -> tuple[tuple[tuple[int, int | str], ...], str]:
    """Return a sort key under which frame2 comes before frame10."""
    parts = (part for part in re.split(r"(\d+)", text) if part)
    return tuple((0, int(part)) if part.isdecimal() else (1, part.lower()) for part in parts), text


def list_images(text: str) -> tuple[Path, ...]:
    """Return the images of a folder or pattern, in natural order. Raises BadFile, NotEnoughData without one."""
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


def read_image(path: Path, *, colour: bool = False, bits: int | None = None) -> NDArray[np.uint8]:
    """Return the image in path, grey (h, w) or BGR (h, w, 3), in the sensor's own orientation.

    A rotation noted by a telephone in the file's header is not applied: the pixels of one camera keep their position.
    bits: as ImageReading's. Raises BadFile where the file cannot be read, BadImage where it is no whole image of these
    bits.
    """
    return image_of_8_bits(read_pixels(path, colour=colour), bits, str(path))


def read_pixels(path: Path, *, colour: bool = False) -> NDArray[np.generic]:
    """Return the pixels in path as read_image does, as deep as the file has them."""
    try:
        data = read_file(path, limit=LARGEST_BYTES)
    except OSError as error:
        raise BadFile(
            f"{path} cannot be read ({error.strerror or error})", consequence="The frame is missing", cure="Check it"
        ) from error
    return _decoded(data, str(path), colour=colour)


def decode_image(data: bytes, where: str, *, colour: bool = False) -> NDArray[np.uint8]:
    """Return the image in the bytes of an image file, as read_image does. Raises BadImage that begins with where."""
    return image_of_8_bits(_decoded(data, where, colour=colour), None, where)


def _decoded(data: bytes, where: str, *, colour: bool) -> NDArray[np.generic]:
    why = "it is empty" if not data else _broken_off(data) or too_large(data)
    image = None
    if not why:
        flags = cv2.IMREAD_COLOR if colour else cv2.IMREAD_GRAYSCALE
        try:
            image = cv2.imdecode(
                np.frombuffer(data, np.uint8), flags | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
            )
        except cv2.error as error:
            why = f"OpenCV cannot decode it ({' '.join(str(error).split())[:200]})"
    if image is None:
        raise BadImage(
            f"{where} is not a whole image: {why or 'its content is damaged, or of no known kind'}",
            consequence="The frame cannot be used",
            cure="Copy it again from where it was recorded, or take it and its partner away",
        )
    return np.asarray(image)


def image_of_8_bits(image: NDArray[np.generic], bits: int | None, where: str) -> NDArray[np.uint8]:
    """Return an image as uint8, full scale of its bits at 255. Raises BadImage where those are untold or wrong."""
    if image.dtype == np.uint8:
        if bits is not None:
            raise BadImage(
                f"{where} has 8 bits per pixel, not {bits}",
                consequence="Images of different scales cannot be used together",
                cure="Leave --bits away, or take the 8-bit images out of the folder",
            )
        return np.asarray(image, dtype=np.uint8)
    largest = image.max() if image.size else 0
    if image.dtype != np.uint16:
        raise BadImage(
            f"{where} has pixels of type {image.dtype}",
            consequence="The frame cannot be used",
            cure="Convert the images to 8 or 16 bits, all with the same factor",
        )
    needed = max(int(largest).bit_length(), LEAST_BITS)
    if bits is None:
        raise BadImage(
            f"{where} has 16 bits per pixel, and nothing says which of them carry the light",
            consequence="The frame cannot be used",
            cure=f"Say it, such as --bits 12; this image's brightest pixel is {largest}, which takes {needed} bits",
        )
    if needed > bits:
        raise BadImage(
            f"{where} has a pixel of {largest}, which takes {needed} bits, not {bits}",
            consequence="The frame cannot be used",
            cure=f"Give --bits {needed} or more, the same for all images of the camera",
        )
    full = 2**bits - 1
    return np.asarray((image.astype(np.uint32) * 255 + full // 2) // full, dtype=np.uint8)


def _broken_off(data: bytes) -> str:
    """Say why a PNG or JPEG file is not whole, or ''; decoders fill a truncated JPEG with grey and say nothing."""
    if data.startswith(b"\x89PNG") and PNG_END not in data:
        return "it breaks off before its end"
    if data.startswith(b"\xff\xd8") and data.rfind(JPEG_END) < data.rfind(JPEG_SCAN):
        return "it breaks off before its end"
    return ""


def too_large(data: bytes) -> str:
    """Say why the bytes of an image file are not given to a decoder, or ''."""
    size = said_size(data)
    if size is None:
        return "its head is damaged, or of no known kind"
    if len(data) > LARGEST_BYTES or size[0] * size[1] > LARGEST_PX:
        return f"{size[0]} x {size[1]} px are more than the {LARGEST_PX / 1e6:.0f} million that a camera's image has"
    return ""
