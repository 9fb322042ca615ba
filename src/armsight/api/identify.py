"""Unknown arms, identified from a beacon's places."""

from __future__ import annotations

from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from armsight.api.results import Result, Row
from armsight.app.identify.sweep_files import identify_output, seen_in_frames
from armsight.app.requests.identify import IdentifyJob
from armsight.calibrate.identify import Identification, Sweeps, even_ones, identify
from armsight.calibrate.identify.result import placed_by
from armsight.errors import UsageError
from armsight.kinematics import Arm
from armsight.ops.arrays import Poses, as_joint_numbers, as_poses
from armsight.ops.checks import speaks_python
from armsight.ops.given import Given, PathText, RigLike, Source, TableLike, TargetLike
from armsight.optics import Rig
from armsight.records import Progress, Silent, checked_array, require_kind, require_number
from armsight.records.output import with_std
from armsight.store import read_rig

if TYPE_CHECKING:
    pass


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ArmIdentification(Result):
    """An unknown arm's geometry. arm: what was found, for kinematics and files. detail: everything else."""

    detail: Identification

    @property
    def arm(self) -> Arm:
        """The arm."""
        return self.detail.arm

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know about the result."""
        return self.detail.notes

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"Arm of {self.arm.n} joints, identified"

    def rows(self) -> list[Row]:
        """Return each joint's type and table, with standard deviations where they mean something."""
        rows = []
        for number, (joint, found) in enumerate(zip(self.arm.joints, self.detail.joints, strict=True), 1):
            std = found.std
            parts = [
                f"a {with_std(joint.a_m, std.get('a_m'), 'mm', scale=1e3)}",
                f"alpha {with_std(joint.alpha_rad, std.get('alpha_rad'), 'deg', scale=180.0 / np.pi)}",
                f"d {with_std(joint.d_m, std.get('d_m'), 'mm', scale=1e3)}",
                f"theta {with_std(joint.theta_rad, std.get('theta_rad'), 'deg', scale=180.0 / np.pi)}",
            ]
            rows.append((f"joint {number}", f"{joint.type}{'' if found.decided else '?'}: {', '.join(parts)}"))
        return rows + [("note", note) for note in self.notes]

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as `armsight identify --json` gives them."""
        return identify_output(self.detail).to_dict()

    def save(self, path: str | PathLike[str]) -> Path:
        """Write arm.yaml, or a URDF where the name ends in .urdf, and return its path."""
        return self.arm.save(path)


@speaks_python(IdentifyJob)
def identify_arm(
    joint: ArrayLike,
    q: ArrayLike,
    xyz_m: ArrayLike,
    *,
    rig: Rig | None = None,
    uv_px: ArrayLike | None = None,
    T_base_rig: Poses | None = None,
    method: Literal["ml", "paper"] = "ml",
    increments: Literal["known", "order"] = "known",
    sigma: float | None = None,
    name: str = "identified",
) -> ArmIdentification:
    """Return the arm whose beacon was seen while one joint after the other moved (Kapucu and Baysec 2005).

    Parameters
    ----------
    joint
        (m,) which joint moves in each row, counted from 1.
    q
        (m, n) joint values in rad and m.
    xyz_m
        (m, 3) where the beacon was, in m, in any fixed frame.
    rig
        The cameras; with uv_px the fit is of pixels.
    uv_px
        (m, 2, 2) the beacon's positions in both images, [row, side].
    T_base_rig
        Where xyz_m's frame is to the base; the first frame is then the base's foot on the first axis.
    method
        ml (maximum likelihood) or paper (triples, Chauvenet, means).
    increments
        known: q is exact; order: only its order.
    sigma
        Noise of a pixel in px, or of a place in m; else it is found.
    name
        Of the arm.

    Raises
    ------
    NotEnoughData
        Too few readings of a joint, or too short a sweep.
    Inconsistent
        Rows that do not belong together.

    Examples
    --------
    >>> arm = armsight.presets.puma761()
    >>> q = np.zeros((90, 6))
    >>> joint = np.repeat(np.arange(1, 7), 15)
    >>> for j in range(6):
    ...     q[joint == j + 1, j] = np.linspace(-0.7, 0.7, 15)
    >>> seen = (arm.fk(q) @ [0.05, 0.03, 0.1, 1.0])[:, :3] + np.random.default_rng(1).normal(0.0, 1e-4, (90, 3))
    >>> armsight.identify_arm(joint, q, seen).arm.n
    6
    """
    positions, readings = checked_array("xyz_m", xyz_m, (None, 3)), checked_array("q", q, (None, None))
    moving = as_joint_numbers(joint, len(positions))
    pixels = None if uv_px is None else checked_array("uv_px", uv_px, (len(positions), 2, 2))
    if rig is not None:
        require_kind("rig", rig, Rig)
    if (rig is None) != (pixels is None):
        raise UsageError(
            "of rig and uv_px only one is given",
            consequence="Pixels say nothing without their cameras",
            cure="Give both, or neither",
        )
    sweeps = Sweeps(joint=moving - 1, q=readings, xyz_m=positions, uv_px=pixels)
    return _identified(sweeps, rig, T_base_rig, method=method, increments=increments, sigma=sigma, name=name)


@speaks_python(IdentifyJob)
def identify_arm_from_frames(
    rig: RigLike,
    target: TargetLike,
    left: Source,
    right: Source,
    joints: TableLike,
    *,
    T_base_rig: Poses | None = None,
    method: Literal["ml", "paper"] = "ml",
    increments: Literal["known", "order"] = "known",
    sigma: float | None = None,
    mask: ArrayLike | PathText | None = None,
    name: str = "identified",
    progress: Progress | None = None,
) -> ArmIdentification:
    """Return the arm whose beacon two cameras saw while one joint after the other moved.

    Parameters
    ----------
    rig, target, left, right
        As `measure` takes them.
    joints
        Columns frame (from 0), joint (which moves, from 1) and q1 .. qn; or sweep_joints.csv.
    mask
        True, or white, where a light may be looked for.

    Raises
    ------
    NotEnoughData, Inconsistent
        As identify_arm; the beacon is seen in none of the frames.
    """
    with Given(name="arm.yaml") as given:
        job = given.job(IdentifyJob, locals())
        cameras = rig if isinstance(rig, Rig) else read_rig(job.rig or given.out)
        sweeps, _ = even_ones(seen_in_frames(job, cameras, progress or Silent())[0])
        return _identified(sweeps, cameras, T_base_rig, method=method, increments=increments, sigma=sigma, name=name)


def _identified(
    sweeps: Sweeps, rig: Rig | None, T_base_rig: Poses | None, *, sigma: float | None, name: str, **how: str
) -> ArmIdentification:
    require_kind("name", name, str)
    if sigma is not None:
        require_number("sigma", sigma)
    T_base = None if T_base_rig is None else as_poses(T_base_rig, "T_base_rig")[0]
    base = None if T_base is None else T_base.inv().as_matrix()
    found = identify(sweeps, rig=rig, sigma=sigma, base=base, name=name, **how)
    if T_base is not None:  # found in the rig's axes
        found = replace(found, arm=placed_by(T_base, found.arm, on_base=True))
    return ArmIdentification(detail=found)
