"""A sweep in, the arm that made it out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from armsight.app.calibrate import report_path
from armsight.calibrate.identify import Identification, identify
from armsight.errors import UsageError
from armsight.report.identify_report import identify_report
from armsight.store import read_rig, read_world, write_text
from armsight.store.arm_file import write_arm
from armsight.store.sweeps import read_sweeps


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifyJob:
    """sigma: noise of a pixel coordinate in px with a rig, else of a place in m, where known.

    world: where the rig stands to the base; the first frame is then the base's foot on the first axis.
    """

    sweep: Path
    out: Path
    rig: Path | None = None
    world: Path | None = None
    method: str = "ml"
    increments: str = "known"
    sigma: float | None = None


def run_identify(job: IdentifyJob) -> dict[str, Any]:
    """Identify the arm, write arm.yaml and its report; return the figures as --json gives them. Raises DataRefused."""
    sweeps = read_sweeps(job.sweep)
    if job.rig is None and sweeps.uv_px is not None and not sweeps.xyz_m.any():
        raise UsageError(f"{job.sweep} has pixels only", cure="Give the rig that saw them (--rig)")
    rig = None if job.rig is None else read_rig(job.rig)
    base = None if job.world is None else read_world(job.world).T_parent_rig.inv().as_matrix()
    result = identify(
        sweeps, rig=rig if sweeps.uv_px is not None else None, sigma=job.sigma, method=job.method,
        increments=job.increments, base=base, name=job.sweep.stem,
    )  # fmt: skip
    inputs = [path for path in (job.sweep, job.rig, job.world) if path is not None]
    write_arm(job.out, result.arm, inputs=inputs)
    content = identified_content(result)
    files = [("file", path.name) for path in inputs]
    write_text(report_path(job.out), identify_report(result, sweeps, rig, inputs=files))
    return content


def identified_content(result: Identification) -> dict[str, Any]:
    """Return an identification as --json gives it; a deviation that means nothing is null."""
    joints = []
    for number, (joint, found) in enumerate(zip(result.arm.joints, result.joints, strict=True), 1):
        joints.append(
            {
                "index": number,
                "type": str(joint.type),
                "a_m": joint.a_m,
                "alpha_rad": joint.alpha_rad,
                "d_m": joint.d_m,
                "theta_rad": joint.theta_rad,
                "beta_rad": joint.beta_rad,
                "lower": found.travel[0],
                "upper": found.travel[1],
                "sign": joint.sign,
                "std": {key: value if math.isfinite(value) else None for key, value in found.std.items()},
                "n": len(found.rows) + len(found.discarded),
                "discarded": [{"row": row + 1, "why": why} for row, why in found.discarded],
                "residual_rms_m": found.residual_rms_m,
                "residual_rms_px": found.residual_rms_px,
                "p_line": found.p_line,
                "decided": found.decided,
                "radius_m": found.radius_m,
                "axis": {"point_m": found.axis.point_m.tolist(), "direction": found.axis.direction.tolist()},
            }
        )
    return {"joints": joints, "method": result.method, "notes": list(result.notes), "noise": result.sigma}
