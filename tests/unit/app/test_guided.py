"""Guided calibrations: what to do next follows from what there is, and the result is the commands' own."""

from __future__ import annotations

import shutil
import threading
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.app.guided.boards import BoardCalibration
from armsight.app.guided.poses import HandEyeStep, TipCalibrationStep, seen_pose
from armsight.app.guided.step import Hint, Next, Sample, StepResult
from armsight.app.guided.step_runner import GuidedStepRunner, figures_of
from armsight.app.live.station import Snapshot
from armsight.app.live.views import Counts, LiveView, RunView, SideView, SpotView, live_view
from armsight.app.operator.station_observer import StationObserver
from armsight.clock import ManualClock
from armsight.console import texts
from armsight.errors import BadImage, DeviceFailed, NotEnoughData
from armsight.kinematics import presets
from armsight.ops.calibrate_cameras import calibrate_stereo
from armsight.ops.calibrate_rig import calibrate_cameras
from armsight.optics import Camera, MountedCamera, Rig, RigKind
from armsight.records import JointReading, PoseStatus, Silent, Spots, TargetPose
from armsight.records.result_parts import Verdict
from armsight.store import read_rig
from armsight.store.handeye_file import read_handeye, read_tip
from refusals import refuses

SIDE = SideView(width=4, height=3, spots=[], epipolar=[], advice="good", background=0.0, brightest=None, sigma_px=None)


class Pictures:
    """Stands for a station: gives the pairs of a folder one after the other."""

    def __init__(self, folder: Path) -> None:
        self.pairs = [
            (folder / "left" / p.name, folder / "right" / p.name) for p in sorted((folder / "left").iterdir())
        ]

    def save(self, files: dict[str, Path]) -> None:
        pictures = dict(zip(("left", "right"), self.pairs.pop(0), strict=True))
        for name, goal in files.items():
            source = pictures[name]
            goal.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, goal)


class Poses:
    """Stands for a station that shows given poses one after the other."""

    def __init__(self, poses: list[tuple[np.ndarray, Rotation]]) -> None:
        self.poses = poses

    def shown_since(self, t_s: float) -> Snapshot:
        xyz, turn = self.poses.pop(0)
        view = LiveView(
            sequence=1, t_s=t_s, fps=30.0, latency_s=0.01, measuring_s=0.001, status="ok", why="",
            parent="rig", xyz_m=tuple(xyz), euler_rad=(0.0, 0.0, 0.0), quat_xyzw=tuple(turn.as_quat()),
            std=(1e-4,) * 3 + (1e-3,) * 3, residual_px=0.1, counts=Counts(ok=1, doubtful=0, position_only=0, lost=0),
            cameras={"left": SIDE, "right": SIDE},
        )  # fmt: skip
        T = RigidTransform.from_components(xyz, turn).as_matrix()
        C = np.diag([1e-8] * 3 + [1e-6] * 3)
        pose = TargetPose(t_s=t_s, status=PoseStatus.OK, parent="rig", T_parent_target=T, covariance=C)
        return Snapshot(pose=pose, spots=(Spots.none(), Spots.none()), view=view, jpegs={})


def test_what_was_measured_comes_with_its_whole_covariance_and_what_is_doubtful_is_no_pose_to_take() -> None:
    A, B = np.random.default_rng(3).standard_normal((2, 6, 6)) * 1e-4
    pose = TargetPose(
        t_s=1.0, status=PoseStatus.OK, parent="rig", T_parent_target=np.eye(4), covariance=A @ A.T + B @ B.T,
        systematic_covariance=B @ B.T,
    )  # fmt: skip
    station: Any = SimpleNamespace(shown_since=lambda t_s: SimpleNamespace(pose=pose))
    assert seen_pose(station, 0.0) is pose
    station.shown_since = lambda t_s: SimpleNamespace(pose=replace(pose, status=PoseStatus.DOUBTFUL, why="it shakes"))
    with refuses(NotEnoughData, "shakes"):
        seen_pose(station, 0.0)


def shown_once(sides: dict[str, Any], spots: tuple[Spots, ...]) -> Any:
    """A station that shows one moment without a pose."""
    run = RunView(fps=30.0, latency_s=0.01, measuring_s=0.001, counts=Counts(ok=0, doubtful=0, position_only=0, lost=1))
    lost = TargetPose(t_s=1.0, status=PoseStatus.LOST, parent="rig", why="one light alone")
    shown = Snapshot(pose=lost, spots=spots, view=live_view(lost, run, sides), jpegs={})
    return SimpleNamespace(shown=shown, failure="")


def test_a_beacon_is_of_the_cameras_that_show_it_but_not_of_one_that_is_left_out() -> None:
    camera, place = Camera.pinhole(1280, 720, 950.0, 950.0, 640.0, 360.0), np.array([[0.0, 0.05, 1.0]])
    rig = Rig(
        cameras=[
            MountedCamera(
                name=f"c{i}", camera=camera, T_rig_camera=RigidTransform.from_translation([0.1 * i, 0.0, 0.0])
            )
            for i in range(4)
        ]
    )
    uv = np.concatenate(rig.project(place))
    sides = {
        name: replace(SIDE, spots=[SpotView(name="A", u_px=u, v_px=v, residual_px=None)])
        for name, (u, v) in zip(rig.names, uv.tolist(), strict=True)
    }
    sides["c0"] = replace(sides["c0"], spots=[])
    sides["c2"] = replace(sides["c2"], left_out="it was knocked")
    spots = (Spots.none(), *(Spots.of_centres(one[None], 1e-4 * np.eye(2)) for one in uv[1:]))
    seen = StationObserver(shown_once(sides, spots), rig, "A", ManualClock()).observe("now")
    assert seen.uv_px is not None and np.isnan(seen.uv_px[[0, 2]]).all()
    np.testing.assert_array_equal(seen.uv_px[[1, 3]], uv[[1, 3]])
    assert seen.xyz_m == pytest.approx(place[0], abs=1e-9)
    sides["c3"] = replace(sides["c3"], spots=[])
    alone = StationObserver(shown_once(sides, spots), rig, "A", ManualClock()).observe("now")
    assert alone.uv_px is None and "two cameras" in alone.why


def test_a_beacon_is_told_with_the_deviation_that_its_light_has_in_the_pictures() -> None:
    """A named light's own covariance, and the other view's of a light that is followed from place to place."""
    camera = Camera.pinhole(1280, 720, 950.0, 950.0, 640.0, 360.0)
    right = RigidTransform.from_translation([0.12, 0.0, 0.0])
    rig = Rig(kind=RigKind.STEREO, left=camera, right=camera, T_rig_left=RigidTransform.identity(), T_rig_right=right)
    uv = np.concatenate(rig.project(np.array([[0.0, 0.05, 1.0]])))
    covariances = [np.diag([1e-4, 4e-4]), np.diag([9e-4, 1e-4])]
    sides = [
        replace(SIDE, spots=[SpotView(name=name, u_px=u, v_px=v, residual_px=None)])
        for name, (u, v) in zip(("A", "A"), uv.tolist(), strict=True)
    ]
    others = np.array([[900.0, 500.0]])  # a light of the room
    spots = tuple(
        Spots.of_centres(np.concatenate([others, one[None]]), np.stack([np.eye(2), C]))
        for one, C in zip(uv, covariances, strict=True)
    )
    station = shown_once(dict(zip(("left", "right"), sides, strict=True)), spots)
    seen = StationObserver(station, rig, "A", ManualClock()).observe("while it is tested")
    assert seen.std_px == pytest.approx(0.03) and seen.xyz_m == pytest.approx([0.0, 0.05, 1.0], abs=1e-9)


def test_a_rig_is_led_to_the_result_of_the_command(boards: Any, tmp_path: Path) -> None:
    step = BoardCalibration(board=boards.board, folder=tmp_path / "pictures", out=tmp_path / "rig.yaml")
    station: Any = Pictures(boards.folder)
    assert step.hint().what is Next.SHOW_BOARD
    for _ in range(len(station.pairs)):
        step.accept(station)
    assert sum(step.coverage()["left"]) > 10
    assert dict(step.spread())["baseline"].endswith("mm")
    assert {figure.name for figure in figures_of(step)} == {"residual, RMS", "picture covered"} | {
        f"± {name}" for name, _ in step.spread()
    }
    assert {name for name, _ in step.spread()} | {figure.name for figure in figures_of(step)} <= set(texts.ROW_NAMES)
    verdict = step.run(Silent())
    again = calibrate_stereo(boards.folder / "left", boards.folder / "right", boards.board)
    # few boards leave corners of the images bare: page, report and terminal say so alike
    assert verdict.verdict.level == "care" and verdict.verdict.to_dict() == again.verdict_.to_dict()
    assert dict(verdict.rows)["baseline"] == f"{1e3 * again.baseline_m:.2f} mm"
    assert verdict.file.exists()
    assert verdict.report is not None
    assert verdict.report.exists()


class ThreeCameras:
    """Stands for a station of three cameras round a board that a hand turns, of which two at a time see it."""

    NAMES = ("a", "b", "top")
    FOCAL_PX, SQUARE_M = 560.0, 0.02

    def __init__(self) -> None:
        squares = np.kron(np.indices((6, 8)).sum(axis=0) % 2, np.ones((40, 40)))
        self.sheet = np.pad(200.0 * squares + 25.0, 40, constant_values=225.0).astype(np.uint8)
        middle = 0.5 * np.array(self.sheet.shape[::-1])
        scale = self.SQUARE_M / 40.0
        self.to_m = np.array([[scale, 0.0, -scale * middle[0]], [0.0, scale, -scale * middle[1]], [0.0, 0.0, 1.0]])
        self.places = np.array([[-0.12, 0.0, 0.0], [0.12, 0.0, 0.0], [0.0, -0.15, 0.02]])
        self.rng, self.taken = np.random.default_rng(2), 0

    def looking(self, c: int) -> Rotation:
        """Return the rotation of a camera's axes, z to the place where the board is."""
        z = np.array([0.0, 0.0, 0.42]) - self.places[c]
        z /= np.linalg.norm(z)
        x = np.cross([0.0, 1.0, 0.0], z)
        x /= np.linalg.norm(x)
        return Rotation.from_matrix(np.column_stack([x, np.cross(z, x), z]))

    def save(self, files: dict[str, Path]) -> None:
        i, self.taken = self.taken, self.taken + 1
        turn = Rotation.from_euler("xyz", [*self.rng.uniform(-28.0, 28.0, 2), self.rng.uniform(-30, 30)], degrees=True)
        at = np.array([*self.rng.uniform(-0.09, 0.09, 2), self.rng.uniform(0.36, 0.48)])
        K = np.array([[self.FOCAL_PX, 0.0, 322.0], [0.0, self.FOCAL_PX, 238.0], [0.0, 0.0, 1.0]])
        twice = np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5], [0.0, 0.0, 1.0]])
        for c, name in enumerate(self.NAMES):
            R = (self.looking(c).inv() * turn).as_matrix()
            t = self.looking(c).inv().apply(at - self.places[c])
            H = twice @ K @ np.column_stack([R[:, 0], R[:, 1], t]) @ self.to_m
            large = cv2.warpPerspective(self.sheet, H, (1280, 960), flags=cv2.INTER_LINEAR, borderValue=225)
            image = cv2.GaussianBlur(large.reshape(480, 2, 640, 2).mean(axis=(1, 3)), (0, 0), 0.8)
            if i % 4 == c:  # a hand is before it
                image = np.full_like(image, 90.0)
            files[name].parent.mkdir(parents=True, exist_ok=True)
            noisy = image + self.rng.normal(0.0, 2.0, image.shape)
            cv2.imwrite(str(files[name]), np.clip(np.rint(noisy), 0, 255).astype(np.uint8))


def test_three_cameras_are_led_to_the_result_of_the_command(tmp_path: Path) -> None:
    station: Any = ThreeCameras()
    out, pictures = tmp_path / "rig.yaml", tmp_path / "pictures"
    step = BoardCalibration(board="checkerboard:7x5:0.02", folder=pictures, out=out, sides=station.NAMES)
    assert step.name == "cameras" and step.hint().what is Next.SHOW_BOARD
    for _ in range(12):
        step.accept(station)
    assert step.hint().what is Next.TO_CELL and step.samples[0].detail.endswith("seen by b, top")
    assert {name for name, _ in step.spread()} >= {"top place", "a focal length"}
    done = step.run(Silent())
    again = calibrate_cameras({name: str(pictures / name) for name in station.NAMES}, step.board)
    assert done.verdict.level in ("good", "care") and done.verdict.to_dict() == again.verdict_.to_dict()
    assert done.report is not None and done.report.exists()
    rig = read_rig(out, any_cameras=True)
    first = station.looking(0).inv()
    for c, name in enumerate(station.NAMES):
        true = first.apply(station.places[c] - station.places[0])
        off_m = np.linalg.norm(np.asarray(rig.T_rig_camera(name).translation) - true)
        assert off_m <= 4.0 * np.linalg.norm([again.solved.covariance.std().get(f"{name}.t{x}", 0.0) for x in "xyz"])
        assert dict(done.rows)[f"{name} place"].endswith("mm")


def turns(n: int, seed: int) -> Rotation:
    """Rotations of up to 50 degrees about all axes."""
    return Rotation.from_rotvec(np.random.default_rng(seed).uniform(-0.9, 0.9, (n, 3)))


def test_a_tip_is_found_where_the_target_was_turned_about_it(tmp_path: Path) -> None:
    tip, point = np.array([0.01, -0.02, 0.18]), np.array([0.05, 0.02, 0.7])
    station: Any = Poses([(point - turn.apply(tip), turn) for turn in turns(30, 1)])
    step = TipCalibrationStep(folder=tmp_path / "tip", out=tmp_path / "tip.yaml")
    assert step.hint().what is Next.TURN_TARGET
    for _ in range(30):
        step.accept(station)
    assert step.hint().what is Next.RUN
    assert step.run(Silent()).verdict.level == "good"
    np.testing.assert_allclose(read_tip(tmp_path / "tip.yaml").tip_m, tip, atol=1e-6)


@dataclass
class CarriedCamera:
    """A camera on the flange of a UR10, the target still in the cell; poses by the public DH table, of an arm that
    counts one joint the other way round and whose base stands askew in the cell."""

    folder: Path
    q: np.ndarray
    moves_while_seen: bool = False
    hangs: bool = False

    def __post_init__(self) -> None:
        arm = presets.ur10()
        turned = replace(arm.joints[1], sign=-1.0, lower=-arm.joints[1].upper, upper=-arm.joints[1].lower)
        T_world_base = RigidTransform.from_components([0.4, -0.2, 0.7], Rotation.from_euler("xyz", [0.1, -0.2, 1.0]))
        joints = (arm.joints[0], turned, *arm.joints[2:])
        self.arm = replace(arm, joints=joints, T_world_base=T_world_base)
        self.arm.save(self.folder / "arm.yaml")
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler("xyz", [5.0, -20.0, 90.0], degrees=True).as_matrix()
        T[:3, 3] = [0.03, 0.08, 0.05]
        self.T_flange_camera = T
        before = np.eye(4)
        before[2, 3] = 0.8  # of the camera where the arm is at home
        T_base_target = arm.fk(HOME * [1, -1, 1, 1, 1, 1]) @ T @ before
        seen = np.linalg.inv(arm.fk(self.q * [1, -1, 1, 1, 1, 1]) @ T) @ T_base_target
        self.station: Any = Poses([(T[:3, 3], Rotation.from_matrix(T[:3, :3])) for T in seen])
        self._read = 0

    def read_joints(self) -> JointReading:
        """Where the arm stands: before and after each picture, of which the second reading is the newer one."""
        row, after = divmod(self._read, 2)
        self._read += 1
        q = self.q[row] + (0.001 if after and self.moves_while_seen else 0.0)
        return JointReading(q=q, t_s=AFTER_S if after and not self.hangs else 0.0, sequence=self._read, source="arm")

    def step(self) -> HandEyeStep:
        out = self.folder / "handeye.yaml"
        return HandEyeStep(folder=self.folder, out=out, arm=self.folder / "arm.yaml", read_joints=self.read_joints)


AFTER_S = 1e12
"""Later than any picture."""
HOME = np.array([0.2, 1.2, 1.7, -1.0, 1.4, 0.3])


def test_hand_eye_is_found_from_joints_and_poses(tmp_path: Path) -> None:
    cell = CarriedCamera(tmp_path, HOME + np.random.default_rng(4).uniform(-0.4, 0.4, (15, 6)))
    step = cell.step()
    for _ in cell.q:
        step.accept(cell.station)
    verdict = step.run(Silent())
    assert verdict.verdict.level == "good", verdict.verdict.reasons
    found = read_handeye(tmp_path / "handeye.yaml").T_parent_camera.as_matrix()
    np.testing.assert_allclose(found, cell.T_flange_camera, atol=1e-6)


def test_a_hand_that_hardly_turned_is_not_to_be_trusted_and_the_axis_is_named(tmp_path: Path) -> None:
    """Only the last joint, which turns the hand about its own z, was moved far."""
    q = np.tile(HOME, (15, 1)) + np.random.default_rng(5).normal(0.0, 0.04, (15, 6))
    q[:, 5] += np.linspace(-1.0, 1.0, 15)
    cell = CarriedCamera(tmp_path, q)
    step = cell.step()
    for _ in q:
        step.accept(cell.station)
    hint = step.hint()
    assert hint.what is Next.TURN_HAND and hint.axis in ("x", "y") and hint.share < 0.5
    assert 33.0 < float(dict(step.spread())["turned about its own z"].split()[0]) < 38.0
    verdict = step.run(Silent())
    assert verdict.verdict.level == "care"
    assert "20 degrees" in verdict.verdict.next[0]


def test_no_pose_is_taken_while_the_robot_moves(tmp_path: Path) -> None:
    cell = CarriedCamera(tmp_path, np.tile(HOME, (2, 1)), moves_while_seen=True)
    step = cell.step()
    with refuses(NotEnoughData, "moved"):
        step.accept(cell.station)
    assert step.samples == ()


def test_no_pose_is_taken_with_joints_older_than_the_picture(tmp_path: Path) -> None:
    cell = CarriedCamera(tmp_path, np.tile(HOME, (2000, 1)), hangs=True)
    step = replace(cell.step(), clock=ManualClock(10.0))
    with refuses(DeviceFailed, "late"):
        step.accept(cell.station)
    assert step.samples == ()


def test_a_board_that_was_not_moved_is_not_taken_twice(boards: Any, tmp_path: Path) -> None:
    step = BoardCalibration(board=boards.board, folder=tmp_path / "p", out=tmp_path / "rig.yaml")
    station: Any = Pictures(boards.folder)
    station.pairs[1] = station.pairs[0]
    step.accept(station)
    with refuses(BadImage, "picture 000"):
        step.accept(station)
    step.accept(station)
    assert [sample.name for sample in step.samples] == ["000", "001"]


@dataclass
class PublishedValue:
    """A step that does as it is told."""

    name: str = "told"
    fails: Exception | None = None
    taken: list[Sample] = field(default_factory=list)
    entered: threading.Event = field(default_factory=threading.Event)
    leave: threading.Event = field(default_factory=threading.Event)

    @property
    def samples(self) -> tuple[Sample, ...]:
        return tuple(self.taken)

    def hint(self) -> Hint:
        return Hint(what=Next.MORE)

    def coverage(self) -> dict[str, tuple[int, ...]]:
        return {}

    def spread(self) -> tuple[tuple[str, str], ...]:
        return ()

    def accept(self, station: Any) -> Sample:
        self.entered.set()
        assert self.leave.wait(60.0)
        self.taken.append(Sample(name=str(len(self.taken)), detail=""))
        return self.taken[-1]

    def drop(self, index: int) -> None:
        del self.taken[index]

    def run(self, progress: Any) -> StepResult:
        if self.fails is not None:
            raise self.fails
        verdict = Verdict(level="good", headline="Good", reasons=[f"{len(self.taken)} taken"], next=[])
        return StepResult(verdict=verdict, rows=(), file=Path("x.yaml"))


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (NotEnoughData("5 poses are few", cure="Take 10"), "5 poses are few. Take 10."),
        (ZeroDivisionError("division by zero"), "The program failed: ZeroDivisionError: division by zero."),
    ],
)
def test_why_nothing_was_calibrated_is_told_whatever_it_was(error: Exception, said: str) -> None:
    runner = GuidedStepRunner(PublishedValue(fails=error))
    runner.run(Silent())
    assert runner.state.not_done.startswith(said)
    assert runner.state.result is None and runner.state.busy == ""


def test_calibrate_pressed_while_a_sample_is_taken_waits_for_it_and_its_verdict_stays() -> None:
    step = PublishedValue()
    runner = GuidedStepRunner(step)
    accepting = threading.Thread(target=runner.accept, args=(lambda: None,))
    accepting.start()
    assert step.entered.wait(60.0)
    assert runner.state.busy == "accept"
    running = threading.Thread(target=runner.run, args=(Silent(),))
    running.start()
    step.leave.set()
    for thread in (accepting, running):
        thread.join(60.0)
    verdict = runner.state.result
    assert verdict is not None and verdict.verdict.reasons == ["1 taken"]
    runner.drop(0)
    assert runner.state.result is None, "it is of samples that are no more"
