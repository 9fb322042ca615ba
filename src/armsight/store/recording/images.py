"""A frame as a message, and back: raw, PNG (both bit for bit) or JPEG."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np

from armsight.arrays import Image
from armsight.drivers.images import too_large
from armsight.errors import BadFile, BadImage
from armsight.store.recording.schemas import COMPRESSED_IMAGE, RAW_IMAGE, compressed_image_head, fields, raw_image_head


class ImageFormat(StrEnum):
    """How frames are kept."""

    RAW = "raw"
    PNG = "png"
    JPEG = "jpeg"


_PNG_FILTER = (cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_SUB)
_PNG_STRATEGY = (cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY)
PNG = (*_PNG_FILTER, *_PNG_STRATEGY)
"""A camera's noise leaves nothing to find for the search of repetitions: half the time of it, for the same size."""

JPEG_QUALITY = 95
"""The least at which the spots' centres move by less than 0.01 px."""

_CODES = {"mono8": None, "8UC1": None, "bgr8": None, "8UC3": None, "rgb8": cv2.COLOR_RGB2BGR}


@dataclass(frozen=True, slots=True)
class Encoded:
    """A compressed image: png or jpeg, and its bytes."""

    kind: ImageFormat
    data: memoryview


def encode(image: Image, kind: ImageFormat) -> Encoded | None:
    """Return the image compressed, None for raw. Releases the interpreter's lock while it works."""
    if kind is ImageFormat.RAW:
        return None
    png = kind is ImageFormat.PNG
    options = PNG if png else (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY)
    good, data = cv2.imencode(".png" if png else ".jpg", image, options)
    if not good:
        raise BadImage(f"an image of shape {image.shape} cannot be compressed as {kind.value}")
    return Encoded(kind, np.asarray(data, np.uint8).data.cast("B"))


def image_message(t_ns: int, frame_id: str, image: Image, encoded: Encoded | None) -> tuple[str, bytes, memoryview]:
    """Return (schema, head, data) of a frame's message."""
    if encoded is not None:
        head = compressed_image_head(t_ns, frame_id, encoded.kind.value, len(encoded.data))
        return COMPRESSED_IMAGE, head, encoded.data
    head = raw_image_head(t_ns, frame_id, image.shape, "mono8" if image.ndim == 2 else "bgr8")
    return RAW_IMAGE, head, np.ascontiguousarray(image).data.cast("B")


def decode(schema: str, data: memoryview, where: str) -> Image:
    """Return the image, grey (h, w) or BGR (h, w, 3), of a message. Raises BadFile, BadImage."""
    try:
        content = fields(data)
    except ValueError as error:
        raise BadFile(f"{where}: the image's message is damaged ({error})") from error
    return _raw(content, where) if schema == RAW_IMAGE else _compressed(content, where)


def _raw(content: dict[int, int | memoryview], where: str) -> Image:
    width, height, step = (_natural(content.get(number)) for number in (2, 3, 5))
    encoding = str(_bytes(content.get(4)), "utf-8", "replace")
    data = _bytes(content.get(6))
    if encoding not in _CODES:
        raise BadImage(
            f"{where}: pixels of kind {encoding[:40]!r}",
            consequence="They are not read",
            cure=f"Known: {', '.join(_CODES)}",
        )
    depth = 1 if encoding in ("mono8", "8UC1") else 3
    if not width or not height or step < width * depth or len(data) != step * height:
        raise BadFile(f"{where}: {len(data)} bytes are no image of {width}x{height} px, {step} bytes a row")
    rows: Image = np.frombuffer(data, np.uint8).reshape(height, step)[:, : width * depth]
    image = rows if depth == 1 else rows.reshape(height, width, 3)
    code = _CODES[encoding]
    return image if code is None else np.asarray(cv2.cvtColor(image, code), dtype=np.uint8)


def _compressed(content: dict[int, int | memoryview], where: str) -> Image:
    data = _bytes(content.get(2))
    try:
        image = None if too_large(bytes(data)) else cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None or image.dtype != np.uint8 or image.shape[2:] not in ((), (3,)):
        kind = str(_bytes(content.get(3)), "utf-8", "replace")[:20]
        raise BadImage(
            f"{where}: the {kind} image cannot be decoded as 8-bit grey or BGR", consequence="It is not used"
        )
    return np.asarray(image, dtype=np.uint8)


def _natural(value: int | memoryview | None) -> int:
    return value if isinstance(value, int) else 0


def _bytes(value: int | memoryview | None) -> memoryview:
    return value if isinstance(value, memoryview) else memoryview(b"")
