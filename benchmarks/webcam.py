"""From the light that falls on a sensor to the 8-bit picture that a camera hands out, stage by stage.

Light is linear, 1.0 fills a photosite; pictures are BGR or grey. Every stage's setting is a plain value in one
mapping, so that a picture can be told by what made it. Nothing here comes from the product or its simulation.
"""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

Light = NDArray[np.float32]
Picture = NDArray[np.uint8]

DEEP = 65535
"""Full scale between the stages: 16 bits, so that only the last stage rounds to 8."""

DEMOSAICS = {
    "bilinear": cv2.COLOR_BayerRGGB2BGR,
    "vng": cv2.COLOR_BayerRGGB2BGR_VNG,
    "ea": cv2.COLOR_BayerRGGB2BGR_EA,
}

CURVES = ("linear", "srgb", "knee")
SHARPENING = (0.0, 0.5, 1.0, 1.6)
JPEG = (0, 95, 85, 70, 50)

KNEE = 0.8
"""Where the curve 'knee' leaves gamma 2.2, in the picture's scale."""


def draw_webcam(rng: np.random.Generator) -> dict[str, object]:
    """Return one random setting of every stage."""
    return {
        "bayer": str(rng.choice(["none", *DEMOSAICS], p=[0.25, 0.25, 0.25, 0.25])),
        "vignetting": float(rng.uniform(0.0, 0.45)),
        "noise": True,
        "full_well": float(np.exp(rng.uniform(np.log(2e3), np.log(2e4)))),
        "read_noise": float(rng.uniform(2.0, 12.0)),
        "white_balance": (float(rng.uniform(1.2, 2.0)), 1.0, float(rng.uniform(1.2, 2.0))),
        "curve": str(rng.choice(CURVES)),
        "denoise": bool(rng.uniform() < 0.3),
        "sharpen": float(rng.choice(SHARPENING, p=[0.35, 0.25, 0.25, 0.15])),
        "sharpen_radius_px": float(rng.uniform(0.7, 1.5)),
        "jpeg": int(rng.choice(JPEG, p=[0.3, 0.2, 0.2, 0.15, 0.15])),
    }


def develop(light: Light, settings: Mapping[str, object], rng: np.random.Generator) -> Picture:
    """Return the picture of light (h, w, 3) BGR: BGR of a colour camera, grey where bayer is 'none'."""
    light = light * vignette(*light.shape[:2], float(settings["vignetting"]))[..., None]
    deep = grey_sensor(light, settings, rng) if settings["bayer"] == "none" else colour_sensor(light, settings, rng)
    picture = toned(deep, str(settings["curve"]))
    if settings["denoise"]:
        picture = cv2.bilateralFilter(picture, 5, 8.0, 1.5)
    picture = sharpened(picture, float(settings["sharpen"]), float(settings["sharpen_radius_px"]))
    rounded = cv2.convertScaleAbs(picture)  # rounds, and clips at 255; the stage before leaves nothing below 0
    return compressed(rounded, int(settings["jpeg"]))


def vignette(height: int, width: int, strength: float) -> Light:
    """Return the lens's falloff (h, w): 1 in the middle, 1 - strength in the corners."""
    y = np.linspace(-1.0, 1.0, height, dtype=np.float32)[:, None]
    x = np.linspace(-1.0, 1.0, width, dtype=np.float32)[None]
    return 1.0 - np.float32(0.5 * strength) * (x**2 + y**2)


def exposed(raw: Light, settings: Mapping[str, object], rng: np.random.Generator) -> NDArray[np.uint16]:
    """Return what the converter reads of photosites (h, w): shot and read noise, clipped at the full well."""
    if settings["noise"]:
        well, read = float(settings["full_well"]), float(settings["read_noise"])
        sigma = np.sqrt(np.maximum(raw, 0.0) / np.float32(well) + np.float32((read / well) ** 2))
        raw = raw + sigma * rng.standard_normal(raw.shape, dtype=np.float32)
    return (np.clip(raw, 0.0, 1.0) * np.float32(DEEP) + np.float32(0.5)).astype(np.uint16)


def grey_sensor(light: Light, settings: Mapping[str, object], rng: np.random.Generator) -> NDArray[np.uint16]:
    """Return the reading (h, w) of a sensor without filters."""
    return exposed(light @ np.array([0.25, 0.5, 0.25], np.float32), settings, rng)


def colour_sensor(light: Light, settings: Mapping[str, object], rng: np.random.Generator) -> NDArray[np.uint16]:
    """Return BGR (h, w, 3) of a sensor behind RGGB filters: mosaic, noise, demosaic, white balance.

    The filters pass blue and red as weakly as the white balance then amplifies them; so amplified, what was clipped
    stays clipped.
    """
    blue, green, red = (np.float32(1.0 / gain) for gain in settings["white_balance"])  # type: ignore[attr-defined]
    raw = light[..., 1] * green
    raw[0::2, 0::2] = light[0::2, 0::2, 2] * red
    raw[1::2, 1::2] = light[1::2, 1::2, 0] * blue
    mosaic, method = exposed(raw, settings, rng), str(settings["bayer"])
    if method == "vng":  # OpenCV has it for 8 bits only: companded, as cameras do before they transmit
        eight = np.rint(255.0 * np.sqrt(mosaic / np.float32(DEEP))).astype(np.uint8)
        bgr = (cv2.cvtColor(eight, DEMOSAICS[method]).astype(np.float32) / 255.0) ** 2
        bgr *= np.float32(DEEP)
    else:
        bgr = cv2.cvtColor(mosaic, DEMOSAICS[method]).astype(np.float32)
    bgr *= np.array(settings["white_balance"], np.float32)
    return np.minimum(bgr, np.float32(DEEP)).astype(np.uint16)


def curve_of(x: NDArray[np.float64], name: str) -> NDArray[np.float64]:
    """Return the picture's value (0..1) of light x (0..1)."""
    if name == "linear":
        return x
    if name == "srgb":
        return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)
    if name == "knee":
        return _shouldered((1.6 * x) ** (1 / 2.2)) / float(_shouldered(np.array(1.6 ** (1 / 2.2))))
    raise ValueError(f"there is no curve {name!r}; the curves are {', '.join(CURVES)}")


def _shouldered(y: NDArray[np.float64]) -> NDArray[np.float64]:
    room = 1.0 - KNEE
    return np.where(y <= KNEE, y, KNEE + room * (1.0 - np.exp(-(y - KNEE) / room)))


def linear_of(picture: Picture) -> Light:
    """Return the light (0..1) behind an sRGB picture."""
    x = np.arange(256) / 255.0
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4).astype(np.float32)[picture]


def toned(deep: NDArray[np.uint16], curve: str) -> Light:
    """Return the picture's values (0..255, not yet rounded) of 16-bit light."""
    return (255.0 * curve_of(np.arange(DEEP + 1) / DEEP, curve)).astype(np.float32)[deep]


def sharpened(picture: Light, amount: float, radius_px: float) -> Light:
    """Return the unsharp mask of picture values, kept at 0 or above."""
    if amount == 0.0:
        return picture
    soft = cv2.GaussianBlur(picture, (0, 0), radius_px)
    return np.maximum(cv2.addWeighted(picture, 1.0 + amount, soft, -amount, 0.0), 0.0)


def compressed(picture: Picture, quality: int) -> Picture:
    """Return the picture as a JPEG of that quality gives it back (chroma at half the size); 0: as it is."""
    if quality == 0:
        return picture
    options = [cv2.IMWRITE_JPEG_QUALITY, quality]
    options += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420]
    done, data = cv2.imencode(".jpg", picture, options)
    if not done:
        raise RuntimeError("the picture could not be written as JPEG")
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED), np.uint8)
