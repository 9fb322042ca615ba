"""A folder in which cures are tried: two drawn pairs of cameras, a simulated cell, an arm's poses, small texts."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

sys.path.insert(0, str(Path(__file__).parent))  # the tables beside this file
sys.path.insert(0, str(Path(__file__).parents[1]))  # histories.py

from cure_tables import FILES

import warm_python
from armsight_lab.design.changes import CHANGES
from histories import baseline_runs, runs
from simulated import simulated


@pytest.fixture(scope="session")
def given_files(request):
    """The folder of `fill`."""
    drawn = [request.getfixturevalue(name) for name in ("scene", "boards", "mirror_boards")]
    return warm_python.once("given", lambda folder: fill(folder, *drawn))


def fill(folder, scene, boards, mirror_boards):
    """left/ and right/ with rig.yaml and target.yaml; boards/; cell/ of `simulate`; j.csv and poses.csv of an arm."""
    from armsight.store.tokens import add_token
    from armsight_plant.certificates import make_pair

    shutil.copytree(scene.folder, folder)
    shutil.copytree(boards.folder, folder / "boards")
    shutil.copytree(mirror_boards.straight, folder / "mirrors")
    write_stills(folder / "stills")
    shutil.copytree(simulated("webcam-cell", frames=3, room="dark"), folder / "cell")
    for name, text in FILES.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    fill_history(folder / "history.db")
    make_pair(folder / "keys", "server.example")
    add_token(folder / "tokens.yaml", "me", "watch")
    (folder / "password").write_text("secret\n")
    (folder / "password").chmod(0o600)
    shutil.copy(folder / "rig.yaml", folder / "pair320.yaml")
    done("kinematics", "fk", "--arm", "irb120", "--joints", folder / "j.csv", "-o", folder / "poses.csv")
    views = ("--image", folder / "mirrors", "--board", mirror_boards.board)
    done("calibrate", "mirrors", *views, "-o", folder / "mirrors.yaml")
    _, *rows = (folder / "poses.csv").read_text().splitlines()
    head, places = "x_m,y_m,z_m,qx,qy,qz,qw", [",".join(row.split(",")[1:8]) for row in rows]
    (folder / "places.csv").write_text("\n".join([head, *places]) + "\n")
    unread = [f"{head},q1,q2,q3,q4,q5,q6", *(place + 6 * "," for place in places)]
    (folder / "unread.csv").write_text("\n".join(unread) + "\n")


def done(*words):
    """Do a command that has to succeed."""
    from armsight.cli.commands import app

    ran = CliRunner().invoke(app, [str(word) for word in words])
    assert ran.exit_code == 0, ran.output


def write_stills(folder):
    """Write five still frames of a slope, of variance 2 + level / 10."""
    folder.mkdir()
    rng = np.random.default_rng(5)
    light = 15.0 + 180.0 * np.tile(np.linspace(0.0, 1.0, 320), (240, 1))
    for i in range(5):
        image = np.rint(light + rng.normal(size=light.shape) * np.sqrt(2.0 + light / 10.0))
        cv2.imwrite(str(folder / f"{i}.png"), image.astype(np.uint8))


def fill_history(path):
    """File three runs of an arm, and baselines of which nobody tells a deviation, or one that no chart holds."""
    from armsight_lab.history.adding import file_entry
    from armsight_lab.history.place import place_of

    untold = baseline_runs("untold", [0.5, 0.501, 0.502], None)
    for entry in [*runs("a", 3), *untold, *baseline_runs("wide", [1e300] * 9 + [2e300] * 3, 1e297)]:
        file_entry(place_of(str(path)), entry)


def lent(source: str, goal: str) -> None:
    """Link a file, which the product replaces and never changes; copy a database, which it writes into."""
    (shutil.copy2 if source.endswith(".db") else os.link)(source, goal)


@pytest.fixture
def trial_folder(given_files, tmp_path, monkeypatch):
    """Stand in a folder of the trial's own, with the given files in it."""
    shutil.copytree(given_files, tmp_path, copy_function=lent, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ARMSIGHT_HISTORY", str(tmp_path / "history.db"))
    monkeypatch.setattr("armsight_lab.design.changes.CHANGES", CHANGES[:1])  # what a plan tells of others costs most
    return tmp_path
