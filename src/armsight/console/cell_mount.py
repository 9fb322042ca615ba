"""What the page Cell can tell before anything moves: cameras, lights, readings, target and arm, each with its cure."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from armsight.console import texts_cell as texts
from armsight.console.state import Console
from armsight.errors import ArmsightError
from armsight.kinematics import Arm
from armsight.ops.arm_files import load_arm
from armsight.ops.measurement.run import target_of
from armsight.optics import SIDES
from armsight.records import Target
from armsight.store.cell_file import cell_path
from armsight.units import MM

FEWEST_LIGHTS = 4
FLAT_M = 3e-3
"""A target no thicker than this is taken as flat: the set `cell` has 30 mm, a board of lights its solder."""
SLOW_FPS = 8.0


@dataclass(frozen=True, slots=True)
class Lamp:
    """What one thing is like: its key, its level (good, warn, bad, idle), and words with cause and cure."""

    key: str
    level: str
    words: str


def mount_lamps(console: Console) -> tuple[Lamp, ...]:
    """Return the lamps in their order; those of files read them anew only where they changed."""
    target, target_lamp = _target(console)
    arm, arm_lamp = _arm(console)
    return (_cameras(console), _lights(console, target), _joints(console, arm), target_lamp, arm_lamp)


def _cameras(console: Console) -> Lamp:
    station = console.station
    if station is None:
        why = console.refusal
        return Lamp("cameras", "bad", texts.NOT_MEASURING.format(why=why) if why else texts.NO_CAMERAS)
    shown = station.shown
    why = station.failure or ("the frames have ended" if station.ended else "")
    why = why or (f"none for {station.silent_s:.0f} s" if station.silent_s > 0.0 else "")
    if why:
        return Lamp("cameras", "bad", texts.NOT_MEASURING.format(why=why.rstrip(".")))
    if shown is None:
        return Lamp("cameras", "idle", texts.STARTING)
    sizes = ", ".join(f"{name} {view.width}x{view.height}" for name, view in shown.view.cameras.items())
    words = texts.PICTURES.format(fps=shown.view.fps, sizes=sizes)
    if shown.view.fps < SLOW_FPS:
        return Lamp("cameras", "warn", texts.SLOW.format(fps=shown.view.fps))
    return Lamp("cameras", "good", words)


def _lights(console: Console, target: Target | None) -> Lamp:
    station = console.station
    if station is None or not console.current or station.shown is None:
        return Lamp("lights", "idle", texts.STARTING if station is not None else texts.NO_CAMERAS)
    found = dict(zip(station.shown.view.cameras, map(len, station.shown.spots), strict=True))
    counts = ", ".join(f"{name} {n}" for name, n in found.items())
    counts = counts.capitalize() if console.pictures == SIDES else counts  # of others the name as it is
    if target is None:
        return Lamp("lights", "idle", texts.LIGHTS_UNKNOWN.format(counts=counts))
    n = len(target.names)
    # of more cameras than left and right one may see what another does not
    if (min if console.pictures == SIDES else max)(found.values()) < n:
        return Lamp("lights", "bad", texts.FEWER.format(counts=counts, n=n))
    if max(found.values()) > n:
        return Lamp("lights", "warn", texts.MORE.format(counts=counts, n=n))
    return Lamp("lights", "good", texts.LIGHTS.format(counts=counts, n=n))


def _joints(console: Console, arm: Arm | None) -> Lamp:
    if console.robot is None:
        return Lamp("joints", "idle", texts.NO_ROBOT)
    try:
        n = len(console.robot.reading().q)
    except ArmsightError as error:
        return Lamp("joints", "bad", texts.JOINTS_LOST.format(why=error))
    if arm is not None and arm.n != n:
        return Lamp("joints", "bad", texts.JOINTS_OTHER.format(n=n, wanted=arm.n))
    return Lamp("joints", "good", texts.JOINTS.format(n=n))


def _target(console: Console) -> tuple[Target | None, Lamp]:
    try:
        file = cell_path(console.folder, console.cell.target, "target")
        if file is None:
            return None, Lamp("target", "bad", texts.NO_TARGET)
        target = _read_target(file, file.stat().st_mtime_ns)
    except (ArmsightError, OSError) as error:
        return None, Lamp("target", "bad", str(error))
    n = len(target.names)
    if target.is_board:
        return None, Lamp("target", "bad", texts.BOARD)
    if n < FEWEST_LIGHTS:
        return target, Lamp("target", "bad", texts.FEW_LIGHTS.format(n=n))
    spread = np.linalg.svd(target.xyz_m - target.xyz_m.mean(axis=0))
    thick_m = float(np.ptp((target.xyz_m - target.xyz_m.mean(axis=0)) @ spread.Vh[2]))
    if thick_m < FLAT_M:
        return target, Lamp("target", "warn", texts.FLAT.format(mm=thick_m / MM))
    wide_m = float(np.linalg.norm(np.ptp(target.xyz_m, axis=0)))
    return target, Lamp("target", "good", texts.TARGET.format(n=n, mm=wide_m / MM))


def _arm(console: Console) -> tuple[Arm | None, Lamp]:
    try:
        file = cell_path(console.folder, console.cell.arm, "arm")
        if file is None:
            return None, Lamp("arm", "bad", texts.NO_ARM)
        arm = _read_arm(file, file.stat().st_mtime_ns)
    except (ArmsightError, OSError) as error:
        return None, Lamp("arm", "bad", str(error))
    return arm, Lamp("arm", "good", texts.ARM.format(name=arm.name, n=arm.n))


@lru_cache(maxsize=8)
def _read_target(file: Path, _changed_ns: int) -> Target:
    return target_of(file)


@lru_cache(maxsize=8)
def _read_arm(file: Path, _changed_ns: int) -> Arm:
    return load_arm(str(file))
