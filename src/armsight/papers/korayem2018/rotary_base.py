"""A rig on a base that turns about one axis (Korayem 2018)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import Inconsistent
from armsight.optics.rig import Rig
from armsight.records import frozen_array

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RotaryBase:
    """The axis in the rig's own axes at angle 0, which are the frame `home`.

    direction: (3,), made a unit vector; positive angles turn the rig about it by the right hand.
    point_m: (3,), made the point of the axis nearest to the rig's origin.
    T_world_home: where the rig stands at angle 0.
    """

    direction: Array
    point_m: Array
    T_world_home: RigidTransform

    def __post_init__(self) -> None:
        direction = frozen_array("direction", self.direction, (3,))
        point = frozen_array("point_m", self.point_m, (3,))
        length = float(np.linalg.norm(direction))
        if not length > 0.0:
            raise Inconsistent("an axis needs a direction that is not zero")
        n = direction / length
        object.__setattr__(self, "direction", frozen_array("direction", n, (3,)))
        object.__setattr__(self, "point_m", frozen_array("point_m", point - (n @ point) * n, (3,)))

    def T_home_rig(self, angle_rad: float) -> RigidTransform:
        """Return the rig's pose, in its own axes of angle 0, with the base turned by angle_rad."""
        Q = Rotation.from_rotvec(angle_rad * self.direction)
        return RigidTransform.from_components(self.point_m - Q.as_matrix() @ self.point_m, Q)

    def T_world_rig(self, angle_rad: float) -> RigidTransform:
        """Return the rig's pose in world with the base turned by angle_rad."""
        return self.T_world_home * self.T_home_rig(angle_rad)


def rotary_from_mount(T_world_axis: RigidTransform, T_axis_rig: RigidTransform) -> RotaryBase:
    """Return the base whose axis is z of the frame `axis`, with the rig mounted at T_axis_rig at angle 0."""
    T_rig_axis = T_axis_rig.inv()
    return RotaryBase(
        direction=T_rig_axis.rotation.as_matrix()[:, 2],
        point_m=np.asarray(T_rig_axis.translation),
        T_world_home=T_world_axis * T_axis_rig,
    )


def rig_on_base(rig: Rig, base: RotaryBase, angle_rad: float) -> Rig:
    """Return the rig with its cameras' poses in world instead of rig axes, the base turned by angle_rad.

    The calibration's covariance is not carried over: its rows belong to the rig's own axes.
    """
    T_world_rig = base.T_world_rig(angle_rad)
    return Rig(
        kind=rig.kind,
        left=rig.left,
        right=rig.right,
        T_rig_left=T_world_rig * rig.T_rig_left,
        T_rig_right=T_world_rig * rig.T_rig_right,
        rms_px=rig.rms_px,
        noise=rig.noise,
    )
