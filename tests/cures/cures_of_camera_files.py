"""Cures of cameras' files of devices and other programs."""

import json
from pathlib import Path

from armsight.measure.poses.moments import require_views
from armsight.measure.poses.setup import Setup
from armsight.records import spot_target
from armsight.store import read_rig

SIDE = "fx=700\nfy=700\ncx=640\ncy=360\nk1=-0.1\nk2=0.02\np1=0\np2=0\nk3=0\n"
BOARD = {
    "cameraType": 0,
    "width": 1280,
    "height": 800,
    "intrinsicMatrix": [[800, 0, 640], [0, 800, 400], [0, 0, 1]],
    "distortionCoeff": [0.0] * 14,
}


def socket(number, to, x_cm):
    return [
        number,
        BOARD
        | {
            "extrinsics": {
                "rotationMatrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
                "translation": {"x": x_cm, "y": 0, "z": 0},
                "toCameraSocket": to,
            }
        },
    ]


def halcon(kappa):
    values = {"Focus": 0.008, "Kappa": kappa, "Sx": 1e-5, "Sy": 1e-5, "Cx": 378, "Cy": 297}
    lines = [f"{name}:{name.lower()}: {value};\nDOUBLE::;\n" for name, value in values.items()]
    return "ParGroup: Camera: Parameter;\n" + "".join(lines) + "ImageWidth:imgw: 768;\nImageHeight:imgh: 576;\n"


def called_otherwise():
    """Measure by two cameras that are not called left and right."""
    text = Path("rig.yaml").read_text().replace("left", "east").replace("right", "west")
    Path("ew.yaml").write_text(text.replace("version: 1", "version: 2").replace("kind: stereo", "kind: cameras"))
    target = spot_target({"A": (0.0, 0.0, 0.0), "B": (0.1, 0.0, 0.0), "C": (0.0, 0.1, 0.0)})
    require_views(Setup(rig=read_rig(Path("ew.yaml"), any_cameras=True), target=target), 2)


FILES = {
    "SN1.conf": f"[LEFT_CAM_HD]\n{SIDE}[RIGHT_CAM_HD]\n{SIDE}[LEFT_CAM_VGA]\nfx=350\n"
    "[STEREO]\nBaseline=120\nTY=0\nTZ=0\nCV_HD=0\nRX_HD=0\nRZ_HD=0\n",
    "oak.json": json.dumps({"cameraData": [socket(1, 2, -7.5), socket(2, -1, 0)]}),
    "campar.dat": halcon(-60000.0),
    "tilted.yml": "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n"
    "camera_matrix: [[600, 0, 320], [0, 600, 240], [0, 0, 1]]\n"
    "distortion_coefficients: [0.1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0.02, 0.01]\n",
    "cameras.txt": "# Camera list with one line of data per camera:\n1 PINHOLE 640 480 600 600 320.5 240.5\n"
    "2 PINHOLE 640 480 600 600 320.5 240.5\n",
    "rigs.txt": "# Rig calib list with one line of data per calib:\n1 2 CAMERA 1 CAMERA 2 1 1 0 0 0 -0.1 0 0\n",
    "chain.toml": '[cam_0]\nname="a"\nsize=[640,480]\nmatrix=[[600.0,0,320],[0,600.0,240],[0,0,1]]\n'
    "distortions=[0.0,0.0,0.0,0.0,0.0]\nrotation=[0.0,0.0,0.0]\ntranslation=[0.0,0.0,0.0]\n",
}
OAK = "convert camera oak.json -o b.yaml"
TRIED = {
    ("measure/poses/moments.py", "Write its file anew"): (
        called_otherwise,
        "convert rig ew.yaml --name east --name west -o pair.yaml && doctor --rig pair.yaml",
    ),
    ("store/foreign/devices.py", "Give the size of one camera's images"): (
        "convert rig SN1.conf -o z.yaml",
        "convert rig SN1.conf --size 1280x720 -o z.yaml",
    ),
    ("store/foreign/devices.py", "Record at that size"): (
        f"{OAK} --name CAM_B --size 640x400",
        f"{OAK} --name CAM_B",
    ),
    ("store/foreign/formats.py", "Leave --unit out"): (
        "convert rig oak.json --unit 0.01 -o oak.yaml",
        "convert rig oak.json -o oak.yaml",
    ),
    ("store/foreign/several.py", "Say which: --name"): (
        OAK,
        f"{OAK} --name CAM_B && convert rig oak.json -o both.yaml",
    ),
    ("store/foreign/lenses.py", "lens all the same with --approximate"): (
        "convert camera campar.dat -o h.yaml",
        "convert camera campar.dat -o h.yaml --approximate",
    ),
    ("store/foreign/opencv_lens.py", "with --approximate"): (
        "convert camera tilted.yml -o t.yaml",
        "convert camera tilted.yml -o t.yaml --approximate",
    ),
    ("store/foreign/colmap.py", "Give the length of its unit"): (
        "convert rig cameras.txt rigs.txt -o r.yaml",
        "convert rig cameras.txt rigs.txt --unit 1 -o r.yaml",
    ),
    ("ops/conversion.py", "Use armsight convert rig"): (
        "convert camera small.yaml --to aniposelib -o a.toml",
        "convert rig chain.toml --to aniposelib -o a.toml",
    ),
}
