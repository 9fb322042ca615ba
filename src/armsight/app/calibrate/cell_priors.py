"""Files of earlier calibrations as what is known of a cell: rig.yaml, world.yaml, handeye.yaml, camera.yaml."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from armsight.calibrate.cell import CellPriors
from armsight.calibrate.handeye import Setup
from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.optics import RIGHT_POSE, SIDES
from armsight.records import NamedCovariance
from armsight.store import read_rig, read_world
from armsight.store.foreign.storage import kind_of
from armsight.store.handeye_file import read_handeye

READ = "armsight/rig, armsight/world, armsight/handeye"


def read_priors(paths: Sequence[Path], sizes: Sequence[tuple[int, int]]) -> CellPriors | None:
    """Return what files say of a cell whose images are of these sizes (w, h) px; None for no file.

    Raises UsageError for another kind of file, NotEnoughData for one without a covariance, Inconsistent for cameras of
    another size.
    """
    known = CellPriors()
    for path in paths:
        kind = kind_of(path)
        if kind == "armsight/rig":
            known = _of_rig(known, path, sizes)
        elif kind == "armsight/world":
            world = read_world(path)
            if world.parent != "base":
                raise Inconsistent(
                    f"{path}: says where the rig stands in the world, not to the base",
                    cure="Give the world.yaml that `armsight calibrate robot-world` or `calibrate cell` wrote",
                )
            known = replace(known, base_pose=(world.T_parent_rig, _told(world.covariance, path)))
        elif kind == "armsight/handeye":
            hand = read_handeye(path)
            if hand.setup is not Setup.EYE_TO_HAND:
                raise Inconsistent(
                    f"{path}: the camera is on the hand there, and here it stands",
                    cure="Leave it out, or give an eye-to-hand calibration of the left camera",
                )
            covariance = _told(hand.covariance, path)
            names = covariance.names[:6]
            pose = NamedCovariance(names=names, matrix=covariance.block(names))
            known = replace(known, base_pose=(hand.T_parent_camera, pose))
        else:
            raise UsageError(
                f"{path}: a {kind or 'file of no known kind'} tells nothing here",
                cure=f"Give {READ}; a calibrated arm as --model, a measured target as --target",
            )
    return known if paths else None


def _of_rig(known: CellPriors, path: Path, sizes: Sequence[tuple[int, int]]) -> CellPriors:
    rig = read_rig(path)
    covariance = _told(rig.covariance, path)
    lenses = []
    for side, size in zip(SIDES, sizes, strict=True):
        camera = rig.camera(side)
        if (camera.width, camera.height) != tuple(size):
            raise Inconsistent(
                f"{path}: the {side} camera has {camera.width}x{camera.height} px, the recording {size[0]}x{size[1]}",
                consequence="Its lens is not that of these images",
                cure="Give the rig.yaml of these cameras in this mode",
            )
        names = tuple(name for name in covariance.names if name.startswith(f"{side}.") and name not in RIGHT_POSE)
        short = tuple(name.partition(".")[2] for name in names)
        lenses.append((camera, NamedCovariance(names=short, matrix=covariance.block(names))) if names else None)
    pose = (
        (rig.T_rig_left.inv() * rig.T_rig_right, NamedCovariance(names=RIGHT_POSE, matrix=covariance.block(RIGHT_POSE)))
        if set(RIGHT_POSE) <= set(covariance.names)
        else None
    )
    return replace(known, lenses=(lenses[0], lenses[1]), right_pose=pose)


def _told(covariance: NamedCovariance | None, path: Path) -> NamedCovariance:
    if covariance is None:
        raise NotEnoughData(
            f"{path} brings no covariance",
            consequence="How much it is to count beside the recording is not known",
            cure="Calibrate with a current version, or leave it out",
        )
    return covariance
