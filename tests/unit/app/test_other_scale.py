"""Files of lengths that are off: a target's by a per cent, named by its factor; a rig's in another unit, named too."""

import re

import pytest
import yaml

from armsight.errors import DataRefused, NotEnoughData
from armsight.ops.action import action_of
from armsight.ops.measure import measure
from armsight.ops.simulation.run import simulate
from refusals import names_it, refuses


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    """A cell full of lamps."""
    folder = tmp_path_factory.mktemp("workshop") / "cell"
    simulate("webcam-cell", folder, frames=24, room="workshop")
    return folder


@pytest.fixture(scope="module")
def dark(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dark") / "cell"
    simulate("webcam-cell", folder, frames=12, room="dark")
    return folder


def measured(cell, out, **files):
    sides = {side: str(cell / side) for side in ("left", "right")}
    known = {name: cell / f"{name}.yaml" for name in ("rig", "target")} | files
    return action_of(measure).run({**sides, **known, "times": cell / "times.csv", "out": out})


def told_of_target(cell, tmp_path, change):
    content = yaml.safe_load((cell / "target.yaml").read_text())
    content["spots_m"] = {name: change(*xyz) for name, xyz in content["spots_m"].items()}
    (tmp_path / "target.yaml").write_text(yaml.safe_dump(content))
    try:
        done = measured(cell, tmp_path / "run", target=tmp_path / "target.yaml")
    except DataRefused as error:
        return str(error)
    return f"{done.consistency.sentence} {done.consistency.advice}"


def test_a_target_of_another_scale_is_named_among_other_lights_and_another_shape_is_no_scale(workshop, dark, tmp_path):
    text = told_of_target(workshop, tmp_path, lambda *xyz: [1.01 * value for value in xyz])
    assert names_it(text, "calliper")
    assert float(text.split("stand ")[1].split(" times")[0]) == pytest.approx(1.0 / 1.01, abs=0.003)
    (tmp_path / "shape").mkdir()
    assert not names_it(told_of_target(dark, tmp_path / "shape", lambda x, y, z: [1.02 * x, 1.1 * y, z]), "calliper")


def rig_times(cell, file, factor):
    """Write a rig whose lengths are multiplied."""
    content = yaml.safe_load((cell / "rig.yaml").read_text())
    for camera in content["cameras"].values():
        placed = camera.get("T_rig_camera", {"xyz_m": []})
        placed["xyz_m"] = [factor * value for value in placed["xyz_m"]]
    content.pop("covariance", None)
    file.write_text(yaml.safe_dump(content))
    return file


@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "millimetres"), (1 / 0.0254, "inches")])
def test_a_rig_in_another_unit_is_named_and_its_cure_works(dark, tmp_path, factor, unit):
    with refuses(NotEnoughData, "rig's", unit) as caught:
        measured(dark, tmp_path / "wide", rig=rig_times(dark, tmp_path / "wide.yaml", factor))
    cure = float(re.search(r"by (\S+),", caught.value.cure)[1])
    assert measured(dark, tmp_path / "out", rig=rig_times(dark, tmp_path / "narrow.yaml", factor * cure)).n_ok == 12


def test_among_other_lights_a_wide_rig_is_looked_at_first(workshop, tmp_path):
    with refuses(NotEnoughData, "120 m", "--unit"):
        measured(workshop, tmp_path / "out", rig=rig_times(workshop, tmp_path / "wide.yaml", 1000.0))
