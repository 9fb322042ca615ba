"""Wrong premises of a servo whose cameras are on the flange: the cell of servo_lies, its truth other than believed.

The product believes its settings; cameras, pictures, readings are what each premise makes of the true arm and target.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.control.servo import Mount
from armsight.records import PoseStatus
from armsight.units import DEG, MM

sys.path.insert(0, str(Path(__file__).parent))
import servo_lies as scene

Array = Any
OFF_M, OFF_RAD = (0.02, 0.08), (3.0 * DEG, 12.0 * DEG)
"""How far the target stands from where it is wanted as the servo begins."""
HONEST_M, HONEST_RAD = 1.0 * MM, 0.3 * DEG
"""What every hand-eye calibration here is off, also a right one."""
SECONDS = 4.0


@dataclass(frozen=True, kw_only=True)
class Wrong:
    """A premise that does not hold. cause: whose. mount: true cameras from believed ones. show: pose as measured of the
    true one, unshow: the other way round; status: of every pose. late_s: how old pictures are. played: pictures are the
    first ones again: frozen, or to and fro. joint: which one, from 0, goes the other way."""

    cause: str
    mount: Array = None
    show: Callable[[Array], Array] = lambda T: T
    unshow: Callable[[Array], Array] = lambda T: T
    status: PoseStatus = PoseStatus.OK
    late_s: float = 0.0
    played: str = ""
    joint: int | None = None


def placed(xyz_m: Array = (0.0, 0.0, 0.0), rotation: Rotation | None = None) -> Array:
    return RigidTransform.from_components(xyz_m, rotation or Rotation.identity()).as_matrix()


def turned(axis: str, deg: float) -> Wrong:
    return Wrong(cause="hand-eye", mount=placed(rotation=Rotation.from_euler(axis, deg, degrees=True)))


def stretched(*factors: float) -> Wrong:
    """A rig that measures all places by these factors along its axes."""

    def times(T: Array, by: Array) -> Array:
        out = np.array(T)
        out[:3, 3] *= by
        return out

    by = np.array(factors)
    return Wrong(cause="rig", show=lambda T: times(T, by), unshow=lambda T: times(T, 1.0 / by))


def mirrored(axis: int) -> Wrong:
    """Mirrored pictures of a flat target: its lights, mirrored, are those of one whose normal is turned round."""
    M, N = np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0])
    M[axis, axis] = -1.0
    return Wrong(cause="rig", show=lambda T: M @ T @ N, unshow=lambda T: M @ T @ N)


def exchanged(T: Array) -> Array:
    """Left and right exchanged: the disparity's sign is, and the point is mirrored at the middle of the cameras."""
    out = np.array(T)
    out[:3, 3] = [scene.BASELINE_M - T[0, 3], -T[1, 3], -T[2, 3]]
    return out


WRONG: dict[str, Wrong] = {
    **{f"turned {deg} deg about {axis}": turned(axis, deg) for deg in (5, 10, 20, 45, 90, 135, 180) for axis in "xyz"},
    "50 mm aside": Wrong(cause="hand-eye", mount=placed((0.03, -0.04, 0.0))),
    "100 mm aside": Wrong(cause="hand-eye", mount=placed((0.06, 0.08, 0.0))),
    "lever of the hand-eye in mm": Wrong(cause="hand-eye", mount=placed((0.05, 0.0, 0.06))),
    "mirrored in x": mirrored(0),
    "mirrored in y": mirrored(1),
    "left and right exchanged": Wrong(cause="rig", show=exchanged),
    "rig in mm": Wrong(cause="rig", show=stretched(1000.0, 1000.0, 1000.0).show),
    "rig 5 % too long": stretched(1.05, 1.05, 1.05),
    "rig 10 % too short": stretched(0.9, 0.9, 0.9),
    "rig 25 % too long": stretched(1.25, 1.25, 1.25),
    "another rig, depth 1.25": stretched(1.0, 1.0, 1.25),
    "another rig, depth 0.7": stretched(1.0, 1.0, 0.7),
    "another target": Wrong(cause="target", status=PoseStatus.DOUBTFUL),
    "target in mm": Wrong(cause="target", status=PoseStatus.DOUBTFUL),
    "pictures 0.3 s old": Wrong(cause="pictures", late_s=0.3),
    "pictures 1 s old": Wrong(cause="pictures", late_s=1.0),
    "pictures that stand": Wrong(cause="pictures", played="frozen"),
    "joint 2 the other way": Wrong(cause="robot", joint=1),
    "joint 4 the other way": Wrong(cause="robot", joint=3),
}


class PremiseCell(scene.Cell):
    """A run under a premise that does not hold; wrong None: an honest one. hand_m_s zero: the target is held still."""

    def __init__(self, seed: int, wrong: Wrong | None = None, hand_m_s: float = 0.0, **more: Any) -> None:
        super().__init__(seed, Mount.EYE_IN_HAND, hand_m_s, **more)
        rng = np.random.default_rng([seed, 11])
        self.wrong = wrong = wrong or Wrong(cause="")
        believed = self.source.settings.T_parent_camera.as_matrix()
        honest = placed(HONEST_M * scene._unit(rng), Rotation.from_rotvec(HONEST_RAD * scene._unit(rng)))
        self.T_parent_camera = believed @ (np.eye(4) if wrong.mount is None else wrong.mount) @ honest
        seen = np.linalg.inv(believed) @ self.T_flange_desired
        seen[:3, 3] += rng.uniform(*OFF_M) * scene._unit(rng)
        seen[:3, :3] = Rotation.from_rotvec(rng.uniform(*OFF_RAD) * scene._unit(rng)).as_matrix() @ seen[:3, :3]
        start = self.flange_at(0.0) @ self.T_parent_camera @ wrong.unshow(seen)
        self.hand = scene.Reaches(rng, start, hand_m_s, reach_m=more.get("reach_m", 0.12))
        self.lie = self  # type: ignore[assignment]  # which shows what the pictures are under the premise

    def flange_at(self, t_s: float) -> Array:
        """Return the true pose (4, 4) of the flange: a joint may go the other way than its readings."""
        joint = self.wrong.joint if hasattr(self, "wrong") else None
        if joint is None:
            return super().flange_at(t_s)
        told = self.q
        self.q = [(t, np.where(np.arange(6) == joint, 2.0 * scene.Q - q, q)) for t, q in told]
        try:
            return super().flange_at(t_s)
        finally:
            self.q = told

    def shown(self, cell: scene.Cell, k: int, t_s: float) -> tuple[Array, float]:
        """Return the pose as it is measured, and its stamp."""
        back = max(k - round(self.wrong.late_s / self.frame_s), 1)
        if self.wrong.played:
            back = min(back, round(0.3 / self.frame_s))
        return self.noisy(self.wrong.show(self.clean[back]), k), t_s

    @property
    def status(self) -> PoseStatus:
        return self.wrong.status

    @property
    def way_m(self) -> float:
        """How far the tool was from its start at most."""
        at = np.array(self.log.tool)[:, :3, 3]
        return float(np.linalg.norm(at - at[0], axis=1).max())

    def stopped(self) -> bool:
        """Whether what is contradicted was named, and the arm stands."""
        at = np.array(self.log.tool[-20:])
        return bool(self.source.contradiction) and float(np.ptp(at[:, :3, 3], axis=0).max()) < 1e-4


def run(name: str, seed: int, hand_m_s: float = 0.0) -> PremiseCell:
    """Return a run under a wrong premise until it is stopped, or for SECONDS."""
    return PremiseCell(seed, WRONG[name], hand_m_s).go(
        SECONDS, lambda cell: cell.n % 8 == 0 < cell.n and cell.stopped()
    )


def honest_run(seed: int, seconds: float = 6.0) -> PremiseCell:
    """Return an honest run with a hand of up to 0.5 m/s and a target that is hidden now and then."""
    rng = np.random.default_rng([seed, 5])
    cell = PremiseCell(
        seed,
        hand_m_s=rng.choice([0.0, 0.05, 0.1, 0.2, 0.35, 0.5]),
        limit_m_s=rng.choice([0.1, 0.25, 0.6]),
        reach_m=0.15,
        frame_s=rng.choice([scene.FRAME_S, scene.FRAME_S, 0.07]),
    )
    t_s = 1.0
    while t_s < seconds and rng.random() < 0.8:
        t_s += rng.uniform(0.3, 3.0)
        cell.hidden.append((t_s, t_s + rng.uniform(0.1, 1.0)))
        t_s = cell.hidden[-1][1]
    return cell.go(seconds, lambda cell: cell.n % 40 == 0 < cell.n and cell.stopped())
