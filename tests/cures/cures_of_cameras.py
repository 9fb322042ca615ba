"""Cures of cameras: lenses, noise, zooms, mirrors, and measuring and recording with them."""

from pathlib import Path

import cv2
import numpy as np

from armsight.drivers.opening import open_source

LENS = "fx: {0}, fy: {0}, cx: 160.3, cy: 119.6, distortion: [0, 0, 0, 0, 0]"
SMALL = "format: armsight/camera\nversion: 1\nwidth: 320\nheight: 240\n"
PLAIN = "".join(f"{key}\n" for key in ["fx: 400", "fy: 400", "cx: 160.3", "cy: 119.6", "distortion: [0, 0, 0, 0, 0]"])


def zooms(focals, pupils=()):
    """Return the settings of a zoom lens by their focal lengths, with pupils where these are told."""
    rows = ""
    for zoom, focal in focals.items():
        pupil = f", pupil_m: {pupils[zoom]}" if zoom in pupils else ""
        known = "covariance: {names: [fx], matrix: [[0.01]]}"
        rows += f"- {{zoom: {zoom}, {LENS.format(focal)}, {known}{pupil}}}\n"
    return f"{SMALL}zoom:\n{rows}"


FOCALS = {100: 400, 200: 460, 300: 540}
SIDE = "width: 320, height: 240, " + LENS.format(400)


def placed(**x_m):
    """Return the cameras of a rig, by name, where along x each stands."""
    return "".join(
        f"  {name}: {{{SIDE}, T_rig_camera: {{xyz_m: [{x}, 0, 0], quat_xyzw: [0, 0, 0, 1]}},\n"
        "    timing: {delay_s: 0.0002}}\n"
        for name, x in x_m.items()
    )


RIG = "format: armsight/rig\nversion: {}\nkind: {}\ncameras:\n{}"
FILES = {
    "rational.yml": "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n"
    "camera_matrix: [[300, 0, 320], [0, 300, 240], [0, 0, 1]]\n"
    "distortion_coefficients: [0, 0, 0, 0, 0, 4, 0, 0]\n",
    "lens640.yaml": "format: armsight/camera\nversion: 1\nwidth: 640\nheight: 480\n"
    "fx: 520\nfy: 521\ncx: 321\ncy: 238\ndistortion: [0, 0, 0, 0, 0]\n",
    "small.yaml": SMALL + PLAIN,
    "lens.yaml": zooms(FOCALS),
    "two.yaml": zooms({100: 400, 200: 460}),
    "mixed.yaml": zooms(FOCALS, {100: 0.01}),
    "timed.yaml": RIG.format(1, "stereo", placed(left=0.0, right=0.1)),
    "three.yaml": RIG.format(2, "cameras", placed(left=0.0, right=0.1, top=0.2)),
    "newer.yaml": SMALL.replace("version: 1", "version: 9") + PLAIN,
    "board.yaml": "format: armsight/target\nversion: 1\nkind: checkerboard\ncolumns: 7\nrows: 5\nsquare_m: 0.02\n",
    "empty.mcap": "",
}
BOARD = "--board checkerboard:7x5:0.02"
BOARDS = f"{BOARD} -o c.yaml --frames 5"
CAMERA = f"calibrate camera boards/left {BOARDS}"
NOISE = "calibrate camera --noise stills -o"
ZOOM_RIG = "calibrate zoom-rig --rig rig.yaml -o z.yaml"
ZOOMED = f"{ZOOM_RIG} --left lens.yaml --zoom-left 100"
SIDES = "--left left --right right"
MEASURE = f"measure --rig rig.yaml --target target.yaml {SIDES} -o m"
OF_CAMERAS = "measure --rig rig.yaml --target target.yaml -o m"
OF_NAMED = f"{OF_CAMERAS} --camera left=left --camera right=right"
OF_TIMED = "measure --rig timed.yaml --target target.yaml -o m"
RECORD = f"record {SIDES} -o a.mcap"
MIRRORS = f"calibrate mirrors {BOARD} -o x.yaml --every 2"
CHECK = "calibrate mirrors --check --frames 2"
LIT = "calibrate mirrors --image mirrors -o x.yaml --camera lens640.yaml --baseline-mm 160"


STEREO = f"calibrate stereo --left boards/left --right boards/right {BOARDS}"


def beside():
    """Write the images of both cameras side by side."""
    Path("beside").mkdir()
    for path in Path("boards/left").iterdir():
        both = [cv2.imread(str(Path("boards", side, path.name)), cv2.IMREAD_GRAYSCALE) for side in ("left", "right")]
        cv2.imwrite(f"beside/{path.name}", np.hstack(both))


TRIED = {
    ("ops/calibration/camera_noise.py", "Give the camera.yaml or rig.yaml"): (
        f"{NOISE} none.yaml",
        f"{NOISE} small.yaml",
    ),
    ("ops/calibration/camera_noise.py", "Add {}"): (f"{NOISE} rig.yaml", "{} --side left"),
    ("ops/calibration/camera_noise.py", "Leave --side away"): (
        f"{NOISE} small.yaml --side left",
        f"{NOISE} small.yaml",
    ),
    ("ops/calibration/camera_noise.py", "Add --side where the noise"): (
        f"{NOISE} rig.yaml --side left && calibrate camera --noise rig.yaml -o small.yaml",
        f"calibrate camera --noise rig.yaml -o pair320.yaml --side left && {NOISE} small.yaml",
    ),
    ("ops/calibrate_cameras.py", "Give SRC and --board"): (f"calibrate camera {BOARDS}", CAMERA),
    ("ops/calibrate_cameras.py", "Leave --side away"): (f"{CAMERA} --side left", CAMERA),
    ("ops/calibrate_cameras.py", "Give --zoom with the value"): (f"{CAMERA} --pupil 0.01", "{} --zoom 100"),
    ("ops/calibrate_cameras.py", "Give --pupil"): (f"{CAMERA} --zoom 100 --pupil-std 0.001", "{} --pupil 0.01"),
    ("ops/calibrate_cameras.py", "Give --lens with"): (f"{CAMERA} --lens oval", f"{CAMERA} --lens pinhole"),
    ("calibrate/cameras/zoom.py", "Give --left, --right or both"): (ZOOM_RIG, ZOOMED),
    ("optics/zoom_rig.py", "Give --zoom-{}"): (f"{ZOOM_RIG} --left lens.yaml", "{} --zoom-left 100"),
    ("optics/zoom_rig.py", "Check the file of the"): (f"{ZOOM_RIG} --left lens.yaml --zoom-left 300", ZOOMED),
    ("optics/zoom_rig.py", "with the value that the lens stood at"): (
        f"{ZOOMED} && {MEASURE.replace('rig.yaml', 'z.yaml')}",
        f"{MEASURE.replace('rig.yaml', 'z.yaml')} --zoom-left 100 && "
        "convert rig z.yaml -o fixed.yaml --zoom-left 100 && doctor --rig fixed.yaml",
    ),
    ("optics/rig.py", "Give the rig.yaml of a pair"): (
        "doctor --rig three.yaml --depth 1 --accuracy 1",
        f"{STEREO} && doctor --rig c.yaml --depth 1 --accuracy 1",
    ),
    ("ops/flags.py", "Write for instance --camera"): (f"{OF_CAMERAS} --camera left", OF_NAMED),
    ("ops/sources/cameras.py", "Leave --{} or --camera {}= away"): (
        f"{MEASURE} --camera left=left",
        f"{MEASURE} && {OF_NAMED} --overwrite",
    ),
    ("store/codec.py", "Update armsight where the file is"): (
        "convert camera newer.yaml --to opencv -o one.yml",
        "convert camera small.yaml --to opencv -o one.yml",
    ),
    ("optics/zoom_rig.py", "away, or add the settings"): (
        f"{MEASURE} --zoom-left 100",
        f"{MEASURE} && {ZOOMED} && {MEASURE.replace('rig.yaml', 'z.yaml')} --zoom-left 100 --overwrite",
    ),
    ("optics/zoom.py", "Set the lens to {}"): (
        "convert camera two.yaml --zoom 150 -o one.yaml",
        "convert camera two.yaml --zoom 100 -o one.yaml",
    ),
    ("optics/zoom.py", "Set the lens within"): (
        "convert camera lens.yaml --zoom 400 -o one.yaml",
        "convert camera lens.yaml --zoom 250 -o one.yaml",
    ),
    ("optics/zoom.py", "Give pupil_m (--pupil)"): (
        "convert camera mixed.yaml --zoom 100 -o one.yaml",
        "convert camera lens.yaml --zoom 100 -o one.yaml",
    ),
    ("store/zoom.py", "Calibrate its settings into"): (
        "convert camera small.yaml --zoom 100 -o one.yaml",
        f"{CAMERA} --zoom 100 && convert camera c.yaml --zoom 100 -o one.yaml",
    ),
    ("store/rigs.py", "Make the file of one setting"): (
        "convert camera lens.yaml --to opencv -o one.yml",
        "convert camera lens.yaml --zoom 150 -o fixed.yaml && convert camera fixed.yaml --to opencv -o one.yml",
    ),
    ("ops/convert.py", "with --zoom-left"): (
        f"{ZOOMED} && convert rig z.yaml -o a.yaml -o b.yaml --zoom-left 100",
        "convert rig z.yaml -o a.yaml --zoom-left 100",
    ),
    ("ops/calibration/mirrors.py", "Give --board, for instance"): (
        "calibrate mirrors -o x.yaml --image mirrors --every 2",
        f"{MIRRORS} --image mirrors",
    ),
    ("ops/calibration/mirrors.py", "Give --image, or --left-only"): (MIRRORS, "{} --image mirrors"),
    ("ops/calibration/mirrors.py", "Give {} too, with"): (f"{MIRRORS} --left-only left", f"{MIRRORS} --image mirrors"),
    ("ops/calibration/mirrors.py", "or covered views with --board"): (
        "calibrate mirrors -o x.yaml --target target.yaml --left-only left --right-only right",
        f"{MIRRORS} --image mirrors",
    ),
    ("ops/calibration/mirrors.py", "or, to make the axes parallel"): (
        f"{CHECK} --image mirrors {BOARD}",
        "{} --rig mirrors.yaml && {} --camera lens640.yaml --baseline-mm 160",
    ),
    ("cli/calibrate_cameras.py", "Give --image, and --rig"): (
        f"{CHECK} --rig mirrors.yaml {BOARD}",
        "{} --image mirrors",
    ),
    ("cli/calibrate_cameras.py", "Leave --target out"): (
        f"{CHECK} --rig mirrors.yaml --image mirrors --target target.yaml",
        f"{CHECK} --rig mirrors.yaml --image mirrors {BOARD}",
    ),
    ("calibrate/mirrors/diagnosis.py", "Give the rig.yaml of"): (
        f"{CHECK} --rig rig.yaml --image mirrors {BOARD}",
        f"{CHECK} --rig mirrors.yaml --image mirrors {BOARD}",
    ),
    ("ops/calibration/mirrors_lit_target.py", "Give it as --board"): (
        f"{LIT} --target board.yaml",
        "calibrate mirrors --image mirrors -o x.yaml --every 2 --board board.yaml",
    ),
    ("ops/calibration/mirrors_lit_target.py", "or calibrate with --board"): (
        f"{LIT} --target labels.yaml",
        f"{MIRRORS} --image mirrors",
    ),
    ("ops/measurement/streams.py", "Leave --timing free away"): (
        f"{MEASURE} --stills --timing free",
        f"{MEASURE} --stills",
    ),
    ("ops/measurement/streams.py", "in place of --left and --right"): (
        "measure --rig mirrors.yaml --target board.yaml --left mirrors --right mirrors -o m",
        "measure --rig mirrors.yaml --target board.yaml --image mirrors -o m",
    ),
    ("ops/measurement/streams.py", "one recording as --left"): (
        "measure --rig rig.yaml --target target.yaml -o m",
        f"{MEASURE} && {RECORD} && measure --rig rig.yaml --target target.yaml --left a.mcap -o m --overwrite",
    ),
    ("ops/measurement/streams.py", "or use --timing pairs"): (f"{MEASURE} --timing free", f"{MEASURE} --timing pairs"),
    ("ops/measurement/free_running.py", "or use --timing pairs"): (
        f"{OF_TIMED} {SIDES} --target labels.yaml",
        "{} --timing pairs",
    ),
    ("ops/recording/record.py", "Give --left and --right, --camera NAME=SRC, or --cell"): ("record -o a.mcap", RECORD),
    ("store/recording/mcapfile.py", "or give --overwrite"): (f"{RECORD} && {RECORD}", f"{RECORD} --overwrite"),
    ("ops/recording/export.py", "Give --to with one of"): (
        f"{RECORD} && convert recording a.mcap -o f --to zip",
        "convert recording a.mcap -o f --to files",
    ),
    ("store/recording/record_reader.py", "or another MCAP program"): (
        "convert recording empty.mcap -o f",
        f"{RECORD} && convert recording a.mcap -o f",
    ),
    ("drivers/opening.py", "armsight convert recording"): (
        (RECORD, lambda: open_source("a.mcap")),
        ("convert recording a.mcap -o f", lambda: list(open_source("f/left").__enter__())),
    ),
    ("ops/sources/cameras.py", "Give each camera's own source"): (
        "measure --rig rig.yaml --target target.yaml --left left --right left -o m",
        MEASURE,
    ),
    ("ops/sources/frames.py", "Leave --times and --fps away"): (
        f"{RECORD} && measure --rig rig.yaml --target target.yaml --left a.mcap --fps 30 -o m",
        "measure --rig rig.yaml --target target.yaml --left a.mcap -o m",
    ),
    ("ops/sources/cameras.py", "or give one recording that has all"): ("record --left left -o a.mcap", RECORD),
    ("store/foreign/opencv_lens.py", "Calibrate it with armsight calibrate camera"): (
        "convert camera rational.yml -o c.yaml",
        CAMERA,
    ),
    ("calibrate/cameras/calibrate.py", "Exchange the sources"): (
        f"calibrate stereo --left boards/right --right boards/left {BOARDS}",
        STEREO,
    ),
    ("ops/calibration/mirrors_lit_target.py", "Cut the images in two"): (
        (beside, LIT.replace("mirrors -o", "beside -o") + " --target lit.yaml"),
        STEREO,
    ),
    ("calibrate/mirrors/calibration.py", "Cut every image in two"): ((beside, f"{MIRRORS} --image beside"), STEREO),
    ("ops/machine.py", "Give --rig with it"): ("doctor --depth 1", "{} --rig rig.yaml"),
    ("ops/machine.py", "Give --rig and --depth"): ("doctor --accuracy 1", "{} --rig rig.yaml --depth 1"),
    ("ops/simulation/run.py", "Leave --room and --zoom"): (
        "simulate arm-points --room dark -o s",
        "simulate arm-points -o s",
    ),
    ("store/board_print.py", "or give WIDTHxHEIGHT in mm such as"): (
        "board circles:5x5:0.02 --paper b9 -o b.pdf",
        "board circles:5x5:0.02 --paper 150x150 -o b.pdf",
    ),
    ("store/board_print.py", "Choose --paper {}, or a"): (
        "board checkerboard:8x6:0.03 -o b.pdf",
        ("board checkerboard:8x6:0.026 -o small.pdf", "board checkerboard:8x6:0.03 --paper a3 -o b.pdf"),
    ),
    ("store/board_print.py", "Leave --dot and --bigger-first away"): (
        "board checkerboard:8x6:0.02 --dot 5mm -o b.pdf",
        "board checkerboard:8x6:0.02 -o b.pdf",
    ),
    ("store/board_print.py", "Leave --old-layout away"): (
        "board circles:5x5:0.02 --old-layout -o b.pdf",
        "board circles:5x5:0.02 -o b.pdf",
    ),
    ("store/board_print.py", "Give --dot of {} m or less"): (
        "board circles:5x5:0.02 --dot 14mm --bigger-first -o b.pdf",
        "board circles:5x5:0.02 --dot 0.01 --bigger-first -o b.pdf",
    ),
}
