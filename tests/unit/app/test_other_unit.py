"""A rig whose lengths are in another unit: named as the rig's, whatever the target, and its cure works."""

import re

import pytest
import yaml

from armsight.errors import NotEnoughData
from armsight.ops.action import action_of
from armsight.ops.measure import measure
from armsight.ops.simulation.run import simulate
from refusals import refuses


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    folder = tmp_path_factory.mktemp("unit") / "cell"
    simulate("webcam-cell", folder, frames=12, room="dark")
    return folder


def measured(cell, tmp_path, name, factor):
    """Measure with a rig whose lengths are multiplied."""
    content = yaml.safe_load((cell / "rig.yaml").read_text())
    for camera in content["cameras"].values():
        placed = camera.get("T_rig_camera", {"xyz_m": []})
        placed["xyz_m"] = [factor * value for value in placed["xyz_m"]]
    content.pop("covariance", None)
    (tmp_path / name).write_text(yaml.safe_dump(content))
    sides = {side: str(cell / side) for side in ("left", "right")}
    given = {"rig": tmp_path / name, "target": cell / "target.yaml", "times": cell / "times.csv"}
    return action_of(measure).run({**sides, **given, "out": tmp_path / f"run-{name}"})


@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "millimetres"), (1 / 0.0254, "inches")])
def test_a_rig_in_another_unit_is_named_and_its_cure_works(cell, tmp_path, factor, unit):
    with refuses(NotEnoughData, "rig's", unit) as caught:
        measured(cell, tmp_path, "wide.yaml", factor)
    cure = float(re.search(r"by (\S+),", caught.value.cure)[1])
    assert measured(cell, tmp_path, "narrow.yaml", factor * cure).n_ok == 12


def test_among_other_lights_a_wide_rig_is_looked_at_first(tmp_path):
    simulate("webcam-cell", tmp_path / "cell", frames=6, room="workshop")
    with refuses(NotEnoughData, "120 m", "--unit"):
        measured(tmp_path / "cell", tmp_path, "wide.yaml", 1000.0)
