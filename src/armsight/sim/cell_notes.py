"""What was chosen about a simulated cell, in words: the lines of its assumptions."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from armsight.sim.camera import SimCamera
from armsight.sim.pipeline import IDEAL, Pipeline
from armsight.sim.room_schema import RoomKeys
from armsight.sim.sensor import Sensor


def room_chosen(keys: RoomKeys, dark: str) -> str:
    """Return what was chosen about the room."""
    if keys.dark:
        return f"room: {dark}"
    if keys.picture is not None:
        return "room: pictures of one's own"
    return f"room: {keys.preset}, white at {keys.white_level:g} grey levels of light, furniture from the seed"


def pipeline_chosen(pipeline: Pipeline) -> str:
    """Return what was chosen about lens losses and processing."""
    if pipeline == IDEAL:
        return "processing: none; no mosaic of colour filters, no glare, no vignetting"
    mosaic = "Bayer mosaic" if pipeline.bayer else "no mosaic"
    jpeg = "no JPEG" if pipeline.jpeg_quality is None else f"JPEG of quality {pipeline.jpeg_quality}"
    return (
        f"processing: vignetting {100 * pipeline.vignetting:g} %, glare {100 * pipeline.glare:g} %, {mosaic}, curve "
        f"{pipeline.curve}, sharpening {pipeline.sharpening:g}, {jpeg}"
    )


def cameras_chosen(cameras: Mapping[str, SimCamera]) -> tuple[str, ...]:
    """Return what was chosen about a pair of cameras."""
    left, right, T = cameras["left"].lens, cameras["right"].lens, cameras["right"].T_world_camera
    turn = np.rad2deg(float(np.linalg.norm(T.rotation.as_rotvec())))
    return (
        f"cameras: {left.width}x{left.height} px, fx {left.focal_px[0]:.1f} and {right.focal_px[0]:.1f} px, "
        f"distortion {list(left.distortion)} and {list(right.distortion)}",
        f"rig: right camera at {np.round(1e3 * np.asarray(T.translation), 2).tolist()} mm, turned {turn:.2f} deg",
    )


def light_chosen(level: float, sigma_px: float, diameter_m: float | None) -> str:
    """Return what was chosen about the lights."""
    if diameter_m is None:
        return f"lights: Gaussian of sigma {sigma_px:g} px, {level:g} grey levels high at any distance"
    return f"lights: flat discs of {1e3 * diameter_m:g} mm, {level:g} grey levels, lens blur sigma {sigma_px:g} px"


def sensor_chosen(sensor: Sensor) -> str:
    """Return what was chosen about the sensor."""
    return (
        f"sensor: {sensor.electrons_per_level:g} electrons per grey level, read noise of "
        f"{sensor.read_noise_level:g} levels, clipping at {sensor.saturation}"
    )
