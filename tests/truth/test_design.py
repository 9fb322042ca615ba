"""Deviations foretold beside those of a simulated world: calibrations and measurements with errors of their own.

The world projects by itself (armsight_sim); what armsight calibrates and measures from it is compared with the truth.
Tolerances follow from the number of draws.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight.optics import Camera, Plate
from armsight.optics.mirrors import Mirrors
from armsight.records.target import spot_target
from armsight.store import write_rig, write_target
from armsight.store.rigs import World, write_world
from armsight_lab.batch.jobs import Job
from armsight_lab.design.plan import plan_of
from armsight_lab.design.records import DesignSimulation
from armsight_lab.design.request import DesignJob
from armsight_lab.design.simulate import _compared, foretold_at, spec_of
from armsight_lab.design.simulated_run import simulate_run
from armsight_lab.design.volume import Forecast, forecast

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
