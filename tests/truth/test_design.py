"""Deviations foretold beside those of a simulated world: calibrations and measurements with errors of their own.

The world projects by itself (armsight_sim); what armsight calibrates and measures from it is compared with the truth.
Tolerances follow from the number of draws.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from tests.truth.camera_ring import CENTRE, FOCAL, K1, SIZE, Ring, pose, ring
from tests.truth.camera_ring import LIGHTS as RELIEF

from armsight.errors import UsageError
from armsight.measure.poses.setup import Setup
from armsight.optics import Camera, MountedCamera, Plate, Rig
from armsight.optics.mirrors import Mirrors
from armsight.records import NamedCovariance, Silent
from armsight.records.target import spot_target
from armsight.store import write_rig, write_target
from armsight.store.rigs import World, write_world
from armsight_lab.batch.jobs import Job
from armsight_lab.design.changes import where_it_helps
from armsight_lab.design.expected_poses import expected_poses, look
from armsight_lab.design.plan import plan_of
from armsight_lab.design.records import DesignSimulation
from armsight_lab.design.request import DesignJob
from armsight_lab.design.run import run_design
from armsight_lab.design.simulate import _compared, foretold_at, spec_of
from armsight_lab.design.simulated_run import simulate_run
from armsight_lab.design.volume import NOISE, Forecast, forecast, hidden_ways, size_of
from armsight_lab.links import Links
from refusals import refuses

LIGHTS = {"A": (-0.040, 0.0, 0.0), "B": (0.030, 0.032, 0.0), "C": (0.030, -0.032, 0.0)}
RUNS, PLACES = 8, 12
BEFORE_ARM = np.array([[0.0, 0.0, -1.0, 1.6], [1.0, 0.0, 0.0, -0.06], [0.0, -1.0, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0]])


@pytest.fixture
def job(tmp_path: Path) -> DesignJob:
    write_target(tmp_path / "target.yaml", spot_target(LIGHTS, diameter_m=0.006))
    return DesignJob(
        out=tmp_path / "out",
        target=tmp_path / "target.yaml",
        volume=((-0.1, 0.2), (-0.1, 0.1), (0.5, 0.8)),
        size=(1280, 720),
        focal_px=950.0,
        baseline_m=0.12,
        board="checkerboard:7x5:0.03",
        views=15,
        cells=5,
    )


def simulated(found: Forecast, folder: Path, runs: int = RUNS) -> DesignSimulation:
    measured = np.flatnonzero(found.measured)
    places = measured[np.linspace(0, len(measured) - 1, PLACES).round().astype(int)]
    spec = spec_of(found, places)
    jobs = [Job(name=f"run-{k}", command="design", arguments={"seed": 5, "run": k}) for k in range(runs)]
    errors = [simulate_run(spec, one, folder).figures["errors"] for one in jobs]
    return _compared(found, places, errors, runs)


def test_within_a_volume_measured_poses_scatter_as_foretold(job: DesignJob, tmp_path: Path) -> None:
    done = simulated(forecast(plan_of(replace(job, relative=True))), tmp_path)
    assert done.n_lost == 0
    # noise of 96 poses of one frame makes most of it: 5 % of the turns, 6 % of the positions
    assert done.ratio_position == pytest.approx(1.0, abs=0.18)
    assert done.ratio_orientation == pytest.approx(1.0, abs=0.15)


def test_claims_that_are_half_of_the_truth_are_seen(job: DesignJob, tmp_path: Path) -> None:
    """The comparison's own control: plans of half the noise that there is do not agree."""
    plan = plan_of(replace(job, relative=True))
    found, true = forecast(replace(plan, spot_px=0.05)), forecast(plan)
    measured = np.flatnonzero(found.measured)[:: len(found.measured) // PLACES]
    spec = spec_of(true, measured)
    jobs = [Job(name="x", command="design", arguments={"seed": 5, "run": k}) for k in range(5)]
    errors = [simulate_run(spec, one, tmp_path).figures["errors"] for one in jobs]
    done = _compared(found, measured, errors, 5)
    assert done.ratio_orientation > 1.6


def test_a_mirror_rig_s_poses_scatter_as_foretold(job: DesignJob, tmp_path: Path) -> None:
    camera = Camera.pinhole(768, 576, 1000.0, 1000.0, 383.5, 287.5)
    write_rig(tmp_path / "mirrors.yaml", Mirrors(baseline_m=0.12, plate=Plate(thickness_m=1e-3)).rig(camera))
    rig = replace(
        job,
        rig=tmp_path / "mirrors.yaml",
        size=None,
        focal_px=None,
        baseline_m=None,
        board="checkerboard:7x5:0.015",
        volume=((-0.05, 0.05), (-0.05, 0.05), (0.5, 0.65)),
        spot_noise_px=0.05,
        corner_noise_px=0.05,
        relative=True,
    )
    done = simulated(forecast(plan_of(rig)), tmp_path)
    assert done.ratio_position == pytest.approx(1.0, abs=0.2)
    assert done.ratio_orientation == pytest.approx(1.0, abs=0.15)


def test_a_tool_s_poses_in_the_arm_s_base_scatter_as_foretold(job: DesignJob, tmp_path: Path) -> None:
    write_world(tmp_path / "world.yaml", World(parent="base", T_parent_rig=RigidTransform.from_matrix(BEFORE_ARM)))
    arm = replace(
        job,
        arm="ur10e",
        world=tmp_path / "world.yaml",
        volume=((0.75, 1.0), (-0.15, 0.15), (0.4, 0.6)),
        cells=3,
        mount=(0.0, 0.0, -0.1),
    )
    done = simulated(forecast(plan_of(arm)), tmp_path)
    assert done.ratio_position == pytest.approx(1.0, abs=0.2)
    assert done.ratio_orientation == pytest.approx(1.0, abs=0.2)


def test_noise_that_an_alignment_takes_up_is_not_foretold_twice(job: DesignJob) -> None:
    found = forecast(plan_of(replace(job, relative=True)))
    places = np.flatnonzero(found.measured)[:4]
    aligned = foretold_at(found, places)
    plain = found.covariance[places]
    assert (np.trace(aligned[:, :3, :3], axis1=1, axis2=2) < np.trace(plain[:, :3, :3], axis1=1, axis2=2)).all()


def rig_of(world: Ring) -> Rig:
    """Return the rig of a world of cameras, with the covariance of a good calibration."""
    camera = Camera.pinhole(*SIZE, FOCAL, FOCAL, *CENTRE, distortion=(K1, 0.0, 0.0, 0.0, 0.0))
    cameras = [
        MountedCamera(
            name=f"c{s}", camera=camera, T_rig_camera=RigidTransform.from_components(t, Rotation.from_matrix(R)).inv()
        )
        for s, (R, t) in enumerate(zip(world.R, world.t, strict=True))
    ]
    names = [f"c{s}.{name}" for s in range(len(world)) for name in ("fx", "fy", "cx", "cy")]
    places = [f"c{s}.{name}" for s in range(1, len(world)) for name in ("tx", "ty", "tz", "rx", "ry", "rz")]
    std = [0.3] * len(names) + [5e-5, 5e-5, 5e-5, 1e-4, 1e-4, 1e-4] * (len(world) - 1)
    return Rig(cameras=cameras, covariance=NamedCovariance(names=(*names, *places), matrix=np.diag(np.square(std))))


def test_by_any_number_of_cameras_every_sight_counts_up_to_the_bound() -> None:
    rng, world = np.random.default_rng(4), ring(4)
    target = spot_target({name: tuple(x) for name, x in zip("ABCDEF", RELIEF.tolist(), strict=True)})
    setup = Setup(rig_of(world), target)
    poses = [pose(rng, tilt_rad=0.2) for _ in range(12)]
    for k, T in enumerate(poses[:6]):
        T[1, 3] += 0.34 + 0.04 * k  # some lights leave some of the pictures
    found = expected_poses(
        setup, RigidTransform.from_matrix(np.array(poses)), lambda size, side: np.full(size.shape, 0.1), least_px=2.0
    )
    assert found.whole.sum() > 6
    partial = checked = 0
    for i in np.flatnonzero(found.whole).tolist():
        uv = world.pixels(RELIEF @ poses[i][:3, :3].T + poses[i][:3, 3])  # (n, v, 2)
        apart = np.linalg.norm(uv[:, None] - uv, axis=3) + 99.0 * np.eye(6)[..., None]
        sights = np.isfinite(uv[..., 0]) & (
            np.nan_to_num(apart, nan=99.0).min(axis=1) >= 4.0
        )  # nearer ones run into each other
        if (found.seen[i] & ~np.isfinite(uv[..., 0])).any():
            assert (found.seen[i] & ~np.isfinite(uv[..., 0])).sum() <= 2  # between 3 px and 4 or 5 from the edge
            continue
        checked += 1
        assert (sights & ~found.seen[i]).sum() <= 1  # near one that is outside
        partial += not found.seen[i].all()
        bound = world.bound(RELIEF, poses[i], found.seen[i], 0.1)
        ratio = np.linalg.eigvals(np.linalg.solve(bound, found.random[i])).real
        assert ratio == pytest.approx(1.0, abs=0.02)
    assert partial > 0 and checked > 6


def test_the_links_of_an_arm_hide_the_ways_that_go_through_them(job: DesignJob, tmp_path: Path) -> None:
    write_world(tmp_path / "world.yaml", World(parent="base", T_parent_rig=RigidTransform.from_matrix(BEFORE_ARM)))
    planned = replace(
        job, arm="ur10e", world=tmp_path / "world.yaml", volume=((0.7, 1.0), (-0.2, 0.2), (0.35, 0.65)), cells=3
    )
    with refuses(UsageError, "--link-radius-mm", "--arm"):
        plan_of(replace(job, link_radius_m=0.06))
    plan = plan_of(replace(planned, link_radius_m=0.06))
    assert plan.arm is not None
    clear = forecast(plan_of(planned))
    poses, rig = clear.expected.T_rig_target[np.arange(0, 27, 5)], clear.rig
    points = np.einsum("mij,nj->mni", poses.rotation.as_matrix(), plan.target.xyz_m) + poses.translation[:, None]
    hidden = hidden_ways(plan.arm, 0.06, rig, poses, points)
    links, told = Links(arm=plan.arm.arm, radius_m=0.06, keep_m=0.0, walls=()), 0
    for i in range(len(poses)):
        tool = plan.arm.T_base_rig * poses[i] * plan.arm.T_flange_target.inv() * plan.arm.arm.T_flange_tool
        marched = []
        for solution in plan.arm.arm.ik(plan.arm.arm.T_world_base * tool):
            chain = links.chain(solution.q[None])[0]
            marched.append(
                [[walked(plan.arm.T_base_rig, light, eye, chain, links) for eye in eyes(rig)] for light in points[i]]
            )
        least = min((np.sum(one) for one in marched), default=0)
        assert hidden[i].sum() == least
        assert not marched or any((hidden[i] == np.array(one)).all() for one in marched)
        told += least
    assert told > 0
    before, after = (look(rig, plan.target, poses, 2.0, hides).seen for hides in (None, lambda *_: hidden))
    assert (after == before & ~hidden.any(axis=2, keepdims=True)).all()  # of a pair both must show a light


def eyes(rig: Rig) -> list[np.ndarray]:
    return [np.asarray(one.T_rig_camera.translation) for one in rig.cameras]


def walked(T_base_rig: RigidTransform, light: np.ndarray, eye: np.ndarray, chain: np.ndarray, links: Links) -> bool:
    """Whether any of 3,000 places on the way from a light to an eye is in a link, and the light itself is not."""
    way = T_base_rig.apply(light + np.linspace(0.0, 1.0, 3000)[:, None] * (eye - light))
    for first, last in links.parts.tolist():
        a, b = chain[first], chain[last]
        share = np.clip((way - a) @ (b - a) / max((b - a) @ (b - a), 1e-12), 0.0, 1.0)
        off = np.linalg.norm(way - a - share[:, None] * (b - a), axis=1)
        if off[0] > links.radius_m > off.min():
            return True
    return False


def test_one_more_camera_is_put_where_two_side_by_side_see_least(job: DesignJob) -> None:
    found = forecast(plan_of(replace(job, cells=3)))
    better = where_it_helps(found, None, Silent()).made(found.plan)
    assert better is not None
    middle = np.array(found.plan.volume).mean(axis=1)
    to_pair, to_more = (
        np.mean([np.asarray(one.T_rig_camera.translation) for one in cameras], axis=0) - middle
        for cameras in (better.rig.cameras[:2], better.rig.cameras[2:])
    )
    angle = np.arccos(to_pair @ to_more / np.linalg.norm(to_pair) / np.linalg.norm(to_more))
    assert np.deg2rad(40.0) < angle < np.deg2rad(140.0)  # depth, which the two tell worst, is across its picture
    wider = forecast(better)
    assert np.nanmedian(wider.position_m) < np.nanmedian(found.position_m)
    noise, less = (np.nanmedian(size_of(one.parts[NOISE][:, :3, :3])) for one in (found, wider))
    assert less < 0.6 * noise


def test_other_cameras_than_a_pair_are_planned_as_they_are_calibrated(job: DesignJob, tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.yaml", rig_of(ring(3)))
    planned = replace(job, rig=tmp_path / "rig.yaml", size=None, focal_px=None, baseline_m=None)
    with refuses(UsageError, "c0, c1, c2", "--board"):
        plan_of(planned)
    done = run_design(replace(planned, board=None, volume=((-0.1, 0.1), (-0.1, 0.1), (1.2, 1.4)), cells=3))
    assert done.baseline_m is None and done.seen is not None
    assert tuple(done.seen) == ("c0", "c1", "c2") and max(done.seen.values()) == 1.0
    assert any("c1" in line for line in done.advice)
    assert not any("baseline" in one.change for one in done.changes)
