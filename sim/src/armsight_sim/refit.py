"""A scenario with another arm: the cameras look at the new one's lights as they looked at the old one's."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import Inconsistent, UsageError
from armsight_sim.arms import SimArm, covering
from armsight_sim.scenario_builder import robotics
from armsight_sim.scenario_motions import RobotMotion, SwingKeys, WayKeys
from armsight_sim.scenario_schema import Scenario
from armsight_sim.twins.base import clipped, twin_arm, twin_home

RADIUS_M = 0.045
"""Of the links, where the arm's file says nothing of their shape: a slim arm's."""
SWING_RAD, SWING_M = np.deg2rad(5.0), 0.02
"""Amplitude of the scenario's own motion about the home position, which a controller's joints take the place of."""
PERIODS_S = (4.1, 3.3, 5.7, 3.7, 4.7, 6.1)
FACES_DEG = ((0, 0), (180, 0), (0, 90), (0, -90), (90, 0), (-90, 0))
"""Turns about the flange's x and y that put the lights on each side of it: on its z first, as tools point."""


def with_arm(scenario: Scenario, arm: Mapping[str, Any], home: Sequence[float] | None = None) -> dict[str, Any]:
    """Return a scenario's keys with the arm of an arm.yaml's structure, in standard convention, exactly as it is there.

    At home (n,), rad or m (where a twin of it stands first if not given), the cameras see the lights as they see those
    of the scenario's own arm at its home; the lights are on that side of the flange where the arm hides none. Raises
    UsageError for an arm that cannot be simulated, or cameras on the flange; Inconsistent where the arm is in the way.
    """
    if scenario.cameras.mount != "base" or not isinstance(scenario.motion, RobotMotion):
        raise UsageError(
            f"the cameras of {scenario.name} are on the arm",
            consequence="They cannot be placed before another one",
            cure="Take a scenario with cameras.mount base, such as webcam-cell",
        )
    new, old = twin_arm(arm), robotics(scenario, scenario.seed)
    q = twin_home(new) if home is None else _in_range(new, np.asarray(home, dtype=float))
    keys = scenario.model_dump()
    T_flange_target, T_base_rig = _placed(scenario, old.nominal.flange(old.units * _home(scenario)), new, q)
    keys["cameras"]["T_mount_rig"], keys["target"]["T_flange_target"] = map(_pose, (T_base_rig, T_flange_target))
    units = np.array([1.0 if joint.prismatic else 180.0 / np.pi for joint in new.joints])
    keys["arm"] |= {
        "joints": [_joint(joint, unit) for joint, unit in zip(new.joints, units.tolist(), strict=True)],
        "T_world_base": _pose(_given(arm.get("T_world_base"))),
        "T_base_frame0": _pose(RigidTransform.from_matrix(new.T_base_frame0)),
        "error": {"length_m": 0.0, "angle_deg": 0.0},
        "vibration": {"amplitude_m": 0.0, "hz": 10.0},
    }
    reach = np.min([q - [joint.lower for joint in new.joints], [joint.upper for joint in new.joints] - q], axis=0)
    swing = np.minimum([SWING_M if joint.prismatic else SWING_RAD for joint in new.joints], 0.9 * reach)
    periods = np.resize(PERIODS_S, new.n).tolist()
    keys["motion"] = {
        "kind": "swing",
        "home": (units * q).tolist(),
        "amplitude": (units * np.maximum(swing, 0.0)).tolist(),
        "period_s": periods,
    }
    return keys | {
        "name": f"{scenario.name} with {arm.get('name', 'another arm')}"[:100],
        "about": f"{scenario.name} before another arm, which is exactly as its file says",
        "events": [],
    }


def _home(scenario: Scenario) -> Array:
    """Return the joint values (n,) at which a scenario's arm begins, in degrees or m."""
    motion = scenario.motion
    if isinstance(motion, SwingKeys):
        return np.asarray(motion.home)
    return np.asarray(motion.q[0] if isinstance(motion, WayKeys) else motion.sweeps[0].rest)  # type: ignore[union-attr]


def _in_range(arm: SimArm, q: Array) -> Array:
    if q.shape != (arm.n,) or not np.array_equal(clipped(arm, q), q):
        raise UsageError(
            f"the home position {q.tolist()} is none of an arm of {arm.n} joints, or beyond their ranges",
            consequence="Where the cameras should look is not known",
            cure="Give a reading of each joint within its range",
        )
    return q


def _placed(
    scenario: Scenario, T_base_flange_old: RigidTransform, arm: SimArm, q: Array
) -> tuple[RigidTransform, RigidTransform]:
    """Return where the lights are on the new arm's flange, and the rig on its base."""
    given = scenario.target.T_flange_target
    T_flange_target = RigidTransform.identity() if given is None else given.pose()
    T_base_rig_old = scenario.cameras.T_mount_rig.pose()
    T_target_rig = (T_base_flange_old * T_flange_target).inv() * T_base_rig_old
    right = scenario.cameras.right
    eyes = [np.zeros(3), np.zeros(3) if right is None else np.asarray(right.T_rig_camera.xyz_m)]
    frames, radii, below = arm.frames(q), [RADIUS_M] * arm.n, None
    for turn in FACES_DEG:
        face = RigidTransform.from_rotation(Rotation.from_euler("xy", turn, degrees=True)) * T_flange_target
        T_base_target = arm.flange(q) * face
        T_base_rig = T_base_target * T_target_rig
        lights = [np.asarray(T_base_target.apply(xyz)) for xyz in scenario.target.spots_m.values()]
        stand = [np.asarray(T_base_rig.apply(eye)) for eye in eyes]
        if not any(covering(frames, radii, eye, xyz) is not None for eye in stand for xyz in lights):
            if min(eye[2] for eye in stand) >= 0.0:
                return face, T_base_rig
            below = below or (face, T_base_rig)  # an arm that hangs, or works below its base
    if below is not None:
        return below
    raise Inconsistent(
        "at its home position the arm hides its flange from the cameras on every side",
        consequence="They would never see its lights, and no scenario is made",
        cure="Give another home position, or place cameras and lights in a scenario of your own",
    )


def _joint(joint: Any, unit: float) -> dict[str, Any]:
    return {
        "name": joint.name,
        "type": "prismatic" if joint.prismatic else "revolute",
        "a_m": joint.a_m,
        "alpha_deg": float(np.rad2deg(joint.alpha_rad)),
        "d_m": joint.d_m,
        "theta_deg": float(np.rad2deg(joint.theta_rad)),
        "lower": unit * joint.lower if np.isfinite(joint.lower) else None,
        "upper": unit * joint.upper if np.isfinite(joint.upper) else None,
        "max_speed": joint.max_speed,
        "radius_m": RADIUS_M,
    }


def _given(pose: Mapping[str, Any] | None) -> RigidTransform:
    if pose is None:
        return RigidTransform.identity()
    return RigidTransform.from_components(pose["xyz_m"], Rotation.from_quat(pose["quat_xyzw"]))


def _pose(T: RigidTransform) -> dict[str, list[float]]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # where two angles turn about one axis, one of them is nothing: as good as any
        turn = T.rotation.as_euler("xyz", degrees=True)
    return {"xyz_m": np.asarray(T.translation).tolist(), "turn_deg": turn.tolist()}
