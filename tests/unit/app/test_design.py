"""A plan from its request to its map: figures and parts, changes worked out, the frame asked for, and bad requests."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import dask
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.optics import Camera, parallel_rig
from armsight.records.target import spot_target
from armsight.store import write_rig, write_target
from armsight.store.rigs import World, write_world
from armsight.units import DEG
from armsight_lab.design.changes import reaches
from armsight_lab.design.plan import plan_of
from armsight_lab.design.request import DesignJob, mount_of, volume_of
from armsight_lab.design.run import run_design
from armsight_lab.design.volume import OUT_OF_REACH, forecast
from refusals import refuses

LIGHTS = {"A": (-0.040, 0.0, 0.0), "B": (0.030, 0.032, 0.0), "C": (0.030, -0.032, 0.0)}
NEAR = ((-0.1, 0.2), (-0.1, 0.1), (0.5, 0.8))
BEFORE_ARM = np.array([[0.0, 0.0, -1.0, 1.6], [1.0, 0.0, 0.0, -0.06], [0.0, -1.0, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0]])


@pytest.fixture
def job(tmp_path: Path) -> DesignJob:
    write_target(tmp_path / "target.yaml", spot_target(LIGHTS, diameter_m=0.006))
    return DesignJob(
        out=tmp_path / "out",
        target=tmp_path / "target.yaml",
        volume=NEAR,
        size=(1280, 720),
        focal_px=950.0,
        baseline_m=0.12,
        board="checkerboard:9x6:0.025",
        cells=5,
    )


def with_arm(job: DesignJob) -> DesignJob:
    world = job.target.parent / "world.yaml"
    write_world(world, World(parent="base", T_parent_rig=RigidTransform.from_matrix(BEFORE_ARM)))
    return replace(job, arm="ur10e", world=world, volume=((0.7, 1.0), (-0.2, 0.2), (0.35, 0.65)), cells=3)


def test_what_is_written_says_what_is_returned(job: DesignJob) -> None:
    done = run_design(replace(job, wanted_m=5e-4))
    told = json.loads((job.out / "design.json").read_text())
    assert told == json.loads(json.dumps(done.to_dict()))
    rows = list(csv.DictReader((job.out / "map.csv").read_text().splitlines()))
    assert len(rows) == done.n_cells
    values = [float(row["position_m"]) for row in rows if row["status"] == "ok"]
    assert done.position.worst == pytest.approx(max(values))
    assert done.position.median == pytest.approx(np.median(values))
    assert sum(part.share for part in done.parts) == pytest.approx(1.0)
    assert [one.name for one in done.points] == ["A", "B", "C"]
    assert done.points[0].median_m > done.position.median  # the mean of three is surer than one
    page = (job.out / "report.html").read_text()
    assert "z = 0.575 m" in page
    assert done.reached is False and done.changes[0].sufficient
    assert done.changes[0].change in done.verdict


def test_cells_out_of_view_are_never_good(job: DesignJob) -> None:
    done = run_design(replace(job, volume=((-0.1, 1.5), (-0.1, 0.1), (0.5, 0.8)), cells=8))
    found = forecast(plan_of(replace(job, volume=((-0.1, 1.5), (-0.1, 0.1), (0.5, 0.8)))))
    assert 0.0 < done.measured < 0.6
    assert done.position.worst < 0.01 and not reaches(found, 0.01)  # all that is measured is fine: not enough of it is
    assert {one.why for one in done.not_measured} >= {"outside the left image"}
    rows = list(csv.DictReader((job.out / "map.csv").read_text().splitlines()))
    lost = [row for row in rows if row["status"] == "not_measured"]
    assert lost and all(row["why"] and not row["position_m"] for row in lost)


@pytest.mark.parametrize(
    ("change", "kind", "named"),
    [
        ({"volume": ((0.2, -0.1), *NEAR[1:])}, UsageError, ("reversed", "x")),
        ({"volume": ((-0.1, float("nan")), *NEAR[1:])}, UsageError, ("nan", "x")),
        ({"volume": ((-100.0, 200.0), (-100.0, 100.0), (500.0, 800.0))}, Inconsistent, "millimetres"),
        ({"volume": (*NEAR[:2], (-0.8, -0.5))}, Inconsistent, ("behind", "left")),
        ({"volume": ((3.0, 4.0), *NEAR[1:])}, Inconsistent, "outside"),
        ({"views": 0}, NotEnoughData, "0 views"),
        ({"board": None}, UsageError, "board"),
        ({"baseline_m": None}, UsageError, "baseline"),
        ({"focal_px": None, "focal_m": 4e-3}, UsageError, "go together"),
        ({"focal_m": 4e-3, "pixel_m": 3e-6}, UsageError, "twice"),
        ({"focal_px": None, "focal_m": 4e-3, "pixel_m": 3e-9}, Inconsistent, "a unit is wrong"),
        ({"mount": (0.0, 0.0, 0.1)}, UsageError, "arm"),
        ({"arm": "ur10e"}, UsageError, "world"),
        ({"simulate": 2}, UsageError, "2 runs"),
    ],
)
def test_what_cannot_be_is_refused(job: DesignJob, change: dict, kind: type, named: object) -> None:
    with refuses(kind, named):
        run_design(replace(job, **change))
    assert not job.out.exists()


def test_what_the_arm_does_not_reach_is_not_measured(job: DesignJob) -> None:
    short = replace(with_arm(job), arm="ur5e", volume=((0.5, 1.1), (-0.1, 0.1), (0.35, 0.65)))
    found = forecast(plan_of(short))
    beyond = np.array([why == OUT_OF_REACH for why in found.why])
    assert beyond.any() and not beyond.all()
    assert not found.measured[beyond].any() and np.isnan(found.position_m[beyond]).all()
    assert found.expected.placed[beyond].all()  # the cameras see it there


def test_a_rig_that_is_there(job: DesignJob) -> None:
    folder = job.target.parent
    camera = Camera.pinhole(1280, 720, 950.0, 950.0, 639.5, 359.5)
    write_rig(folder / "rig.yaml", parallel_rig(camera, 0.12))
    there = replace(job, rig=folder / "rig.yaml", size=None, focal_px=None, baseline_m=None)
    found = forecast(plan_of(there))
    np.testing.assert_allclose(found.position_m, forecast(plan_of(job)).position_m)
    assert plan_of(replace(there, baseline_m=0.2)).rig.baseline_m == pytest.approx(0.2)
    write_rig(folder / "known.yaml", found.rig)
    taken = replace(there, rig=folder / "known.yaml", board=None)
    np.testing.assert_allclose(forecast(plan_of(taken)).position_m, found.position_m, rtol=1e-6)
    with refuses(UsageError, "anew"):
        run_design(replace(taken, focal_px=1200.0))
    with refuses(UsageError, "simulate"):
        run_design(replace(taken, simulate=10))
    with refuses(UsageError, "toe-in-deg"):
        run_design(replace(there, toe_in_rad=5.0 * DEG))


@pytest.mark.parametrize("text", ["-0.1:0.2,-0.1:0.1", "a:b,c:d,e:f", "1,2,3", "0:1:2,0:1,0:1", ""])
def test_a_volume_that_is_none_is_refused(text: str) -> None:
    with refuses(UsageError, "XMIN:XMAX,YMIN:YMAX,ZMIN:ZMAX"):
        volume_of(text)


def test_volumes_and_mounts_are_read() -> None:
    assert volume_of("-100mm:200mm,-0.1:0.1,500mm:0.8m") == ((-0.1, 0.2), (-0.1, 0.1), (0.5, 0.8))
    assert mount_of("0,0,0.1,0,90,0") == (0.0, 0.0, 0.1, 0.0, 90.0, 0.0)
    with refuses(UsageError, "X,Y,Z"):
        mount_of("0,0")
    with refuses(UsageError, "nan"):
        mount_of("nan,0,0")


def test_simulated_runs_are_a_batch_and_beside_the_forecast(job: DesignJob) -> None:
    done = run_design(replace(job, cells=2, simulate=5, workers=1))
    one = done.simulation
    assert one is not None and one.n_runs == 5 and one.n_failed == 0
    assert one.n_poses + one.n_lost == 5 * len(one.places)
    assert sum(1 for path in (job.out / "runs").iterdir() if path.is_dir()) == 5
    # what Dask is told for a batch does not take its own defaults away from the next one
    assert dask.config.get("distributed.comm.tls.ciphers", default="lost") != "lost"
