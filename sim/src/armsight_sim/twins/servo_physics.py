"""Servos under an arm's weight: MuJoCo moves the motors of `armsight twin feetech` and `dynamixel`, if installed.

A motor is what was identified of an STS3215 at 7.4 V (Open_Duck_Playground, open_duck_mini_v2/xmls/
joints_properties.xml). Play is left out: the encoder sits behind the gears.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight_sim.arms import Drive, Servo, SimArm

GAIN_NM, STALL_NM = 17.8, 3.35
"""Torque per rad from the goal, and the largest."""
VISCOUS_NM_S, DRY_NM, ARMATURE_KG_M2 = 0.60, 0.052, 0.028
"""Friction of a joint, and the rotor's inertia behind its gears."""
LINK_KG, LINK_RADIUS_M = 0.12, 0.02
"""A link whose mass is not known: a servo (0.055 kg) and the printed part that holds it."""
STEP_S = 0.001
SETTLES_S = 2.0
"""The arm sinks into its servos before anybody looks."""


def mjcf(arm: SimArm) -> str:
    """Return an arm as MuJoCo's XML: body i turns about the z axis of frame i - 1 and carries link i, weight along -z
    of the base."""
    opened, closed, motors = [], "", []
    placed = arm.T_base_frame0
    for i, joint in enumerate(arm.joints):
        own, quat = joint.matrix(0.0), Rotation.from_matrix(placed[:3, :3]).as_quat()[[3, 0, 1, 2]]
        kind, mass = "slide" if joint.prismatic else "hinge", joint.mass_kg or LINK_KG
        com = (own @ [*joint.com_m, 1.0])[:3] if joint.mass_kg else 0.5 * own[:3, 3]
        limits = np.isfinite([joint.lower, joint.upper]).all()
        within = f'limited="true" range="{joint.lower:.9f} {joint.upper:.9f}"' if limits else 'limited="false"'
        opened.append(
            f'<body pos="{_row(placed[:3, 3])}" quat="{_row(quat)}">'
            f'<joint name="q{i}" type="{kind}" axis="0 0 1" {within} damping="{VISCOUS_NM_S}" frictionloss="{DRY_NM}" '
            f'armature="{ARMATURE_KG_M2}"/>'
            f'<geom type="sphere" size="{LINK_RADIUS_M}" pos="{_row(com)}" mass="{mass}" contype="0" conaffinity="0"/>'
        )
        closed += "</body>"
        motors.append(f'<position joint="q{i}" kp="{GAIN_NM}" forcerange="{-STALL_NM} {STALL_NM}"/>')
        placed = own
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="{STEP_S}" integrator="implicitfast"/>'
        f"<worldbody>{''.join(opened)}{closed}</worldbody><actuator>{''.join(motors)}</actuator></mujoco>"
    )


class WeighedServo(Servo):
    """Joints under way as a `Servo` has them, with weight, inertia, friction and motors of limited torque; joints that
    are not held fall."""

    def __init__(self, arm: SimArm, drive: Drive, q: ArrayLike, t_s: float, *, keep: int) -> None:
        super().__init__(drive, q, t_s, keep=keep)
        import mujoco

        self._mujoco: Any = mujoco
        self._model = mujoco.MjModel.from_xml_string(mjcf(arm))
        self._data = mujoco.MjData(self._model)
        self._longest = drive.max_speed * self._dt_s
        self._gains = self._model.actuator_gainprm.copy(), self._model.actuator_biasprm.copy()
        self._steps = max(1, round(self._dt_s / STEP_S))
        self._model.opt.timestep = self._dt_s / self._steps
        self._data.qpos[:] = self._data.ctrl[:] = self._goal
        mujoco.mj_step(self._model, self._data, round(SETTLES_S / self._model.opt.timestep))
        self._q = [self._data.qpos.copy()]

    def hold(self, held: ArrayLike) -> None:
        """Take the torque of joints away, or give it back where they are by then: held (n,)."""
        limp = self._model.actuator_gainprm[:, 0] == 0.0
        self._data.ctrl[limp] = self._data.qpos[limp]
        for own, gains in zip((self._model.actuator_gainprm, self._model.actuator_biasprm), self._gains, strict=True):
            own[:] = gains * np.asarray(held, dtype=float)[:, None]

    def _moved(self) -> Array:
        self._data.ctrl[:] += np.clip(self._goal - self._data.ctrl, -self._longest, self._longest)
        self._mujoco.mj_step(self._model, self._data, self._steps)
        return np.array(self._data.qpos)


def _row(values: Array) -> str:
    return " ".join(f"{value:.12g}" for value in values)
