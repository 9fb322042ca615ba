"""Cameras' files with one fault: a reader refuses them or reads what was meant; none is wrong and called good."""

import json
import re

import cv2
import numpy as np
import pytest
import yaml

from armsight.errors import DataRefused, UsageError
from armsight.ops.conversion import load_camera, load_rig
from armsight.store import foreign
from armsight.store.foreign import Asked
from foreign_cameras import (
    LEFT,
    RIGHT,
    SIZE,
    aniposelib,
    caliscope,
    depthai,
    enumerated,
    halcon,
    multical,
    printed,
    step,
    zed,
)

FEW = 220
"""Files at least, over all kinds and faults."""


def kalibr(path):
    R, t = step(LEFT, RIGHT)
    T = np.vstack([np.column_stack([R, t]), [0.0, 0.0, 0.0, 1.0]])
    chain = {}
    for k, view in enumerate((LEFT, RIGHT)):
        (fx, _, cx), (_, fy, cy), _ = view.K.tolist()
        own = {} if k == 0 else {"T_cn_cnm1": T.tolist()}
        lens = {"distortion_model": "radtan", "distortion_coeffs": view.D[:4].tolist(), "camera_model": "pinhole"}
        chain[f"cam{k}"] = own | lens | {"intrinsics": [fx, fy, cx, cy], "resolution": list(SIZE), "rostopic": "/c"}
    path.write_text(yaml.safe_dump(chain))


def opencv(path):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", SIZE[0])
    storage.write("image_height", SIZE[1])
    R, t = step(LEFT, RIGHT)
    parts = {"M1": LEFT.K, "D1": LEFT.D[None], "M2": RIGHT.K, "D2": RIGHT.D[None], "R": R, "T": t[:, None]}
    for name, value in parts.items():
        storage.write(name, value)
    storage.release()


def ros(path):
    aniposelib(path.with_suffix(".toml"), (LEFT, RIGHT))
    rig = load_rig([path.with_suffix(".toml")])
    foreign.camera_to_ros(path, rig.left)


def metashape(path):
    values = {"f": 700.5, "cx": 1.5, "cy": -2.5, "b1": 0.4, "b2": -0.3, "k1": -0.1, "k2": 0.03, "p1": 0.001}
    size = {"projection": "frame", "width": SIZE[0], "height": SIZE[1]}
    tags = "\n".join(f"<{key}>{value}</{key}>" for key, value in (size | values).items())
    path.write_text(f'<?xml version="1.0" encoding="UTF-8"?>\n<calibration>\n{tags}\n</calibration>\n')


def colmap(path):
    lines = ["# Camera list with one line of data per camera:"]
    for k, view in enumerate((LEFT, RIGHT), 1):
        (fx, _, cx), (_, fy, cy), _ = view.K
        lens = " ".join(str(x) for x in view.D)
        lines.append(f"{k} FULL_OPENCV {SIZE[0]} {SIZE[1]} {fx} {fy} {cx + 0.5} {cy + 0.5} {lens} 0 0 0")
    path.write_text("\n".join([*lines, ""]))


def realsense(path):
    R, t = step(LEFT, RIGHT)
    path.write_text(enumerated("Depth", LEFT) + enumerated("Color", RIGHT) + printed(R, t))


def realsense_json(path):
    R, t = step(LEFT, RIGHT)
    content = {"depth_to_color": {"rotation": R.T.ravel().tolist(), "translation": t.tolist()}}
    for name, view in (("depth", LEFT), ("color", RIGHT)):
        (fx, _, ppx), (_, fy, ppy), _ = view.K.tolist()
        content[name] = {"width": SIZE[0], "height": SIZE[1], "fx": fx, "fy": fy, "ppx": ppx, "ppy": ppy}
        content[name] |= {"model": "brown_conrady", "coeffs": view.D.tolist()}
    path.write_text(json.dumps(content))


KINDS = {
    "kalibr.yaml": (kalibr, Asked()),
    "opencv.yml": (opencv, Asked()),
    "opencv.json": (opencv, Asked()),
    "opencv.xml": (opencv, Asked()),
    "ros.yaml": (ros, Asked()),
    "zed.conf": (zed, Asked(size=SIZE)),
    "depthai.json": (depthai, Asked(names=("CAM_B", "CAM_C"))),
    "aniposelib.toml": (lambda path: aniposelib(path, (LEFT, RIGHT)), Asked()),
    "caliscope.toml": (lambda path: caliscope(path, (LEFT, RIGHT)), Asked()),
    "multical.json": (lambda path: multical(path, (LEFT, RIGHT)), Asked()),
    "metashape.xml": (metashape, Asked()),
    "halcon.dat": (lambda path: halcon(path, Kappa=-1500.0), Asked()),
    "colmap.txt": (colmap, Asked(names=("1",))),
    "realsense.txt": (realsense, Asked()),
    "realsense.json": (realsense_json, Asked()),
}
LEFT_OUT = {
    "metashape.xml": ("a line less", "sizes exchanged"),
    "aniposelib.toml": ("an underscore for the point",),
    "caliscope.toml": ("an underscore for the point",),
}
"""Metashape leaves out what is zero, so that a file with a coefficient less is one of another lens; its principal point
is told from the middle, wherever that is. 1_000 is a number of TOML."""
OF_ONE = {"ros.yaml", "metashape.xml", "halcon.dat", "colmap.txt"}
NUMBER = re.compile(r"(?<![\w.])-?\d+\.\d+(?:e-?\d+)?(?![\w.])")


def one_number(change, pattern=NUMBER):
    """A fault in one number with a point, of those that stand in the text."""

    def fault(text, rng):
        found = list(pattern.finditer(text))
        if not found:
            return text
        one = found[rng.integers(len(found))]
        return text[: one.start()] + change(one[0]) + text[one.end() :]

    return fault


def a_line_less(text, rng):
    lines = text.splitlines(keepends=True)
    at = int(rng.integers(len(lines)))
    return "".join(lines[:at] + lines[at + 1 :])


def sizes_exchanged(text, rng):
    return text.replace(str(SIZE[0]), "@").replace(str(SIZE[1]), str(SIZE[0])).replace("@", str(SIZE[1]))


def cut_at_a_line(text, rng):
    lines = text.splitlines(keepends=True)
    return "".join(lines[: rng.integers(len(lines))])


def twice_with_another_number(text, rng):
    return text + one_number(lambda number: number.replace("7", "9").replace("1", "2"))(text, rng)


def in_unit(factor):
    """All lengths between cameras in another unit, where they are in metres."""
    _, t = step(LEFT, RIGHT)

    def fault(text, rng):
        for x in t:
            text = re.sub(
                rf"(?<![\w.]){re.escape(repr(float(x)))[:8]}\d*(?:e-?\d+)?(?!\w)", repr(float(factor * x)), text
            )
        return text

    return fault


FAULTS = {
    "millimetres for metres": in_unit(1000.0),
    "hundredths of millimetres": in_unit(1e-4),
    "cut at a line": cut_at_a_line,
    "cut in the middle": lambda text, rng: text[: int(len(text) * rng.uniform(0.2, 0.8))],
    "a line less": a_line_less,
    "decimal commas": lambda text, rng: NUMBER.sub(lambda found: found[0].replace(".", ","), text),
    "a decimal comma": one_number(lambda number: number.replace(".", ",")),
    "a comma for thousands": one_number(lambda number: f"1,{number}"),
    "an underscore for the point": one_number(lambda number: number.replace(".", "_")),
    "Fortran's exponent": one_number(lambda number: f"{number}D+00"),
    "not a number": one_number(lambda number: "nan"),
    "endless": one_number(lambda number: "1e999"),
    "huge": one_number(lambda number: "1e200"),
    "empty": one_number(lambda number: "", re.compile(NUMBER.pattern + r"(?=,)")),
    "a word": one_number(lambda number: "none"),
    "in quotes": one_number(lambda number: f'"{number}"'),
    "a number more": one_number(lambda number: f"{number}, {number}"),
    "sizes exchanged": sizes_exchanged,
    "twice, and not alike": twice_with_another_number,
    "carriage returns": lambda text, rng: text.replace("\n", "\r\n"),
    "a byte order mark": lambda text, rng: "\ufeff" + text,
    "two byte order marks": lambda text, rng: f"\ufeff\ufeff{text}",
    "other keys' letters": lambda text, rng: text.upper(),
}
BYTES = {
    "sixteen bits": lambda text: text.encode("utf-16"),
    "zeros between": lambda text: text.encode().replace(b"\n", b"\n\0"),
    "packed": lambda text: b"\x1f\x8b" + text.encode(),
}


def read(path, asked):
    """What a reader makes of a file, a row of numbers for each camera; None where it refuses."""
    try:
        if path.name in OF_ONE:
            camera = load_camera(path, asked)
            return np.array([[camera.width, camera.height, *camera.intrinsics]])
        rig = load_rig([path], asked)
    except (DataRefused, UsageError) as error:
        assert error.cause
        return None
    return np.array(
        [
            [one.camera.width, one.camera.height, *one.T_rig_camera.as_matrix().ravel(), *one.camera.intrinsics]
            for one in rig.cameras
        ]
    )


def good(got, right):
    """A refusal, or what was meant, of the cameras that are there: a file cut between two cameras is one of fewer."""
    return got is None or np.allclose(got, right[: len(got)], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", KINDS)
def test_a_file_with_a_fault_is_refused_or_read_as_it_was_meant(tmp_path, name):
    write, asked = KINDS[name]
    path = tmp_path / name
    write(path)
    text, right = path.read_text(), read(path, asked)
    assert right is not None
    rng, wrong, tried = np.random.default_rng(sum(name.encode())), [], 0
    for fault, change in FAULTS.items():
        if fault in LEFT_OUT.get(name, ()):
            continue
        for _ in range(3 if change in (cut_at_a_line, a_line_less) else 1):
            changed = change(text, rng)
            if changed == text:
                continue
            path.write_bytes(changed.encode())
            got, tried = read(path, asked), tried + 1
            if not good(got, right):
                wrong.append(fault)
    for fault, change in BYTES.items():
        path.write_bytes(change(text))
        got, tried = read(path, asked), tried + 1
        if not good(got, right):
            wrong.append(fault)
    assert not wrong
    assert tried * len(KINDS) >= FEW
