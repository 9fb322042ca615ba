"""A plan tried in the simulated world: calibrations and measurements with errors of their own, beside the forecast.

The world projects corners and lights by itself (armsight_sim, reached by name); the noise that the forecast is made
from is laid on them, and armsight's own calibration and measurement see nothing else. Each run is a job of a batch.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.handeye.pairs import components
from armsight.drivers import SCENARIOS, known
from armsight.errors import DeviceNotFound, NotEnoughData, UsageError
from armsight.geometry import xyz_quat
from armsight.records import Progress
from armsight.store import board_text, rig_mapping, target_mapping
from armsight_lab.batch.cluster import Workers
from armsight_lab.batch.jobs import Job
from armsight_lab.batch.results import read_job_result
from armsight_lab.batch.run import run_batch
from armsight_lab.design.expected_poses import look
from armsight_lab.design.plan import Plan
from armsight_lab.design.records import DesignSimulation, SimulatedPlace
from armsight_lab.design.request import DesignJob
from armsight_lab.design.simulated_run import ArmSpec, Spec, simulate_run
from armsight_lab.design.volume import NOISE, Forecast, moving, rigid_part, size_of, spot_noise

PLACES = 24
"""Of the measured cells so many are measured in each run, evenly chosen."""
RUNS = "runs"
AGREES = 0.15
"""How far the simulated deviation may be from the one foretold, beside two standard deviations of its own."""
LEAST_RUNS = 5


def simulate_design(job: DesignJob, found: Forecast, progress: Progress) -> DesignSimulation:
    """Return simulated deviations beside those foretold; the runs stay in OUT/runs.

    Raises UsageError where there is nothing to simulate, NotEnoughData where nearly every run was refused.
    """
    plan = found.plan
    if found.views is None or plan.calibration is None:
        raise UsageError(
            "--simulate simulates the calibration too, and the rig's file is taken as it is",
            consequence="Nothing is simulated",
            cure="Give --board and --views",
        )
    if job.simulate < LEAST_RUNS:
        raise UsageError(f"{job.simulate} runs show no deviation", cure=f"Simulate {LEAST_RUNS} or more; 200 tell 5 %")
    if not known(SCENARIOS):
        raise DeviceNotFound("the simulation (armsight-sim) is not installed", cure="pip install 'armsight[sim]'")
    places = np.flatnonzero(found.measured)
    places = places[np.unique(np.linspace(0, len(places) - 1, min(PLACES, len(places))).round().astype(int))]
    jobs = [
        Job(name=f"run-{k:05d}", command="design", arguments={"seed": job.seed, "run": k}) for k in range(job.simulate)
    ]
    out = job.out / RUNS
    execute = partial(simulate_run, spec_of(found, places))
    run_batch(jobs, out, execute, workers=Workers(n=job.workers), overwrite=out.exists(), progress=progress)
    results = [read_job_result(out / one.name) for one in jobs]
    errors = [one.result["errors"] for one in results if one is not None and one.result is not None]
    if len(errors) < LEAST_RUNS:
        why = next(
            (one.error.cause for one in results if one is not None and one.error is not None), "they were killed"
        )
        raise NotEnoughData(
            f"{job.simulate - len(errors)} of {job.simulate} simulated runs gave nothing, the first because: {why}",
            consequence="Nothing is confirmed",
            cure="Plan more pictures of the board, or a larger one",
        )
    return _compared(found, places, errors, job.simulate)


def spec_of(found: Forecast, places: NDArray[np.intp]) -> Spec:
    """Return what a run is told: the plan, and no deviation."""
    plan, views, at = found.plan, found.views, found.expected.T_rig_target[places]
    arm = None
    if plan.arm is not None and found.handeye is not None:
        poses = found.handeye[0]
        arm = ArmSpec(
            T_base_rig=plan.arm.T_base_rig,
            T_flange_target=plan.arm.T_flange_target,
            T_flange_tool=plan.arm.arm.T_flange_tool,
            poses=_rows(poses),
            spot_px=_spot_px(plan, poses),
            noise=plan.arm.noise,
        )
    return Spec(
        rig=rig_mapping(plan.rig),
        target={key: value for key, value in target_mapping(plan.target).items() if value is not None},
        board="" if views is None else board_text(views.board),
        views=[] if views is None else _rows(views.T_rig_board),
        corner_px=0.0 if views is None else views.sigma_px,
        places=_rows(at),
        spot_px=_spot_px(plan, at),
        relative=plan.relative,
        lights_m2=plan.target.covariance,
        arm=arm,
    )


def _spot_px(plan: Plan, poses: RigidTransform) -> Array:
    """Return the noise (m, n, 2) of lights at poses, as it was foretold from."""
    size, noise = look(plan.rig, plan.target, poses, plan.least_px).size_px, spot_noise(plan)
    return np.stack([noise(size[..., side], side) for side in range(2)], axis=2)


def _rows(poses: RigidTransform) -> list[list[float]]:
    return [np.concatenate(xyz_quat(poses[i])).tolist() for i in range(len(poses))]


def foretold_at(found: Forecast, places: NDArray[np.intp]) -> Array:
    """Return the covariances (k, 6, 6) of single frames at some places, aligned to these where the plan is relative."""
    noise = found.plan.average * found.parts[NOISE][places]
    if not found.plan.relative:
        rest = [C[places] for name, C in found.parts.items() if name != NOISE]
        return np.asarray(noise + np.sum(rest, axis=0))
    expected = found.expected.take(places)
    at = components(expected.T_rig_target)[1]
    slopes = expected.slopes - moving(at) @ rigid_part(expected.slopes, at, np.ones(len(places), bool))
    shared = np.sum(list(found.shared(slopes).values()), axis=0)
    return np.asarray(aligned_noise(noise, at) + shared)


def aligned_noise(noise: Array, places: Array) -> Array:
    """Return the independent noise (k, 6, 6) of k places as it is left once they are aligned by their positions."""
    k = len(places)
    G = moving(places - places.mean(axis=0))
    P = np.linalg.pinv(G[:, :3].reshape(-1, 6))  # (6, 3 k)
    out = np.empty_like(noise)
    for i in range(k):
        blocks = [-G[i] @ P[:, 3 * j : 3 * j + 3] @ np.eye(3, 6) for j in range(k)]
        blocks[i] = blocks[i] + np.eye(6)
        out[i] = np.sum([B @ noise[j] @ B.T for j, B in enumerate(blocks)], axis=0)
    return out


def _compared(found: Forecast, places: NDArray[np.intp], errors: Sequence[Any], n_runs: int) -> DesignSimulation:
    """Return the figures; errors: rows (k, 6) of each run, m and rad, null where there was no pose."""
    C = foretold_at(found, places)
    expected = np.stack([size_of(C[:, :3, :3]), size_of(C[:, 3:, 3:])])  # (2, k)
    seen = np.array(errors, dtype=np.float64)  # (runs, k, 6), NaN where lost
    squares = np.stack([(seen[..., :3] ** 2).sum(axis=2), (seen[..., 3:] ** 2).sum(axis=2)])  # (2, runs, k)
    whole = found.whole[places]
    n = np.maximum(np.isfinite(squares).sum(axis=1), 1)
    rms = np.sqrt(np.nansum(squares, axis=1) / n)  # (2, k)
    some = np.isfinite(squares).any(axis=1)
    ratio = [
        float(np.sqrt(np.mean((rms[a] / expected[a])[some[a] & use] ** 2))) for a, use in ((0, some[0]), (1, whole))
    ]
    std = float(1.0 / np.sqrt(2.0 * len(errors)))
    near = AGREES + 2.0 * std
    ratios = ratio if whole.any() else ratio[:1]
    return DesignSimulation(
        n_runs=n_runs,
        n_failed=n_runs - len(errors),
        n_poses=int(np.isfinite(squares[0]).sum()),
        n_lost=int((~np.isfinite(squares[0])).sum()),
        ratio_position=ratio[0],
        ratio_orientation=ratio[1] if whole.any() else None,
        ratio_std=std,
        agrees=all(abs(one - 1.0) <= near for one in ratios),
        places=tuple(
            _place(found, i, rms[:, k], expected[:, k], bool(whole[k])) for k, i in enumerate(places.tolist())
        ),
    )


def _place(found: Forecast, i: int, rms: Array, expected: Array, whole: bool) -> SimulatedPlace:
    x, y, z = found.cells.xyz_m[i].tolist()
    return SimulatedPlace(
        xyz_m=(x, y, z),
        expected_m=float(expected[0]),
        position_m=float(rms[0]),
        expected_rad=float(expected[1]) if whole else None,
        orientation_rad=float(rms[1]) if whole else None,
    )
