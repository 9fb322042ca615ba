"""The cell in three dimensions: cameras, target and where it was."""

from __future__ import annotations

import numpy as np
from nicegui import ui
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.app.live.measurement import LiveJob
from armsight.app.measure.run import target_of
from armsight.app.schemas.live import LiveView
from armsight.optics import SIDES
from armsight.store import read_rig, read_world

Array = NDArray[np.float64]

FRUSTUM_M = 0.12
"""Length of the pyramids that stand for cameras."""
TRACK = 600
"""Points of the track shown."""
COLOURS = {"left": "#0072B2", "right": "#CC79A7", "target": "#D55E00", "track": "#009E73"}
UPRIGHT = RigidTransform.from_rotation(Rotation.from_matrix([[1, 0, 0], [0, 0, 1], [0, -1, 0]]))
"""From a rig's axes (x right, y down, z forward) to a screen's (z up), where no world frame is known."""


class Scene:
    """A 3-D view on a page; `show` moves the target."""

    def __init__(self, job: LiveJob, first: LiveView | None) -> None:
        """Draw cameras and target onto the page that is being built."""
        rig = read_rig(job.rig) if job.rig is not None else None
        target = target_of(job.target) if job.target is not None else None
        self._T_scene_parent = UPRIGHT if job.world is None else RigidTransform.identity()
        T_parent_rig = RigidTransform.identity() if job.world is None else read_world(job.world).T_parent_rig
        self._track: list[list[float]] = []
        with ui.scene(grid=(4, 20), background_color="#dfe5ea").classes("w-full") as self._scene:
            self._scene.props["data-testid"] = "scene"
            if rig is not None:
                for side in SIDES:
                    self._camera(self._T_scene_parent * T_parent_rig * rig.T_rig_camera(side), COLOURS[side])
            with self._scene.group() as self._target:
                if target is not None and not target.is_board:
                    for name, light in zip(target.names, target.xyz_m.tolist(), strict=True):
                        self._scene.sphere(radius=0.008).move(*light).material(COLOURS["target"])
                        self._scene.text(name, "font-weight: 700; color: #14181c").move(*light)
                for axis, colour in zip(np.eye(3) * 0.06, ("#D55E00", "#009E73", "#0072B2"), strict=True):
                    self._scene.line([0, 0, 0], axis.tolist()).material(colour)
            self._cloud = self._scene.point_cloud([[0, 0, 0]], [[0, 0.6, 0.45]], point_size=0.006)
        self._target.visible(False)
        centre = (self._T_scene_parent * T_parent_rig).apply([0.0, 0.0, 0.5])
        eye = (self._T_scene_parent * T_parent_rig).apply([0.7, -0.6, -0.5])
        (x, y, z), (to_x, to_y, to_z) = eye.tolist(), centre.tolist()
        self._scene.move_camera(x, y, z, to_x, to_y, to_z, 0.0, 0.0, 1.0, duration=0.0)
        if first is not None:
            self.show(first)

    def show(self, view: LiveView) -> None:
        """Put the target where it is; hide it where it is not seen."""
        whole = view.xyz_m is not None and view.quat_xyzw is not None
        self._target.visible(whole)
        if view.xyz_m is None or view.quat_xyzw is None:
            return
        pose = RigidTransform.from_components(view.xyz_m, Rotation.from_quat(view.quat_xyzw))
        T_scene_target = self._T_scene_parent * pose
        place = T_scene_target.translation.tolist()
        self._target.move(*place)
        self._target.rotate_R(T_scene_target.rotation.as_matrix().tolist())
        self._track = [*self._track[-TRACK:], place]

    def show_track(self) -> None:
        """Draw the places where the target was."""
        if self._track:
            self._cloud.set_points(self._track, [[0.0, 0.6, 0.45]] * len(self._track))

    def _camera(self, T_scene_camera: RigidTransform, colour: str) -> None:
        """Draw a camera as the pyramid it sees through."""
        corners = FRUSTUM_M * np.array([[-0.6, -0.35, 1], [0.6, -0.35, 1], [0.6, 0.35, 1], [-0.6, 0.35, 1]])
        centre = T_scene_camera.translation.tolist()
        places = T_scene_camera.apply(corners).tolist()
        for one, next_ in zip(places, [*places[1:], places[0]], strict=True):
            self._scene.line(centre, one).material(colour)
            self._scene.line(one, next_).material(colour)
