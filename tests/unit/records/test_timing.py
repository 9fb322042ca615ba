"""A camera's timing: stamps to times, what is not known of them, and what cannot be."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from armsight.optics import Camera, parallel_rig
from armsight.records import CameraTiming, NamedCovariance
from armsight.store import read_camera_file, read_rig, write_camera, write_rig

CAMERA = Camera.pinhole(640, 480, 800.0, 800.0, 319.5, 239.5)


def test_the_clocks_uncertainty_grows_with_the_drifts() -> None:
    C = np.array([[4e-8, -3e-5], [-3e-5, 0.09]])
    timing = CameraTiming(covariance=NamedCovariance(names=("delay_s", "drift_ppm"), matrix=C))
    for t in (0.0, 100.0, 1000.0):
        J = np.array([1.0, 1e-6 * t])
        assert timing.clock_std_s(t) == pytest.approx(np.sqrt(J @ C @ J))
    assert CameraTiming(delay_s=1.0).clock_std_s([0.0, 5.0]).tolist() == [0.0, 0.0]


def test_timing_survives_its_files(tmp_path: Path) -> None:
    C = NamedCovariance(names=("delay_s", "readout_s"), matrix=np.array([[4e-8, 1e-8], [1e-8, 9e-8]]))
    timing = CameraTiming(readout_s=0.021, exposure_s=0.004, delay_s=-0.3, drift_ppm=7.5, jitter_s=2e-4, covariance=C)
    write_camera(tmp_path / "camera.yaml", CAMERA, timing=timing)
    rig = replace(parallel_rig(CAMERA, 0.1), timing=(CameraTiming(readout_s=0.02), timing))
    write_rig(tmp_path / "rig.yaml", rig)
    back = read_rig(tmp_path / "rig.yaml").timing
    for found in (read_camera_file(tmp_path / "camera.yaml").timing, back[1]):
        assert found is not None and found.covariance is not None
        assert (found.readout_s, found.exposure_s, found.delay_s, found.drift_ppm, found.jitter_s) == (
            0.021, 0.004, -0.3, 7.5, 2e-4,
        )  # fmt: skip
        assert found.covariance.names == C.names and np.array_equal(found.covariance.matrix, C.matrix)
    assert back[0] is not None and back[0].readout_s == 0.02 and back[0].covariance is None
