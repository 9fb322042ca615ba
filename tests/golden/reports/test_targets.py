"""Strangers' lights before two cameras that need nothing: y up, another scale, intrinsics of another size."""

import pytest
import yaml

from armsight.errors import DataRefused
from armsight.ops.action import action_of
from armsight.ops.measure import measure
from refusals import names_it
from reports import case


def run(folder, tmp_path, rig="rig.yaml", target=None):
    rig = folder / rig if isinstance(rig, str) else rig
    job = {
        "rig": rig,
        "target": target or folder / "target.yaml",
        "left": str(folder / "left"),
        "right": str(folder / "right"),
        "stills": True,
        "out": tmp_path / f"run-{rig.stem}-{'given' if target is None else 'cured'}",
    }
    return action_of(measure).run(job)  # in the command line's words


def told(folder, tmp_path, rig="rig.yaml"):
    """Return what a run that does not fit says: of the refusal, or of its verdict."""
    try:
        done = run(folder, tmp_path, rig)
    except DataRefused as error:
        return str(error)
    assert done.consistency.verdict == "inconsistent"
    return f"{done.consistency.sentence} {done.consistency.advice}"


def changed(file, tmp_path, change):
    content = yaml.safe_load(file.read_text())
    change(content)
    (tmp_path / file.name).write_text(yaml.safe_dump(content))
    return tmp_path / file.name


def test_a_target_measured_with_y_up_is_named_and_the_cure_works(tmp_path):
    folder = case("cameras-16")
    assert names_it(told(folder, tmp_path), "mirror image", "sign of y")

    def down(content):
        for xyz in content["spots_m"].values():
            xyz[1] = -xyz[1]

    done = run(folder, tmp_path, target=changed(folder / "target.yaml", tmp_path, down))
    assert done.n_ok >= 10 and done.consistency.verdict == "ok"


@pytest.mark.parametrize(("rig", "factor"), [("rig_5pc.yaml", 0.95), ("rig_short.yaml", 0.58)])
def test_a_baseline_of_another_scale_is_named_by_its_factor(rig, factor, tmp_path):
    folder = case("cameras-10")
    text = told(folder, tmp_path, rig)
    assert names_it(text, "calliper", "armsight calibrate stereo")
    assert float(text.split("stand ")[1].split(" times")[0]) == pytest.approx(factor, abs=0.005)
    assert run(folder, tmp_path).consistency.verdict == "ok"  # the cameras calibrated anew


def test_intrinsics_of_another_size_are_named_and_the_cure_works(tmp_path):
    folder = case("cameras-25")
    assert names_it(told(folder, tmp_path), "edge", "640.6", "0.5")

    def half(content):
        for camera in content["cameras"].values():
            for key in ("fx", "fy", "cx", "cy"):
                camera[key] *= 0.5

    done = run(folder, tmp_path, rig=changed(folder / "rig.yaml", tmp_path, half))
    assert done.n_ok >= 3 and done.consistency.verdict == "ok"
