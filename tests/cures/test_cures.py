"""Cures are tried: followed to the letter on the case that causes them, here by commands, or in a test named here.

A new cure that names a flag, a command or a unit needs its entry: the number of those without one may only fall.
"""

from __future__ import annotations

import ast
import random
import re
import sys

import pytest

from cure_inventory import NAMES, ROOT, Cure, cures

UNTRIED = 374
"""Cures that name a flag, a command or a unit and are followed nowhere yet. Lower it when entries are added."""

ROWS = [
    [random.Random(k).uniform(-60.0, 60.0) for k in range(6 * i, 6 * i + 6)]
    + [random.Random(1000 + 3 * i + k).uniform(200.0, 600.0) for k in range(3)]
    for i in range(20)
]


def table(head, rows):
    return "\n".join([*([head] if head else []), *(",".join(f"{x:.5f}" for x in row) for row in rows)]) + "\n"


def pair(T="[-0.1, 0, 0]", D="[0, 0, 0, 0, 0]", size="image_width: 640\nimage_height: 480\n", more=""):
    """Return OpenCV's file of a pair."""
    cameras = "".join(f"M{i}: [[300, 0, 320], [0, 300, 240], [0, 0, 1]]\nD{i}: {D}\n" for i in (1, 2))
    return f"%YAML:1.0\n---\n{size}{cameras}R: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nT: {T}\n{more}"


FISH = "[-0.02, 0.006, -0.004, 0.0008]"
ANGLES = [[x / 1000.0 for x in row[6:]] + row[:3] for row in ROWS]
FILES = {
    "cm.yml": pair(T="[-7.5, 0, 0]"),
    "nosize.yml": pair(size=""),
    "fish.yml": pair(D=FISH),
    "fish-told.yml": pair(D=FISH, more="distortion_model: equidistant\n"),
    "rig.yml": pair(),
    "bare.csv": table("", ROWS),
    "degrees.csv": table("q1,q2,q3,q4,q5,q6", [row[:6] for row in ROWS]),
    "angles.csv": table("x_m,y_m,z_m,rx_deg,ry_deg,rz_deg", ANGLES),
}

BY_COMMAND = {
    ("store/foreign/numbers.py", "--unit 0.001"): ("convert rig cm.yml -o a.yaml", "{} --unit 0.01"),
    ("store/foreign/opencv.py", "--size 640x480"): ("convert rig nosize.yml -o a.yaml", "{} --size 640x480"),
    ("store/foreign/opencv.py", "distortion_model: equidistant"): (
        "convert rig fish.yml -o a.yaml",
        "convert rig fish-told.yml -o a.yaml",
    ),
    ("app/convert.py", "Give --to with"): (
        "convert rig rig.yml --to nothing -o a.yaml",
        "convert rig rig.yml --to ros -o l.yaml -o r.yaml",
    ),
    ("store/interpret/standard.py", "--columns q1..q6_deg,xyz_mm"): (
        "convert table bare.csv --as points -o a.csv",
        "{} --columns q1..q6_deg,xyz_mm",
    ),
    ("store/interpret/assemble.py", "--units deg or"): (
        "convert table degrees.csv --as joints -o a.csv",
        "{} --units deg",
    ),
    ("store/interpret/assemble.py", "--euler with the order"): (
        "convert table angles.csv --as poses -o a.csv",
        "{} --euler xyz-fixed",
    ),
    ("app/tables.py", "Give --as with"): (
        "convert table degrees.csv --as nothing -o a.csv",
        "convert table degrees.csv --as joints --units deg -o a.csv",
    ),
}
"""By module and words of the cure: the command that is refused, and the same as the cure has it ({}: as before)."""

REPORTS = "tests/golden/reports/"
IN_TESTS = {
    ("app/calibrate/board_images.py", "perhaps --board"): f"{REPORTS}test_old_charuco.py::test_the_old_layout_is_read",
    ("calibrate/arm/points.py", "armsight measure"): (
        f"{REPORTS}test_touched.py::test_touched_points_are_named_and_measured_ones_are_the_cure"
    ),
    ("calibrate/arm/senses.py", "sign: -1"): (
        f"{REPORTS}test_senses.py::test_a_joint_that_counts_the_other_way_is_named_and_the_cure_works"
    ),
    ("calibrate/cameras/lens_choice.py", "Use --lens"): (
        f"{REPORTS}test_pairs.py::test_a_mount_that_creeps_is_named_and_the_rig_is_right"
    ),
    ("calibrate/handeye/pairs.py", "armsight calibrate robot-world"): (
        f"{REPORTS}test_base_and_tool.py::test_the_rig_stands_in_the_axes_of_the_base_link"
    ),
    ("calibrate/tooltip.py", "25 degrees"): f"{REPORTS}test_tips.py::test_a_narrow_pivot_is_refused_for_its_tilt",
    ("store/interpret/standard.py", "Give --columns with -"): (
        f"{REPORTS}test_tracker_files.py::test_of_two_bodies_nobody_chooses_by_a_name"
    ),
    **{
        (f"store/{module}.py", words): f"{REPORTS}test_urdfs.py::test_what_is_refused_is_read_once_its_cure_is_followed"
        for module, words in (
            ("urdf_limits", "Write radians"),
            ("urdf_limits", "Write metres"),
            ("urdf_elements", "Write radians"),
            ("urdf", "Write metres here"),
        )
    },
    ("store/urdf_tree.py", "with --tip, such as"): (
        f"{REPORTS}test_base_and_tool.py::test_one_of_two_tools_is_asked_for_and_the_cure_names_it"
    ),
}
"""By module and words of the cure: the test that follows it, or shows the new data that it asks for."""

ENTRIES = [*BY_COMMAND, *IN_TESTS]


def of(module: str, words: str) -> list[Cure]:
    """Return the product's cures of a module that hold these words."""
    return [cure for cure in cures() if cure.module == module and words in cure.text]


def given(cure: Cure, told: str) -> bool:
    """Whether a message ends with a cure, whatever stands in its places."""
    pattern = ".*".join(re.escape(part) for part in cure.text.split("{}"))
    return re.search(re.sub(r"\\?\s+", r"\\s+", pattern), told) is not None


@pytest.mark.parametrize("entry", BY_COMMAND, ids=" ".join)
def test_a_cure_that_is_followed_to_the_letter_works(entry, armsight, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    command, cured = BY_COMMAND[entry]
    refused = armsight(*command.split())
    assert refused.code in (2, 3), refused.text
    assert any(given(cure, " ".join(refused.text.split())) for cure in of(*entry)), refused.text
    followed = armsight(*cured.format(command).split())
    assert followed.code == 0, followed.text


@pytest.mark.parametrize("entry", IN_TESTS, ids=" ".join)
def test_the_test_that_follows_a_cure_is_there(entry):
    file, name = IN_TESTS[entry].split("::")
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    assert name in {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def test_every_entry_is_of_a_cure_that_the_product_gives():
    assert not [entry for entry in ENTRIES if not of(*entry)]


def test_cures_without_a_trial_grow_no_more():
    every = cures()
    named = [cure for cure in every if cure.named]
    tried = {cure for entry in ENTRIES for cure in of(*entry)}
    untried = [cure for cure in named if cure not in tried]
    sys.stdout.write(f"{len(every)} cures, {len(named)} name a flag, a command or a unit, {len(tried)} are exercised\n")
    assert NAMES.search("Give --unit 0.001") and not NAMES.search("Correct it there")
    assert len(untried) <= UNTRIED, "follow the new cure in a test, and name it in this table"
