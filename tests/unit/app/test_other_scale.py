"""A target's file off by a few per cent, before a workshop full of lamps: named by its factor, and only then."""

import pytest
import yaml

from armsight.errors import DataRefused
from armsight.ops.measure import measure
from armsight.ops.simulation.run import simulate
from refusals import names_it


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    folder = tmp_path_factory.mktemp("workshop") / "cell"
    simulate("webcam-cell", folder, frames=24, room="workshop")
    return folder


def told(cell, tmp_path, change):
    content = yaml.safe_load((cell / "target.yaml").read_text())
    content["spots_m"] = {name: change(*xyz) for name, xyz in content["spots_m"].items()}
    (tmp_path / "target.yaml").write_text(yaml.safe_dump(content))
    sides = {side: str(cell / side) for side in ("left", "right")}
    given = {"rig": cell / "rig.yaml", "target": tmp_path / "target.yaml", "times": cell / "times.csv"}
    try:
        done = measure(**sides, **given, out=tmp_path / "run")
    except DataRefused as error:
        return str(error)
    return f"{done.consistency.sentence} {done.consistency.advice}"


def test_a_target_of_another_scale_is_named_among_other_lights(cell, tmp_path):
    factor = 1.01
    text = told(cell, tmp_path, lambda *xyz: [factor * value for value in xyz])
    assert names_it(text, "calliper")
    assert float(text.split("stand ")[1].split(" times")[0]) == pytest.approx(1.0 / factor, abs=0.003)


def test_a_target_of_another_shape_is_no_scale(cell, tmp_path):
    assert not names_it(told(cell, tmp_path, lambda x, y, z: [1.02 * x, 1.1 * y, z]), "calliper")
