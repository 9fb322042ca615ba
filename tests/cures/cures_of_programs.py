"""Cures of robots' programs, of arms as their controllers have them, and of trackers that watch an arm."""

from __future__ import annotations

from armsight.clock import ManualClock
from armsight.drivers.trackers.source import open_tracker
from armsight.kinematics import preset
from armsight.ops.requests.motion import RobotJob
from armsight.ops.verification.live import TRACKER_STD, open_tracked
from program_writers import PULSES, gcode, jbi, krl, pts
from tracker_servers import Qtm

POSES = [(500.0 + 20.0 * k, 10.0 * k - 40.0, 300.0 + 5.0 * k, 10.0, 20.0 + k, 170.0 - k) for k in range(6)]
JOINTS = [(10.0 * k, 3.0 * k - 50.0, 40.0 - 5.0 * k, 4.0 * k, 60.0, 20.0 - k) for k in range(6)]
ON_TRACK = krl(POSES).replace("E1 0.0", "E1 500.0", 1)
STILL = "".join(line for line in ON_TRACK.splitlines(keepends=True) if "XP1=" not in line and "FP1=" not in line)
IN_MM = gcode(POSES)
CONTROLLERS_UR10 = """[mounting]
delta_theta = [ -4.4823290e-05, 0, 0, 0, 0, 0]
calibration_status = 2 # 2
"""
FILES = {
    "programs/points.dat": krl(POSES),
    "programs/both.dat": krl(POSES, JOINTS),
    "programs/on_track.dat": ON_TRACK,
    "programs/still.dat": STILL,
    "programs/job.jbi": jbi([], JOINTS, PULSES),
    "programs/points.pts": pts(POSES),
    "programs/no_unit.ngc": IN_MM.replace("G21 ", ""),
    "programs/in_mm.ngc": IN_MM,
    "programs/calibration.conf": CONTROLLERS_UR10,
}


def tracked(body):
    """Return a call that opens a tracker that has two bodies, and takes a frame of one."""

    def opened():
        server = Qtm()
        server.start()
        try:
            device, (std_m, std_rad) = f"qtm:127.0.0.1:{server.port}", TRACKER_STD
            with open_tracker(device, body=body, std_m=std_m, std_rad=std_rad) as stream:
                assert next(iter(stream)).sequence == 0
        finally:
            server.ending.set()
            server.socket.close()

    return opened


def itself():
    """Open a tracker beside a robot that is none of the simulated ones."""
    open_tracked(RobotJob(robot="egm:6510"), "qtm:127.0.0.1", "", (None, None), ManualClock(), preset("ur10"))


TABLE = "convert table programs/{} -o x.csv"
POINTS, BOTH, ON_TRACK_POINTS, JOB, EPSON, NO_UNIT, IN_MM_POINTS, STILL_POINTS = (
    f"convert table programs/{name} -o x.csv"
    for name in (
        "points.dat",
        "both.dat",
        "on_track.dat",
        "job.jbi",
        "points.pts",
        "no_unit.ngc",
        "in_mm.ngc",
        "still.dat",
    )
)
FACTORY = "convert arm programs/calibration.conf -o factory.yaml"
TO_KUKA = "convert arm kr6 --to kuka -o krc.txt"
LIVE = "verify --live --robot sim:webcam-cell --arm cell/arm.yaml --world cell/world.yaml --frames 2 -o live"
EYES = "--left camera:sim:webcam-cell:left --right camera:sim:webcam-cell:right"
MEASURED = f"{EYES} --rig cell/rig.yaml --target cell/target.yaml"
TRIED = {}
