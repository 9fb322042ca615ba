"""Cures of arms that touch, and of simulated cameras that follow a controller's arm."""

from pathlib import Path

import numpy as np

from armsight.app.operator.robot_cell import scenario_of
from armsight.calibrate.arm.touch import Kind, KnownLength, Touches
from armsight.calibrate.arm.touch.touches import check_touches
from armsight.drivers.linuxcnc import LinuxcncRobot
from armsight.kinematics import preset
from armsight.ops.arm_files import load_arm
from armsight.ops.flags import lengths_of
from armsight.ops.requests.motion import RobotJob, refuse_cameras, require_named
from armsight.ops.simulation.following import require_joints
from armsight.ops.verification.live import check_stop
from armsight.store.arm_points import read_arm_points
from armsight.store.touch_table import read_touches

SIMULATE = "simulate webcam-cell --frames 1 --room dark -o made"
Q = np.random.default_rng(7).uniform(-1.0, 1.0, (12, 6))
HEAD = "q1,q2,q3,q4,q5,q6"
FILES = {
    "apart.csv": f"{HEAD},x_m,y_m,z_m\n" + "".join(f"{','.join(map(str, q))},0.{k},0.2,0.3\n" for k, q in enumerate(Q)),
    "called.csv": f"{HEAD},feature\n" + "".join(f"{','.join(map(str, q))},spike{k % 2}\n" for k, q in enumerate(Q)),
}


def touching(q=Q, length_m=0.27):
    """Return a call that checks touches of two spikes, a length apart."""
    m = len(q)
    known = KnownLength(a="a", b="b", length_m=length_m, sigma_m=1e-4)
    touches = Touches(
        q=q,
        feature=("a", "b") * (m // 2),
        kind=(Kind.POINT,) * m,
        reading_m=np.zeros(m),
        sigma_m=np.zeros(m),
        lengths=(known,),
        row=np.arange(m),
    )
    return lambda: check_touches(preset("irb120"), touches)


READ = LinuxcncRobot("127.0.0.1", settings={"reads_only": True})
TRIED = {
    ("ops/verification/live.py", "Leave --stop-mm, --stop-deg and --stop-blind out"): (
        lambda: check_stop(READ, asked=True),
        lambda: check_stop(READ, asked=False),
    ),
    ("app/operator/robot_cell.py", "Leave --follow out, or name a real controller"): (
        lambda: scenario_of(RobotJob(robot="sim:webcam-cell", follow="webcam-cell")),
        lambda: [
            scenario_of(RobotJob(robot="sim:webcam-cell")),
            scenario_of(RobotJob(robot="egm:6510", follow="webcam-cell")),
        ],
    ),
    ("ops/requests/motion.py", "Leave it out, or --follow"): (
        lambda: refuse_cameras("webcam-cell", left="camera:0", right=None),
        lambda: [
            refuse_cameras("webcam-cell", left=None, right=None),
            require_named({"left": "camera:0", "right": "camera:2"}),
        ],
    ),
    ("ops/requests/motion.py", "Give --left and --right, --camera NAME=SRC for each"): (
        lambda: require_named({}),
        lambda: [
            require_named({"left": "camera:0", "right": "camera:2"}),
            refuse_cameras("webcam-cell", left=None, right=None),
        ],
    ),
    ("ops/simulation/following.py", "armsight simulate SCENARIO --arm FILE -o FOLDER"): (
        lambda: require_joints(3, "egm:6510", 6),
        (f"{SIMULATE} --arm irb120", lambda: require_joints(load_arm("made/arm.yaml").n, "egm:6510", 6)),
    ),
    ("ops/simulation/run.py", "Give --arm with a scenario"): (
        f"{SIMULATE} --home {','.join(['0.1'] * 6)}",
        f"{SIMULATE} --arm irb120",
    ),
    ("calibrate/arm/touch/touches.py", "Give metres, or the unit"): (
        touching(length_m=270.0),
        lambda: [touching()(), touching(length_m=lengths_of(["a,b,270mm"])[0][2])()],
    ),
    ("ops/flags.py", "Write for instance --length"): (
        lambda: lengths_of(["left,right"]),
        lambda: lengths_of(["left,right,270mm", "ball,19mm,0.01mm"]),
    ),
    ("store/touch_table.py", "Give them with --points"): (
        lambda: read_touches(Path("apart.csv")),
        lambda: [read_arm_points(Path("apart.csv")), read_touches(Path("called.csv"))],
    ),
}
