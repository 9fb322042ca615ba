"""Small pictures of the images in which a board was found, for the report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePath
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.cameras import CameraCalibration, CamerasCalibration, StereoCalibration
from armsight.calibrate.cameras.observations import Observations
from armsight.optics import SIDES, Camera
from armsight.records import BoardView, Frame, Target
from armsight.report.run import BoardPicture, BoardViews

if TYPE_CHECKING:
    from armsight.calibrate.handeye import HandEyeResult

WIDTH_PX = 360
"""Width of a kept picture: the report shows them 340 px wide."""

QUALITIES = (70, 45, 25)
LARGEST = 20_000
"""Bytes of a kept picture; a noisier one is kept at a lower quality. WebP has a third fewer and takes forty times as
long, which is longer than finding the board."""


class BoardPictures:
    """Keeps the images by their names, small and compressed; images of several threads may come at once."""

    def __init__(self) -> None:
        self._kept: dict[str, bytes] = {}

    def keep(self, frame: Frame) -> None:
        """Keep the image of a frame."""
        image = frame.image
        height, width = image.shape[:2]
        if width > WIDTH_PX:
            size = (WIDTH_PX, max(1, round(height * WIDTH_PX / width)))
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        for quality in QUALITIES:
            _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
            if jpeg.size <= LARGEST:
                break
        self._kept[frame.source] = jpeg.tobytes()

    def of_view(self, source: str, size: tuple[int, int], uv_px: Array, residual_px: Array) -> list[BoardPicture]:
        """Return the picture of a view with its points (n, 2) and their residuals (n,), none where none was kept."""
        if source not in self._kept:
            return []
        width, height = size
        marks = {"uv_px": uv_px, "residual_px": residual_px}
        return [BoardPicture(name=source, jpeg=self._kept[source], width=width, height=height, **marks)]


def camera_boards(done: CameraCalibration, board: Target, pictures: BoardPictures) -> BoardViews:
    """Return the boards of one camera's calibration, in the camera's axes."""
    return BoardViews(
        parent="the camera",
        outline_m=outline_m(board),
        T_parent_board=[RigidTransform.from_matrix(T) for T in done.T_camera_board],
        cameras=[("camera", done.camera, RigidTransform.identity())],
        names=done.sources,
        rms_px=done.view_rms_px,
        pictures=_of_camera(done.used.camera(0), done.residual_px, pictures),
    )


def rig_boards(done: StereoCalibration, board: Target, pictures: BoardPictures) -> BoardViews:
    """Return the boards of a pair's calibration, in the left camera's axes."""
    rig = done.pair_rig()
    T_left_rig = rig.T_rig_left.inv()
    of_sides = [_of_camera(done.used.camera(c), done.residual_px[side], pictures) for c, side in enumerate(SIDES)]
    return BoardViews(
        parent="the left camera",
        outline_m=outline_m(board),
        T_parent_board=[RigidTransform.from_matrix(T) for T in done.T_left_board],
        cameras=[(side, rig.camera(side), T_left_rig * rig.T_rig_camera(side)) for side in SIDES],
        names=[names[0] for names in done.sources],
        rms_px=done.view_rms_px,
        pictures=sorted((one for side in of_sides for one in side), key=lambda one: one[0]),
    )


def many_boards(done: CamerasCalibration, board: Target, pictures: BoardPictures) -> BoardViews:
    """Return the boards of a calibration of some cameras, in axes of the first that saw it."""
    names, used = done.used.cameras, done.used
    first = done.rig.T_rig_camera(names[0]).inv()
    shown = []
    for c, name in enumerate(names):
        at = np.flatnonzero((used.weight[:, c] > 0.0).any(axis=1))
        own = _of_camera(used.camera(c).take(at), done.clouds()[name][1], pictures)
        shown += [(int(at[k]), picture) for k, picture in own]
    return BoardViews(
        parent=f"the camera {names[0]}",
        outline_m=outline_m(board),
        T_parent_board=[RigidTransform.from_matrix(T) for T in done.T_first_board],
        cameras=[(name, done.rig.camera(name), first * done.rig.T_rig_camera(name)) for name in done.rig.names],
        names=[names[0] for names in done.sources],
        rms_px=done.view_rms_px,
        pictures=sorted(shown, key=lambda one: one[0]),
    )


def hand_boards(
    result: HandEyeResult, views: Sequence[BoardView], camera: Camera, board: Target, pictures: BoardPictures
) -> BoardViews:
    """Return the boards of a hand-eye calibration in the base's axes, each with the camera as it stood for it.

    A point's residual is from the board at its own image's pose: the robot has no part in it.
    """
    T_base_flange = result.pairs.T_base_flange
    seen = result.pairs.T_camera_target
    cameras, boards, kept, rms = [], [], [], []
    for i, view in enumerate(views):
        on_hand = result.camera_parent == "flange"
        T_camera = T_base_flange[i] * result.T_parent_camera if on_hand else result.T_parent_camera
        cameras.append((f"camera at {PurePath(view.source).name}", camera, T_camera))
        boards.append(T_camera * seen[i])
        off = np.linalg.norm(camera.project(seen[i].apply(board.xyz_m[view.index])) - view.uv_px, axis=1)
        rms.append(float(np.sqrt(np.mean(off**2))))
        kept += [(i, one) for one in pictures.of_view(view.source, (view.width, view.height), view.uv_px, off)]
    return BoardViews(
        parent="the robot's base",
        outline_m=outline_m(board),
        T_parent_board=boards,
        cameras=cameras if result.camera_parent == "flange" else [("camera", camera, result.T_parent_camera)],
        names=[view.source for view in views],
        rms_px=rms,
        pictures=kept,
    )


def outline_m(board: Target) -> Array:
    """Return the edge (k, 3) of a board through its outermost points; of a target of lights, the lights."""
    if not board.is_board:
        return board.xyz_m
    low, high = board.xyz_m.min(axis=0), board.xyz_m.max(axis=0)
    return np.array([[low[0], low[1], 0.0], [high[0], low[1], 0.0], [high[0], high[1], 0.0], [low[0], high[1], 0.0]])


def _of_camera(used: Observations, residual_px: Array, pictures: BoardPictures) -> list[tuple[int, BoardPicture]]:
    """Return view and picture of one camera's views; residual_px (m, 2): of all its points, view by view."""
    seen = used.weight[:, 0] > 0.0  # (G, n)
    off = np.split(np.linalg.norm(residual_px, axis=1), np.cumsum(seen.sum(axis=1))[:-1])
    return [
        (k, picture)
        for k, (source,) in enumerate(used.sources)
        for picture in pictures.of_view(source, used.sizes[0], used.uv[k, 0][seen[k]], off[k])
    ]
