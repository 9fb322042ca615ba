"""Paths as G-code for LinuxCNC: refused where its joints would pass their limits, and run by the real one.

LinuxCNC itself is the truth: it shares no code with what works out its motion. Where it is not installed the tests that
run it are skipped.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import armsight
from armsight.control.guard import Limits
from armsight.control.guard.limits import JointLimit, joint_bounds
from armsight.control.paths.exports import gcode
from armsight.control.paths.linuxcnc import MARGINS, Axes, LinuxcncPlan, plan_lines, require_kept
from armsight.control.paths.program import program_moves
from armsight.errors import Inconsistent, UsageError
from armsight.kinematics import Arm, Convention, Joint
from armsight.records import TaughtPath
from linuxcnc_player import Played, missing, play
from refusals import refuses

INCH = 0.0254
ROWS = tuple(
    (INCH * a, np.deg2rad(alpha), INCH * d)
    for a, alpha, d in zip((0, 0, 17, 0, 0, 0), (0, -90, 0, -90, 90, -90), (26.45, 0, -5.5, 17.05, 0, 2.2), strict=True)
)
"""a, alpha and d of LinuxCNC's own Puma 560, in Craig's convention."""
ENDS = np.deg2rad([(-180, 180), (-360, 360), (-215, 35), (-360, 360), (-360, 360), (-360, 360)])
SPEED, ACCELERATION = np.deg2rad(30.0), np.deg2rad(200.0)
HOME = np.array([0.1, -0.4, 0.5, -0.8, 0.9, 0.4])
AXES = Axes(acceleration_m_s2=0.5, acceleration_rad_s2=np.pi)
runs = pytest.mark.skipif(bool(missing()), reason=missing())


def puma(tool_m: float = 0.1) -> Arm:
    """The Puma with a tool, which LinuxCNC knows nothing of."""
    joints = tuple(
        Joint(name=f"j{j + 1}", a_m=a, alpha_rad=alpha, d_m=d, lower=low, upper=high, max_speed=SPEED)
        for j, ((a, alpha, d), (low, high)) in enumerate(zip(ROWS, ENDS.tolist(), strict=True))
    )
    tool = RigidTransform.from_components([0.02, 0.0, tool_m], Rotation.from_euler("xyz", [0.2, 0.1, 0.0]))
    return Arm(name="puma", joints=joints, convention=Convention.CRAIG, T_flange_tool=tool)


LIMITS = Limits(joints=(JointLimit(acceleration=ACCELERATION),) * 6, speed_m_s=1.0)


def bow(
    arm: Arm, q: np.ndarray = HOME, *, radius_m: float = 0.04, turn: tuple[float, ...] = (0.0, 0.3, 0.2)
) -> TaughtPath:
    """Half a circle of the tip from joints q on, while the tool turns."""
    share = np.linspace(0.0, 1.0, 51)
    T = np.repeat(arm.fk(q)[None], 51, axis=0)
    T[:, :3, 3] += radius_m * np.stack([np.sin(np.pi * share), 1.0 - np.cos(np.pi * share), 0.0 * share], axis=1)
    T[:, :3, :3] = (Rotation.from_rotvec(np.outer(share, turn)) * Rotation.from_matrix(T[0, :3, :3])).as_matrix()
    return TaughtPath.of_poses(T)


def planned(
    arm: Arm, path: TaughtPath, speed_m_s: float, blend_m: float, q: np.ndarray = HOME, axes: Axes = AXES
) -> LinuxcncPlan:
    """What LinuxCNC will do of a path, whatever the limits say."""
    moves = program_moves(replace(path, parent="base"), speed_m_s=speed_m_s, blend_m=blend_m)
    return plan_lines(moves, arm, arm, axes, q, np.pi / 3.0)


def played(program: str, q: np.ndarray = HOME, **more: Any) -> Played:
    """What the real LinuxCNC did of a program."""
    keys = {"acceleration_m_s2": 0.5, "acceleration_rad_s2": np.pi} | more
    return play(program, ROWS, q, lower_rad=ENDS[:, 0], upper_rad=ENDS[:, 1], **keys)


@runs
@pytest.mark.parametrize(("turn", "blend_m"), [((0.0, 0.3, 0.2), 1e-3), ((0.1, 0.0, 0.2), 0.0)])
def test_linuxcnc_does_what_was_worked_out(tmp_path: Path, turn: tuple[float, ...], blend_m: float) -> None:
    """Joints, speeds, accelerations and duration of the whole program, its approach too; the path within 0.1 mm."""
    arm = puma()
    path = bow(arm, turn=turn)
    out = tmp_path / "seam.ngc"
    done = armsight.paths.export(
        path, out, arm=arm, limits=LIMITS, speed_m_s=0.03, blend_m=blend_m, start=HOME, approach_m=0.03
    )
    assert done.start_q is not None and done.duration_s is not None and done.joints is not None
    real = played(out.read_text(), np.array(done.start_q))
    assert real.done and not real.said
    assert real.t_s[-1] == pytest.approx(done.duration_s, rel=0.02, abs=0.1)
    rate = np.abs(np.gradient(real.q_rad, real.t_s, axis=0)).max(axis=0)
    change = np.abs(np.diff(real.q_rad[::4], 2, axis=0)).max(axis=0) / (4e-3) ** 2
    for j, joint in enumerate(done.joints):
        assert rate[j] <= MARGINS[0] * joint.speed and change[j] <= MARGINS[1] * joint.acceleration, joint.name
        assert rate[j] >= 0.9 * joint.speed, joint.name
    tip = arm.fk(real.q_rad)[:, :3, 3]
    seam = path.T_world_tip[:, :3, 3]
    for place in seam:
        assert np.linalg.norm(tip - place, axis=1).min() < 1e-4


@runs
@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"q": HOME + np.array([0.0, 0.01, 0.0, 0.0, 0.0, 0.0])}, "do not stand"),
        ({"acceleration_m_s2": 0.6}, "more than the planned"),
        ({"joint_speed_deg_s": 3.0}, "MAX_VELOCITY"),
    ],
)
def test_a_program_does_not_run_where_it_was_not_planned_for(
    change: dict[str, Any], said: str, seam: LinuxcncPlan
) -> None:
    arm = puma()
    text = gcode("seam", seam, arm, AXES, joint_bounds(arm, LIMITS), None)
    real = played(text, **change)
    assert len(real.t_s) == 1, "nothing moves"
    assert any(said in one for one in real.said), real.said


def export(arm: Arm | None, path: TaughtPath, out: Path, **more: Any) -> Any:
    """Export with what is usual here."""
    return armsight.paths.export(
        path,
        out / "seam.ngc",
        arm=arm,
        **({"limits": LIMITS, "speed_m_s": 0.03, "blend_m": 1e-3, "start": HOME} | more),
    )


@pytest.fixture(scope="module")
def seam() -> LinuxcncPlan:
    """What LinuxCNC will do of a bow with a turning tool."""
    return planned(puma(), bow(puma()), 0.03, 1e-3)


def test_what_would_pass_a_limit_is_not_written(tmp_path: Path, seam: LinuxcncPlan) -> None:
    arm = puma()
    bounds = joint_bounds(arm, LIMITS)
    require_kept(seam, arm, bounds, LIMITS.singularity)
    for key, most, said in (("speed", seam.speed, "run at"), ("acceleration", seam.acceleration, "accelerate at")):
        with refuses(Inconsistent, f"j5 would {said}"):
            less = np.where(np.arange(6) == 4, 0.99 * most, 2.0 * most)
            require_kept(seam, arm, replace(bounds, **{key: less}), 0.0)
    with refuses(Inconsistent, "j1 would go from"):
        require_kept(seam, arm, replace(bounds, upper=seam.q.max(axis=0) - [1e-3, 0, 0, 0, 0, 0]), 0.0)
    with refuses(Inconsistent, "from a singularity"):
        require_kept(seam, arm, bounds, 1.01 * seam.singular)
    wrist = HOME * [1.0, 1.0, 1.0, 1.0, 0.1, 1.0]
    with refuses(Inconsistent, "j4 jumps"):
        export(arm, bow(arm, wrist), tmp_path, start=wrist, speed_m_s=0.005)
    assert not list(tmp_path.iterdir())


def test_what_linuxcnc_cannot_be_told_is_not_written(tmp_path: Path) -> None:
    arm = puma()
    with refuses(UsageError, "no arm"):
        export(None, replace(bow(arm), parent="base"), tmp_path, frame="base", start=None)
    with refuses(UsageError, "genserkins"):
        export(arm, bow(arm), tmp_path, controller=armsight.presets.stanford_rrp())
    with refuses(UsageError, "digital output"):
        tagged = replace(bow(arm), tags=("weld_on", *[""] * 49, "weld_off"))
        export(arm, tagged, tmp_path, weld_output="torch")
    q = np.array([0.1, -0.4, 0.5, -0.8, 0.9, 0.4])
    upright = replace(arm, T_flange_tool=RigidTransform.identity())
    T = np.repeat(upright.fk(q)[None], 41, axis=0)
    R = Rotation.from_euler("xyz", np.stack([np.full(41, 2.6), np.linspace(1.5, 1.64, 41), np.full(41, 0.3)], axis=1))
    T[:, :3, :3] = R.as_matrix()
    with refuses(Inconsistent, "B = 90"):
        planned(upright, TaughtPath.of_poses(T), 0.03, 0.0, upright.readings(upright.ik(T[0])[0].q))
    assert not list(tmp_path.iterdir())


def test_what_is_refused_is_written_once_its_cure_is_followed(tmp_path: Path, seam: LinuxcncPlan) -> None:
    arm, bounds = puma(), joint_bounds(puma(), LIMITS)
    T = np.repeat(arm.fk(HOME)[None], 2, axis=0)
    T[1, :3, 3] += [0.0, 0.02, 0.0]
    short = TaughtPath.of_poses(T)
    with refuses(UsageError, "(arm)", "limits"):
        export(None, replace(short, parent="base"), tmp_path, frame="base", start=None)
    assert export(arm, short, tmp_path).joints
    first, second, *others = arm.joints
    leaning = replace(arm, joints=(first, replace(second, beta_rad=0.002), *others))
    with refuses(UsageError, "genserkins", "controller"):
        export(leaning, short, tmp_path)
    assert export(leaning, short, tmp_path, controller=arm).joints
    T[1, :3, 3] += [0.0, 0.0, 1.5]
    with refuses(Inconsistent, "branch", "elsewhere", "--start"):
        planned(arm, TaughtPath.of_poses(T), 0.2, 0.0)
    require_kept(seam, arm, bounds, 0.0)  # elsewhere
    tight = replace(bounds, speed=0.99 * seam.speed, acceleration=0.99 * seam.acceleration)
    with refuses(Inconsistent, "run at", "accelerate at", "--speed-m-s", "--acceleration-m-s2"):
        require_kept(seam, arm, tight, 0.0)
    slow = Axes(acceleration_m_s2=0.2 * AXES.acceleration_m_s2, acceleration_rad_s2=0.2 * AXES.acceleration_rad_s2)
    require_kept(planned(arm, bow(arm), 0.02, 1e-3, axes=slow), arm, tight, 0.0)


def test_a_calibrated_arm_is_written_in_the_controllers_own_geometry(tmp_path: Path) -> None:
    """Poses are those of genserkins' table at the joints that bring the calibrated arm's tip to the path."""
    nominal = puma()
    first, second, *others = nominal.joints
    real = replace(nominal, joints=(first, replace(second, theta_rad=0.01, a_m=0.002), *others))
    out = tmp_path / "seam.ngc"
    done = export(real, bow(real), tmp_path, controller=nominal, approach_m=0.0)
    words = re.findall(r"^G53 G1 X(\S+) Y(\S+) Z(\S+)", out.read_text(), flags=re.MULTILINE)
    flange = nominal.fk(np.array(done.start_q)) @ nominal.T_flange_tool.inv().as_matrix()
    assert np.array(words[0], dtype=float) == pytest.approx(1e3 * flange[:3, 3], abs=1e-4)
    tip = real.fk(real.values(np.array(done.start_q)))[:3, 3]
    assert tip == pytest.approx(bow(real).T_world_tip[0, :3, 3], abs=1e-9)
