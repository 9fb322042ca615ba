"""The cell in three dimensions: arm, cameras, target, where both were, and a path."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from itertools import pairwise

import numpy as np
from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D
from nicegui.events import SceneClickEventArguments
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.app.live.views import LiveView, drawn_ellipsoid, track_colours
from armsight.app.operator.identify_run import SweepFit
from armsight.app.operator.robot_cell import arm_points, read_placement
from armsight.arrays import Array
from armsight.console import texts
from armsight.console.plots import Curve, Ruler, Ticks
from armsight.console.state import Console
from armsight.errors import ArmsightError
from armsight.ops.measurement.run import target_of
from armsight.optics import Rig, RigKind
from armsight.records import Target
from armsight.store import read_rig
from armsight.store.cell_file import cell_path
from armsight.store.handeye_file import read_tip

FRUSTUM_M = 0.12
"""Length of the pyramids that stand for cameras."""
SCENE_PX = 420
NEAREST_M, FARTHEST_M = 0.003, 30.0
"""From the eye: what is outside is not drawn; a path of a few mm is looked at from as near."""
SCENE_HZ = 8
ROUND = (12, 8)
"""Faces about a ball, and from pole to pole: a computer without a graphics processor draws few in time."""
"""Drawings a second: more would slow a tablet's other work, of which the enable is the first."""
LIGHT_M, SMALL_M = 0.008, 0.03
"""Radius of a light; size of a target below which the names of its lights would hide it."""
BONE_M, JOINT_M = 0.03, 0.042
"""Radii in which an arm's links and joints are drawn."""
SEEN_RAD = 2e-4
"""Joints (rad or m) that moved less are not drawn anew."""
CAMERA_COLOURS = ("#0072B2", "#CC79A7", "#00775a", "#8a5a00", "#7a4fb5", "#005a7a", "#a0306e", "#4d6b00")
"""Of cameras in the rig's order; of a pair left and right."""
COLOURS = {
    "camera": "#46515c",
    "target": "#D55E00",
    "arm": "#8a97a3",
    "joint": "#46515c",
    "uncertainty": "#E69F00",
    "robot": "#14181c",
}
FIT_COLOURS = ("#0072B2", "#7a4fb5", "#00775a", "#8a5a00", "#a0306e", "#14181c")
"""Of joints' sweeps and axes; each has its number beside it."""
POINT = "place-"
"""Begins the name of a path's ball."""
POINT_NAME = re.compile(f"{POINT}([0-9]{{1,9}})")
PATH_COLOUR = "#7a4fb5"
SEEN_THROUGH = 0.12
"""Opacity of an arm that is looked at from near: curves run within its joints."""
AROUND = np.array([1.2, -1.5, -1.7])
"""From the middle of what cameras that are no pair look at to the eye, in their largest distance from it, rig axes: so
far that the picture of a phone, higher than wide, shows all of them."""
BACK = 1.2
"""How far the eye is from the middle of what it looks at from near, in its diagonals."""
ASIDE = Rotation.from_euler("z", 35.0, degrees=True)
"""From the cameras' direction to the eye's: no axis of a cell set up square to them is seen end on."""
UPRIGHT = RigidTransform.from_rotation(Rotation.from_matrix([[1, 0, 0], [0, 0, 1], [0, -1, 0]]))
"""From a rig's axes (x right, y down, z forward) to a screen's (z up), where its position in world is not known."""


class Scene:
    """A 3-D view on a page; `show` moves what moves."""

    def __init__(self, console: Console, picked: Callable[[int], None] | None = None) -> None:
        """Draw what the cell has onto the page that is being built; picked: is told which position of a path is
        clicked.

        Raises BadFile.
        """
        self._picked = picked
        self._console = console
        cell, folder = console.cell, console.folder
        rig_file, target_file = (cell_path(folder, getattr(cell, name), name) for name in ("rig", "target"))
        self._arm = None if console.robot is None else console.robot.session.arm
        self._q: Array | None = self._joints()
        self._placement = read_placement(folder, cell, target=False)
        placed = self._placement.rig_pose(self._arm, self._q)
        if placed is None and rig_file is not None:
            self._arm = None  # where the arm stands before these cameras is not known yet
        self._T_scene_rig = UPRIGHT if placed is None else placed
        tip_file = cell_path(folder, cell.tip, "tip")
        self._tip_m = np.zeros(3) if tip_file is None else np.array(read_tip(tip_file).tip_m)
        self._near = False
        self.scale = 0.0
        made = ui.scene(
            height=SCENE_PX,
            grid=(4, 20),
            camera=ui.scene.perspective_camera(near=NEAREST_M, far=FARTHEST_M),
            background_color="#dfe5ea",
            on_click=self._clicked,
            fps=SCENE_HZ,
        )
        with made.classes("w-full") as self._scene:
            self._scene.props["data-testid"] = "scene"
            self._target = self._draw_target(None if target_file is None else target_of(target_file))
            self._rig = None if rig_file is None else read_rig(rig_file, any_cameras=True)
            self._cameras = self._draw_cameras(self._rig)
            self._bones = [] if self._arm is None else [self._draw_bone() for _ in range(2 * self._arm.n + 1)]
            self._measured = Curve("measured", line="none", mark_px=4.0, layer=2)
            self._taught = Curve("taught", line="solid", mark_px=6.0, layer=1)
            self._tool = Curve("tool", line="dashed", mark_px=2.0, layer=3)
            self._ruler = Ruler(self._scene)
            self._path = self._scene.group()
            self._ellipsoid = self._scene.sphere(1.0, *ROUND).material(COLOURS["uncertainty"], opacity=0.45)
        self._target.visible(False)
        self._ellipsoid.visible(False)
        self.look_at_cell()
        self._show_arm(anew=True)

    @property
    def has_arm(self) -> bool:
        """Whether an arm is drawn, with where its tool was."""
        return self._arm is not None

    def show(self, view: LiveView | None) -> None:
        """Put arm, carried cameras and target where they are; hide the target where it is not seen."""
        self._show_arm()
        has_pose = view is not None and view.xyz_m is not None and view.quat_xyzw is not None
        self._target.visible(has_pose)
        T = self._T_scene_rig if view is not None and view.parent == "rig" else RigidTransform.identity()
        self._show_uncertainty(view, T)
        if view is None or view.xyz_m is None or view.quat_xyzw is None:
            return
        T_scene_target = T * RigidTransform.from_components(view.xyz_m, Rotation.from_quat(view.quat_xyzw))
        _put(self._target, T_scene_target)
        std_m = float(np.linalg.norm(view.std[:3])) if view.std is not None else np.nan
        self._console.tracks.add_measured(T_scene_target.apply(self._tip_m), std_m)

    def show_track(self) -> tuple[float, float] | None:
        """Draw where the arm's tool was, and the target, coloured by its standard deviation; return these' ends.

        In m, the norm of those of x, y and z; None where nothing was seen, or no standard deviation is known.
        """
        tracks = self._console.tracks
        if self.has_arm:
            self._tool.show(tracks.tool, [_rgb(COLOURS["robot"])] * len(tracks.tool))
        if self._near:
            self._ruler.show(self._ticks())
        std_m = np.array([std for _, std in tracks.measured])
        self._measured.show([position for position, _ in tracks.measured], track_colours(std_m).round(2).tolist())
        known = std_m[np.isfinite(std_m)]
        return (float(known.min()), float(known.max())) if len(known) else None

    def look_at_paths(self) -> bool:
        """Look at the curves from near, with axes in mm about them; False where there are none."""
        ticks = self._ticks()
        if ticks is None:
            return False
        self._look_from(near=True)
        self._ruler.show(ticks)
        eye = ASIDE.apply(self._T_scene_rig.translation - ticks.centre_m)
        eye[2] = max(eye[2], 0.5 * float(np.linalg.norm(eye[:2])))  # and from above
        x, y, z = (ticks.centre_m + BACK * ticks.span_m * eye / np.linalg.norm(eye)).tolist()
        to_x, to_y, to_z = ticks.centre_m.tolist()
        self._scene.move_camera(x, y, z, to_x, to_y, to_z, 0.0, 0.0, 1.0, duration=0.0)
        return True

    def _look_from(self, *, near: bool) -> None:
        self._near = near
        for parts in self._bones:
            for part, kind in zip(parts, ("arm", "joint"), strict=True):
                part.material(COLOURS[kind], opacity=SEEN_THROUGH if near else 1.0)

    def _ticks(self) -> Ticks | None:
        positions = [position for curve in (self._measured, self._taught, self._tool) for position in curve.positions]
        return Ticks.about(np.array(positions)) if positions else None

    def _show_uncertainty(self, view: LiveView | None, T_scene_parent: RigidTransform) -> None:
        """Draw the ellipsoid of the position where it is; `scale` tells how enlarged, 0 without one."""
        drawn = None
        if view is not None and view.xyz_m is not None and view.covariance_m2 is not None:
            R = T_scene_parent.rotation.as_matrix()
            drawn = drawn_ellipsoid(R @ np.array(view.covariance_m2) @ R.T)
        self._ellipsoid.visible(drawn is not None)
        self.scale = 0.0 if drawn is None else drawn.scale
        if drawn is not None and view is not None:
            self._ellipsoid.move(*T_scene_parent.apply(np.array(view.xyz_m)).tolist())
            self._ellipsoid.rotate_R(drawn.R.tolist())
            self._ellipsoid.scale(*drawn.semi_axes_m.tolist())

    def show_path(self, xyz_m: Array, chosen: Collection[int] = ()) -> None:
        """Draw a path (n, 3) in world; the ball at its start is larger, those chosen are in another colour."""
        self._path.delete()
        positions = xyz_m.tolist()
        apart_m = np.linalg.norm(np.diff(xyz_m, axis=0), axis=1)
        radius = float(np.clip(0.3 * np.median(apart_m), 0.0015, 0.005)) if len(apart_m) else 0.005
        with self._scene, self._scene.group() as self._path:
            for i, position in enumerate(positions):
                ball = self._scene.sphere((1.8 if i == 0 or i in chosen else 1.0) * radius, *ROUND).move(*position)
                ball.with_name(f"{POINT}{i}").material(COLOURS["target"] if i in chosen else PATH_COLOUR)
        self._taught.show([tuple(position) for position in positions], [_rgb(PATH_COLOUR)] * len(positions))

    def _clicked(self, event: SceneClickEventArguments) -> None:
        found = next((match for hit in event.hits if (match := POINT_NAME.fullmatch(str(hit.object_name)))), None)
        if found is not None and self._picked is not None:
            self._picked(int(found[1]))

    def show_fits(self, fits: Collection[SweepFit], *, placed: bool) -> None:
        """Draw of each sweep its arc or line, the joint's axis with its number, and dots for what was seen.

        placed: they are in world, else in rig axes.
        """
        T = RigidTransform.identity() if placed else self._T_scene_rig
        self._path.delete()
        with self._scene, self._scene.group() as self._path:
            for fit in fits:
                colour = FIT_COLOURS[(fit.joint - 1) % len(FIT_COLOURS)]
                lines = [*pairwise(T.apply(fit.path).tolist()), tuple(T.apply(fit.axis).tolist())]
                if fit.centre is not None:
                    lines += [(T.apply(fit.centre).tolist(), T.apply(fit.path[end]).tolist()) for end in (0, -1)]
                for one, next_ in lines:
                    self._scene.line(one, next_).material(colour)
                label = self._scene.text(texts.FIT_JOINT.format(joint=fit.joint), f"font-weight: 700; color: {colour}")
                label.move(*T.apply(fit.axis[1]).tolist())
                for position in T.apply(fit.seen).tolist():
                    self._scene.sphere(0.004, *ROUND).move(*position).material(COLOURS["target"])

    def _joints(self) -> Array | None:
        try:
            return None if self._console.robot is None else self._console.robot.joints()
        except ArmsightError:
            return None

    def _show_arm(self, *, anew: bool = False) -> None:
        """Draw the arm, and the cameras that it carries, where its joints are; nothing where it did not move."""
        q = self._joints()
        if self._arm is None or q is None:
            return
        if not anew and self._q is not None and np.abs(q - self._q).max() < SEEN_RAD:
            return
        self._q = q
        points = arm_points(self._arm, q)
        for (bone, joint), (begin, end) in zip(self._bones, pairwise(points), strict=True):
            _stretch(bone, begin, end)
            joint.move(*end.tolist())
        self._console.tracks.add_tool(points[-1])
        if self._console.cell.on_robot:
            placed = self._placement.rig_pose(self._arm, q)
            self._T_scene_rig = self._T_scene_rig if placed is None else placed
            _put(self._cameras, self._T_scene_rig)

    def _draw_target(self, target: Target | None) -> Object3D:
        group: Object3D
        with self._scene.group() as group:
            if target is not None and not target.is_board:
                apart_m = float(np.ptp(target.xyz_m, axis=0).max())
                radius = min(LIGHT_M, 0.15 * apart_m) if apart_m > 0.0 else LIGHT_M
                for name, light in zip(target.names, target.xyz_m.tolist(), strict=True):
                    self._scene.sphere(radius, *ROUND).move(*light).material(COLOURS["target"])
                    if apart_m > SMALL_M:
                        self._scene.text(name, "font-weight: 700; font-size: 12px; color: #14181c").move(*light)
            for axis, colour in zip(np.eye(3) * 0.06, ("#D55E00", "#009E73", "#0072B2"), strict=True):
                self._scene.line([0, 0, 0], axis.tolist()).material(colour)
        return group

    def _draw_cameras(self, rig: Rig | None) -> Object3D:
        """Draw cameras as the pyramids they see through, in rig axes; of a mirror rig both virtual ones and the real
        one."""
        group: Object3D
        with self._scene.group() as group:
            for colour, camera in zip(CAMERA_COLOURS, () if rig is None else rig.cameras, strict=False):
                self._draw_pyramid(camera.T_rig_camera, colour)
                if rig is not None and not rig.is_pair:
                    label = self._scene.text(camera.name, "font-weight: 700; font-size: 12px; color: #14181c")
                    label.move(*camera.T_rig_camera.translation.tolist())
            if rig is not None and rig.kind is RigKind.MIRROR:
                self._draw_pyramid(RigidTransform.identity(), COLOURS["camera"], 0.4)
        _put(group, self._T_scene_rig)
        return group

    def _draw_pyramid(self, T_rig_camera: RigidTransform, colour: str, share: float = 1.0) -> None:
        corners = share * FRUSTUM_M * np.array([[-0.6, -0.35, 1], [0.6, -0.35, 1], [0.6, 0.35, 1], [-0.6, 0.35, 1]])
        centre, positions = T_rig_camera.translation.tolist(), T_rig_camera.apply(corners).tolist()
        for one, next_ in zip(positions, [*positions[1:], positions[0]], strict=True):
            self._scene.line(centre, one).material(colour)
            self._scene.line(one, next_).material(colour)

    def _draw_bone(self) -> tuple[Object3D, Object3D]:
        bone = self._scene.cylinder(BONE_M, BONE_M, 1.0, ROUND[0]).material(COLOURS["arm"])
        return bone, self._scene.sphere(JOINT_M, *ROUND).material(COLOURS["joint"])

    def look_at_cell(self) -> None:
        """Look at what the cameras see, from beside and above them; from nearer where there is no arm to be seen."""
        near = self._arm is None
        self._look_from(near=False)
        self._ruler.show(None)
        eye, to = (
            np.array([0.55, -0.4, 0.1] if near else [0.75, -0.65, -0.15]),
            np.array([0.02, 0.0, 0.4 if near else 0.7]),
        )
        if self._rig is not None and not self._rig.is_pair:  # they may stand all round
            ends = [one.T_rig_camera.apply([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) for one in self._rig.cameras]
            to = np.mean(ends, axis=(0, 1))
            eye = to + AROUND * max(1.0, float(np.linalg.norm(np.concatenate(ends) - to, axis=1).max()))
        x, y, z = self._T_scene_rig.apply(eye).tolist()
        to_x, to_y, to_z = self._T_scene_rig.apply(to).tolist()
        self._scene.move_camera(x, y, z, to_x, to_y, to_z, 0.0, 0.0, 1.0, duration=0.0)


def _rgb(colour: str) -> tuple[float, float, float]:
    r, g, b = (round(int(colour[k : k + 2], 16) / 255.0, 2) for k in (1, 3, 5))
    return r, g, b


def _put(thing: Object3D, T_scene_thing: RigidTransform) -> None:
    thing.move(*T_scene_thing.translation.tolist())
    thing.rotate_R(T_scene_thing.rotation.as_matrix().tolist())


def _stretch(bone: Object3D, begin: Array, end: Array) -> None:
    """Let a cylinder of height 1 along y reach from one position (3,) to another; hide it where they are one."""
    way = end - begin
    length_m = float(np.linalg.norm(way))
    bone.visible(length_m > 1e-6)
    if length_m <= 1e-6:
        return
    R, _ = Rotation.align_vectors([way / length_m], [[0.0, 1.0, 0.0]])
    bone.scale(1.0, length_m, 1.0)
    bone.rotate_R(R.as_matrix().tolist())
    bone.move(*(0.5 * (begin + end)).tolist())
