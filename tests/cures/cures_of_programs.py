"""Cures of robots' programs, of arms as their controllers have them, and of trackers that watch an arm."""

import contextlib

import pytest

from armsight.drivers.trackers.source import open_tracker
from armsight.errors import DeviceLost
from armsight.ops.verification.live import TRACKER_STD, check_eyes
from program_writers import PULSES, gcode, jbi, krl, pts
from tracker_servers import Qtm

POSES = [(500.0 + 20.0 * k, 10.0 * k - 40.0, 300.0 + 5.0 * k, 10.0, 20.0 + k, 170.0 - k) for k in range(6)]
JOINTS = [(10.0 * k, 3.0 * k - 50.0, 40.0 - 5.0 * k, 4.0 * k, 60.0, 20.0 - k) for k in range(6)]
ON_TRACK = krl(POSES).replace("E1 0.0", "E1 500.0", 1)
OF_AN_UR10 = """[mounting]
delta_d = [-0.000144894975118076, 303.4691356661582, -309.88394307789747, 6.41459904397395, -4.482329e-05, -0.00087071]
delta_a = [0.00010865106862793, 0.24032417525053235, 0.0018062818021349347, 2.630761491656844e-05, 3.966386325e-06, 0]
delta_theta = [1.5961352531693174e-07, -0.9172096215288302, 7.129361313464995, 0.07102990294243923, -1.6425897e-06, 0]
delta_alpha = [-0.0004447819528419217, -0.0016021511253121415, 0.006319177933310919, -0.00165055247, 0.00076368251, 0]
calibration_status = 2
"""
"""Of an UR10: the deltas of ur_calibration's own test, which hold for no other arm."""
FILES = {
    "programs/points.dat": krl(POSES),
    "programs/both.dat": krl(POSES, JOINTS),
    "programs/on_track.dat": ON_TRACK,
    "programs/still.dat": "".join(line for line in ON_TRACK.splitlines(keepends=True) if "P1=" not in line),
    "programs/job.jbi": jbi([], JOINTS, PULSES),
    "programs/points.pts": pts(POSES),
    "programs/no_unit.ngc": gcode(POSES).replace("G21 ", ""),
    "programs/in_mm.ngc": gcode(POSES),
    "programs/calibration.conf": OF_AN_UR10,
    "programs/melfa.prg": "".join(
        f"DEF POS P{k}=(300,{100 + 50 * k},400,{20.5 + k},170.2,0.00)(6,0)\n" for k in (1, 2)
    ),
}


def table(name):
    return f"convert table programs/{name} -o x.csv"


def tracked(body):
    """Return a call that opens a tracker of two bodies, and takes the frames of one until it ends."""

    def opened():
        pytest.importorskip("qtm_rt")
        server, (std_m, std_rad), frames = Qtm(), TRACKER_STD, []
        server.start()
        try:
            stream = open_tracker(f"qtm:127.0.0.1:{server.port}", body=body, std_m=std_m, std_rad=std_rad)
            with stream, contextlib.suppress(DeviceLost):  # which ends it
                frames.extend(stream)
        finally:
            server.ending.set()
            server.join(10.0)
            server.socket.close()
        assert frames

    return opened


FACTORY = "convert arm programs/calibration.conf -o ur.yaml"
TO_KUKA = "convert arm kr6 --to kuka -o krc.txt"
LIVE = "verify --live --robot sim:webcam-cell --arm cell/arm.yaml --world cell/world.yaml --frames 9 -o live"
EYES = "--left camera:sim:webcam-cell:left --right camera:sim:webcam-cell:right"
WATCHED = f"{LIVE} {EYES} --rig cell/rig.yaml --target cell/target.yaml"
UNSET = {"--rig": None, "--target": None}

TRIED = {
    ("ops/arm_files.py", "Give --nominal with the arm as its maker draws it"): (
        TO_KUKA,
        "{} --nominal kr6 && convert arm kr6 -o a.urdf && convert arm kr6 -o a.yaml "
        "&& {} --nominal a.urdf && {} --nominal a.yaml",
    ),
    ("ops/controllers.py", "Give --nominal with the arm that the controller has, and check the sense"): (
        f"{TO_KUKA} --nominal irb120",
        f"{TO_KUKA} --nominal kr6",
    ),
    ("ops/controllers.py", "Give --nominal with the arm that the controller has"): (
        f"{TO_KUKA} --nominal iiwa14",
        f"{TO_KUKA} --nominal kr6",
    ),
    ("ops/verification/live.py", "Give cameras, or the robot itself with --robot"): (
        f"{LIVE} --tracker qtm:127.0.0.1",
        WATCHED,
    ),
    ("ops/verification/live.py", "Give --rig and --target, or --tracker"): (
        lambda: check_eyes(None, UNSET, {}),
        (lambda: check_eyes(None, dict.fromkeys(UNSET, "a.yaml"), {}), lambda: check_eyes("qtm:host", UNSET, {})),
    ),
    ("ops/verification/live.py", "Leave it out, or give --tracker in place of the cameras"): (
        f"{WATCHED} --body Flange",
        WATCHED,
    ),
    ("store/factory_arms.py", "Give --nominal with the arm that the controller is of"): (
        f"{FACTORY} --nominal ur5",
        f"{FACTORY} --nominal ur10",
    ),
    ("store/factory_arms.py", "Give --nominal with the arm's name, such as ur10e"): (FACTORY, "{} --nominal ur10"),
    ("store/programs/calls.py", "Write G21 where its lengths are in mm"): (table("no_unit.ngc"), table("in_mm.ngc")),
    ("store/programs/kinds.py", "Leave --columns away"): (
        f"{table('points.dat')} --columns x_mm,y_mm,z_mm",
        table("points.dat"),
    ),
    ("store/programs/calls.py", "Give --euler xyz-fixed if the arm has six axes"): (
        table("melfa.prg"),
        "{} --euler xyz-fixed",
    ),
    ("store/programs/kinds.py", "Give --pulses-per-degree S,L,U,R,B,T"): (
        table("job.jbi"),
        f"{{}} --pulses-per-degree {','.join(map(str, PULSES))}",
    ),
    ("store/programs/points.py", "Give --euler with the order of the controller's manual"): (
        table("points.pts"),
        "{} --euler zyx",
    ),
    ("store/programs/points.py", "Say --as joints or --as poses"): (
        table("both.dat"),
        "{} --as joints && {} --as poses",
    ),
    ("store/programs/points.py", "Leave the points of one position of it in the file"): (
        table("on_track.dat"),
        f"{table('still.dat')} && {{}} --as-stated",
    ),
    ("drivers/trackers/source.py", "Give --body with the name of one"): (tracked(""), tracked("Flange")),
}
