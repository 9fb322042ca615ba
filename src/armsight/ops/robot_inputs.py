"""How measurements of an arm, paths, limits and robots become what an action takes, see `armsight.ops.inputs`.

Apart from those, which most commands need: these load the calibration of arms and the drivers of robots.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from armsight.arrays import Array
from armsight.calibrate.arm import ArmPoints
from armsight.calibrate.arm.touch import Kind, KnownLength, Touches
from armsight.calibrate.identify import Sweeps
from armsight.clock import SystemClock
from armsight.control.guard import Limits
from armsight.defaults import TOUCH_LENGTH_STD_M
from armsight.drivers import Robot, RobotState
from armsight.errors import UsageError
from armsight.kinematics import Arm
from armsight.ops.action import Given
from armsight.ops.arrays import as_joint_numbers, as_rotations
from armsight.ops.given import Given as Folder
from armsight.ops.given import as_text, path_of, record_of
from armsight.ops.inputs import any_rig
from armsight.ops.requests.motion import RobotJob
from armsight.ops.robot.opening import ClockedRobot
from armsight.records import TaughtPath, checked_array, one_of, require_kind, require_texts
from armsight.store.arm_points import read_arm_points, read_sweeps
from armsight.store.handeye_file import read_tip
from armsight.store.interpret import OURS
from armsight.store.limits_file import read_limits
from armsight.store.path_file import read_path
from armsight.store.touch_table import read_touches


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GivenPath:
    """A path, and what errors call it: its file, or "the path"."""

    taught: TaughtPath
    where: str


def points(name: str, value: Any, given: Given, undo: ExitStack) -> ArmPoints:
    """Return the measurements of a table of points, or of joint readings (m, n) with `xyz_m` and more beside them."""
    model = _arm_of(given)
    path = path_of(value)
    if path is None:
        return _points(model, value, given.get("xyz_m"), given.get("rotation"), given.get("point", ()))
    if given.get("xyz_m") is not None:
        raise UsageError(f"xyz_m is given beside the table {path}, which has positions", cure="Give one of them")
    found = read_arm_points(path, (given.get("table") or OURS).of_arm(model))
    coupled = model.couplings and found.q.shape[1] == model.n
    return replace(found, q=found.q @ model.gearing.T) if coupled else found


def touches(name: str, value: Any, given: Given, undo: ExitStack) -> Touches:
    """Return the touches of a table, or of (q, feature[, kind[, tip]]), with the lengths said beside them."""
    model, path = _arm_of(given), path_of(value)
    if path is not None:
        found = read_touches(path, given.get("table") or OURS)
    elif isinstance(value, Touches):
        found = value
    else:
        require_kind(name, value, tuple, cure="Give (q, feature), (q, feature, kind), or a table's path")
        if not 2 <= len(value) <= 4:
            raise UsageError(f"{name} has {len(value)} entries", cure="Give (q, feature[, kind[, tip]])")
        q, feature, *more = value
        names = require_texts(f"{name} feature", feature)
        readings = checked_array(f"{name} q", q, (len(names), model.n))
        kinds = [one_of(Kind, f"{name} kind", one) for one in (more[0] if more else ["point"] * len(names))]
        tips = require_texts(f"{name} tip", more[1]) if len(more) == 2 else ("",) * len(names)
        if not len(kinds) == len(tips) == len(names):
            raise UsageError(
                f"{name} has {len(names)} features and not as many kinds or tips", cure="Give one each a row"
            )
        if Kind.GAUGE in kinds:
            raise UsageError(f"{name} has gauges without readings", cure="Give a table's path, with reading_m")
        nothing = np.zeros(len(names))
        found = Touches(
            q=readings,
            feature=tuple(names),
            kind=tuple(kinds),
            reading_m=nothing,
            sigma_m=nothing,
            row=np.arange(len(names)),
            tip=tips,
        )
    told = tuple(_known_length(one) for one in given.get("length") or ())
    coupled = bool(model.couplings) and found.q.shape[1] == model.n
    q = found.q @ model.gearing.T if coupled else found.q
    return replace(found, q=q, lengths=(*found.lengths, *told))


def _known_length(one: Sequence[Any]) -> KnownLength:
    """Return a length of (a, b, m) or (a, b, m, standard deviation). Raises UsageError."""
    if len(one) not in (3, 4) or not all(isinstance(name, str) for name in one[:2]):
        raise UsageError(f"the length {one!r} is not (a, b, m)", cure="Give ('left', 'right', 0.27), b '' for a radius")
    sigma = one[3] if len(one) == 4 and one[3] is not None else TOUCH_LENGTH_STD_M
    return KnownLength(a=one[0], b=one[1], length_m=float(one[2]), sigma_m=float(sigma))


def held_points(name: str, value: Any, given: Given, undo: ExitStack) -> ArmPoints:
    """Return further measurements: of a table of points, or of (q, xyz_m)."""
    if path_of(value) is not None:
        return points(name, value, {**given, "xyz_m": None}, undo)
    require_kind(name, value, tuple, cure="Give (q, xyz_m)")
    if len(value) != 2:
        raise UsageError(f"{name} has {len(value)} entries", cure="Give (q, xyz_m)")
    return _points(_arm_of(given), *value)


def _points(
    model: Arm, q: ArrayLike, xyz_m: Any, rotation: ArrayLike | None = None, point: Sequence[str] = ()
) -> ArmPoints:
    positions, readings = checked_array("xyz_m", xyz_m, (None, 3)), checked_array("q", q, (None, model.n))
    names = require_texts("point", point)
    turned = None if rotation is None else as_rotations(rotation, "rotation", len(positions))
    return ArmPoints(q=readings @ model.gearing.T, xyz_m=positions, rotation=turned, point=tuple(names))


def _arm_of(given: Given) -> Arm:
    """Return the arm that an action was given, which stands before what is measured of it."""
    return next(one for one in given.values() if isinstance(one, Arm))


def sweeps(name: str, value: Any, given: Given, undo: ExitStack) -> Sweeps:
    """Return the sweeps of a table, or of which joint moves in each row, with `q`, `xyz_m` and more beside it."""
    path, rig = path_of(value), given.get("rig")
    if path is not None:
        found = read_sweeps(path, given.get("table") or OURS)
        if rig is None and found.uv_px is not None and not found.xyz_m.any():
            raise UsageError(f"{path} has pixels only", cure="Give the rig that saw them (--rig)")
        return found
    rows: tuple[Any, ...] = tuple(given.get(one) for one in ("q", "xyz_m", "uv_px"))
    q, positions, uv_px = checked_array("q", rows[0], (None, None)), checked_array("xyz_m", rows[1], (None, 3)), rows[2]
    moving = as_joint_numbers(value, len(positions))
    if (rig is None) != (uv_px is None):
        raise UsageError(
            "of rig and uv_px only one is given",
            consequence="Pixels say nothing without their cameras",
            cure="Give both, or neither",
        )
    if rig is None:
        return Sweeps(joint=moving - 1, q=q, xyz_m=positions)
    seen_by = any_rig("rig", rig, given, undo)
    pixels = checked_array("uv_px", uv_px, (len(positions), len(seen_by.cameras), 2), nan=not seen_by.is_pair)
    return Sweeps(joint=moving - 1, q=q, xyz_m=positions, uv_px=pixels, cameras=seen_by.names)


def taught(name: str, value: Any, given: Given, undo: ExitStack) -> GivenPath:
    """Return a path, or that of a path.csv, in the frame that is said beside it. Raises UsageError, BadFile."""
    path = path_of(value)
    if path is None:
        require_kind(name, value, TaughtPath, cure="Give a TaughtPath: read_path(file), or teach(...).taught")
        return GivenPath(taught=value, where="the path")
    return GivenPath(taught=read_path(path, parent=given.get("frame") or "world"), where=str(path))


def taught_paths(name: str, value: Any, given: Given, undo: ExitStack) -> list[GivenPath]:
    """Return one path or several, see taught."""
    return [taught(name, one, given, undo) for one in (value if isinstance(value, list | tuple) else [value])]


def tip(name: str, value: Any, given: Given, undo: ExitStack) -> Array:
    """Return a tool's tip (3,) in flange axes, m, of a result or a tip.yaml. Raises UsageError, BadFile."""
    path = path_of(value)
    if path is None and not hasattr(value, "tip_m"):
        raise UsageError(
            f"{name} is of type {type(value).__name__}",
            consequence="It cannot be used",
            cure="Give a record or a file",
        )
    return np.asarray((value if path is None else read_tip(path)).tip_m)


def limits(name: str, value: Any, given: Given, undo: ExitStack) -> Limits:
    """Return limits, or those of a limits.yaml. Raises UsageError, BadFile."""
    return record_of(name, value, Limits, read_limits)


ROBOT_MEMBERS = ("__enter__", "__exit__", *(name for name in vars(Robot) if not name.startswith("_")))
"""What a driver of one's own has to have."""


def robot(name: str, value: Any, given: Given, undo: ExitStack) -> RobotJob:
    """Return a robot that is named DRIVER:DEVICE, or a driver of one's own, with what its driver is told beside it."""
    settings, config, follow = given.get("robot_settings"), given.get("rsi_config"), given.get("follow")
    config = None if config is None else undo.enter_context(Folder()).file("rsi_config", config)
    if isinstance(value, RobotJob):
        return value
    if isinstance(value, str):
        return RobotJob(robot=value, robot_settings=settings, rsi_config=config, follow=follow)
    device = value if isinstance(value, ClockedRobot) else ClockedRobot(robot=value, clock=SystemClock())
    return RobotJob(robot=device.called or _name_of(device.robot, settings, config), device=device, follow=follow)


def _name_of(robot: Any, *told: object) -> str:
    """Return DRIVER:DEVICE, or the name of a driver of one's own.

    told: settings for the driver, None where there are none. Raises UsageError where a driver of one's own is not
    complete, or told something: it was made with its settings.
    """
    if not hasattr(robot, "step_joints"):
        return as_text("robot", robot)
    lacking = [name for name in ROBOT_MEMBERS if not hasattr(robot, name)]
    if isinstance(robot, type):
        what = "is a class: it has to be called first"
    elif lacking:
        what = f"has no {', '.join(lacking)}"
    elif not isinstance(robot.state, RobotState):
        what = f"has the state {robot.state!r}, which is no RobotState"
    elif any(one is not None for one in told):
        raise UsageError(
            f"robot_settings and rsi_config are for robots that are named DRIVER:DEVICE, and {robot.name} is an object",
            consequence="They would not be used, and nothing is opened",
            cure="Make the object with its settings",
        )
    else:
        return str(robot.name)
    raise UsageError(
        f"the robot {getattr(robot, 'name', type(robot).__name__)!r} {what}",
        consequence="It cannot be driven",
        cure="Give an object with all that help(armsight.Robot) lists; its state is such as RobotState.READY",
    )
