"""Cures of what runs along: paths played, targets followed, taught and identified, arms supervised."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from cures_of_arms import HANDEYE, PAIRS, START
from cures_of_robots import SIM, jog
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.identify.plan import checked_limits
from armsight.clock import ManualClock
from armsight.control.guard import Limits
from armsight.control.play import PlaySettings, Weave, plan_path
from armsight.control.play.shape import shaped
from armsight.control.teach import PathRecorder, StandingRig
from armsight.drivers import CameraSettings
from armsight.drivers.jog_inputs import open_jog_input
from armsight.kinematics import preset
from armsight.ops import motion, robots
from armsight.ops.action import action_of
from armsight.ops.identification.left_out import read_limits
from armsight.ops.identification.live import Known, LiveSweeps
from armsight.ops.identification.live import _check as check_identify
from armsight.ops.identify import joint_numbers
from armsight.ops.play.play_job import check as check_play
from armsight.ops.play.play_job import check_speeds
from armsight.ops.requests.motion import RobotJob
from armsight.ops.robot.opening import ClockedRobot, arm_of, open_robot
from armsight.ops.robot.robot_run import check_arm
from armsight.ops.servo.cameras import CameraNames
from armsight.ops.servo.run_servo import require_axis, turning
from armsight.ops.servo.vision import ServoDevices, measuring, open_servo, placed_cameras
from armsight.ops.verification.live import check_arm as check_supervised_arm
from armsight.ops.verification.live import check_times, open_supervised
from armsight.ops.verification.mastering import drawn_about
from armsight.records import TaughtPath
from armsight.store import read_rig, read_target

H_YAML = Path("h.yaml")
FILES: dict[str, str] = {
    "motion.csv": "t_s,q1,q2,q3,q4,q5,q6\n"
    + "".join(f"{0.1 * k},{0.01 * k},-1.05,1.6,-0.5,1.7,0.1\n" for k in range(8))
}
UR = preset("ur10")
AT = np.array([0.0, -1.0, 1.5, -0.5, 1.5, 0.0])
STAND = UR.T_world_base.inv() * RigidTransform.from_matrix(UR.fk(AT))


def through(places, turns_rad=(), arm=UR, stand=STAND):
    """Return a path through places in the tool's axes as it stands, turned about its x axis."""
    turns = [*turns_rad, *[0.0] * (len(places) - len(turns_rad))]
    rows = [
        (stand * RigidTransform.from_components(place, Rotation.from_rotvec([turn, 0.0, 0.0]))).as_matrix()
        for place, turn in zip(places, turns, strict=True)
    ]
    return TaughtPath.of_poses(RigidTransform.from_matrix(np.array(rows)), parent="base")


CORNER = through([[0, 0, 0.01], [0.03, 0, 0.01], [0.03, 0.03, 0.01]])
ALONG_AXIS = through([[0, 0, 0.01], [0, 0, 0.04]])
TURNING = through([[0, 0, 0.01], [0, 0, 0.01], [0.03, 0, 0.01]], [0.0, 1.0, 1.0])
WEAVE = Weave.parse("sine:0.002:0.008")


def planned(path, arm=UR, at=AT, **more):
    settings = PlaySettings(**{"speed_m_s": 0.05, "approach_speed_m_s": 0.1, "retract_m": 0.01, **more})
    return lambda: plan_path(path, arm, Limits(), at, settings)


def supervised(play=False, **eyes):
    """Return a call that opens a robot and the cameras that watch it."""
    link, settings = RobotJob(robot="egm:6510"), {"play": play, "camera_settings": CameraSettings()}
    return lambda: open_supervised(link, read_rig("cell/rig.yaml"), eyes, target(), ManualClock(), UR, **settings)


def times(**more):
    """Return a call that checks the times of a supervision."""
    good = {"latency_s": 0.03, "latency_std_s": 0.01, "blind_stop_s": None, "joint_std": 0.0}
    return lambda: check_times(**{**good, **more})


def identified(**known):
    check_identify(LiveSweeps(limits=np.ones((6, 2))), Known(rig=None, **known))


def moved(*, yes=True, **more):
    """Return a call that runs a short motion."""

    def go():
        clock = ManualClock()
        robot = ClockedRobot(robot=open_robot(SIM, clock), clock=clock, called=SIM)
        asked = {"motion": Path("motion.csv"), "out": Path("moved"), "confirm": lambda _: yes, **more}
        return action_of(robots.run_motion).run({"robot": robot, **asked})

    return go


def pressed(name):
    def go():
        with open_jog_input(name, 6):
            pass

    return go


def around(span_rad):
    return lambda: drawn_about(preset("irb120"), "0.1,0.2,0.1,0.2,0.9,0.3", span_rad, None)


def recorder(every):
    return lambda: PathRecorder(StandingRig(T_world_rig=STAND), RigidTransform.identity(), every=every)


def lights(target, rig="cell/rig.yaml", *, overlaid=False):
    from armsight.ops.measurement.run import target_of

    devices = ServoDevices(robot=None, pairs=None, clock=None, overlaid=overlaid)
    return lambda: measuring(read_rig(Path(rig)), target_of(Path(target)), devices)


def eyes(**more):
    rig, lit = Path("rig.yaml"), Path("lit.yaml")
    return lambda: open_servo(RobotJob(robot="egm:6510"), read_rig(rig), read_target(lit), None, named(**more))


def named(left=None, right=None):
    return CameraNames.of(None, left, right, None, None)


def target():
    return read_target(Path("lit.yaml"))


def played(*, yes=True, wrap=lambda robot: robot, told=None):
    """Return a call that plays a path of 10 mm before the flange of the cell's robot."""

    def go():
        clock = ManualClock()
        robot = open_robot(SIM, clock)
        with robot:
            clock.advance(0.04)
            arm = arm_of(robot, None)
            stand = RigidTransform.from_matrix(arm.fk(arm.values(robot.read().q)))
        path = through([[0.0, 0.0, 0.005], [0.01, 0.0, 0.005]], stand=stand)
        clock = ManualClock()
        robot = ClockedRobot(robot=wrap(open_robot(SIM, clock)), clock=clock, called=SIM)
        speeds = {"approach_speed_m_s": 0.05, "path_speed_m_s": 0.05}
        more = {"arm": told, "retract_m": 0.004, "confirm": lambda _: yes}
        return action_of(motion.play).run({"robot": robot, "path": path, "out": Path("played"), **speeds, **more})

    return go


class Untold:
    """A robot that does not tell its arm's lengths."""

    def __init__(self, robot):
        self.robot = robot

    def __getattr__(self, name):
        if name == "arm_mapping":
            raise AttributeError(name)
        return getattr(self.robot, name)

    def __enter__(self):
        self.robot.__enter__()
        return self

    def __exit__(self, *error):
        return self.robot.__exit__(*error)


def telling(arm):
    """Return a robot whose controller tells its flange's pose, as an arm has it."""
    q = np.array([0.1, -1.0, 1.5, -0.5, 1.5, 0.0])
    pose = arm.T_world_base.inv() * RigidTransform.from_matrix(arm.fk(q)) * arm.T_flange_tool.inv()
    return SimpleNamespace(
        name="told", n_joints=arm.n, takes_joints=True, step_joints=lambda _: SimpleNamespace(q=q, pose=pose)
    )


def followed(*, yes=True, wrap=lambda robot: robot, arm=None):
    """Return a call that follows the cell's target for a moment."""

    def go():
        files = {name: Path(f"cell/{name}.yaml") for name in ("rig", "target", "handeye")}
        devices = open_servo(RobotJob(robot=SIM), read_rig(files["rig"]), read_target(files["target"]), None, named())
        robot = replace(devices, robot=wrap(devices.robot), called=SIM)
        asked = {"arm": arm, "at": "tool", "seconds_s": 0.1, "out": Path("followed"), "confirm": lambda _: yes}
        return action_of(motion.servo).run({"robot": robot, **files, **asked})

    return go


SPUN = through([[0.001 * k, 0, 0.01] for k in range(60)], [1.0 * k for k in range(60)])
FIVE = {"arm": replace(UR, joints=UR.joints[:5]), "at": AT[:5]}
TURNED = through([[0, 0, 0.01], [0.03, 0, 0.01]], [0.0, 0.5])
TILTED = through([[0.06 * k, 0.0, 0.0] for k in range(8)], [0.3 * k for k in range(8)])
TEACH = "teach --rig cell/rig.yaml --target cell/target.yaml -o taught"
VIEWS = "--left cell/left --right cell/right"
LIVE_EYES = {"left": "camera:0", "right": "camera:2"}
MASTERING = "verify --mastering --arm irb120 -o m"
IN_CELL = (
    "verify --mastering --arm cell/arm.yaml --rig cell/rig.yaml --target cell/target.yaml --world cell/world.yaml -o m"
)

TRIED = {
    ("ops/play/play_job.py", "Give {} (--frame)"): (
        lambda: check_play("tool", 0.01),
        lambda: [check_play(name, 0.01) for name in ("world", "base")],
    ),
    ("ops/play/play_job.py", "Give m: {} mm are"): (
        lambda: check_play("world", 10.0),
        lambda: check_play("world", 0.01),
    ),
    ("ops/play/play_job.py", "Give m/s: "): (
        lambda: check_speeds(PlaySettings(speed_m_s=50.0), Limits(), 1.0),
        lambda: check_speeds(PlaySettings(speed_m_s=0.05), Limits(), 1.0),
    ),
    ("control/play/shape.py", "Round them less (--blend"): (
        planned(CORNER, blend_m=0.04),
        planned(CORNER, blend_m=0.005),
    ),
    ("control/play/shape.py", "Tilt the tool (armsight path angle)"): (
        planned(ALONG_AXIS, weave=WEAVE),
        planned(ALONG_AXIS),
    ),
    ("control/play/shape.py", "Leave --weave out"): (planned(TURNING, weave=WEAVE), planned(TURNING)),
    ("control/play/plan.py", "Move the path or the arm's stand"): (
        planned(through([[0, 0, 0], [0, 0, 3]])),
        planned(CORNER),
    ),
    ("ops/robot/robot_run.py", "Give --yes to move"): (moved(yes=False), moved()),
    ("ops/robot/run_motion.py", "the limits that it is run with"): (
        moved(limits=Path("aside.yaml")),
        moved(limits=Path("wide.yaml")),
    ),
    ("drivers/jog_inputs.py", "Give keyboard, gamepad or"): (pressed("joystick"), pressed("gamepad:/dev/null")),
    ("drivers/jog_inputs.py", "Plug it in, look"): (pressed("gamepad:/dev/input/js99"), pressed("gamepad:/dev/null")),
    ("drivers/jog_inputs.py", "Run it in a terminal"): (pressed("keyboard"), jog(joint=1, by=0.02)),
    ("ops/robots.py", "Give --joint and --by"): (f"robot jog --robot {SIM} --yes --joint 1", jog(joint=1, by=0.02)),
    ("ops/servo/vision.py", "Make it with: armsight calibrate handeye"): (
        lambda: placed_cameras(Path("h.yaml")),
        (PAIRS, f"{HANDEYE} --pairs pairs.csv", lambda: placed_cameras(Path("h.yaml"))),
    ),
    ("ops/servo/run_servo.py", "Give --at tool"): (
        (PAIRS, f"{HANDEYE} --pairs pairs.csv", lambda: require_axis("camera", placed_cameras(H_YAML), H_YAML)),
        lambda: require_axis("tool", placed_cameras(H_YAML), H_YAML),
    ),
    ("ops/servo/run_servo.py", "(--rotation)"): (lambda: turning("x"), lambda: turning("align")),
    ("ops/servo/vision.py", "Give a target of lights"): (lights("board.yaml"), lights("cell/target.yaml")),
    ("ops/servo/vision.py", "Give --image"): (
        lights("lit.yaml", "mirrors.yaml"),
        lights("lit.yaml", "mirrors.yaml", overlaid=True),
    ),
    ("ops/servo/vision.py", "or --image for a mirror rig"): (eyes(), eyes(**LIVE_EYES)),
    ("ops/verification/live.py", "Give seconds, more than zero"): (times(blind_stop_s=0.0), times(blind_stop_s=0.5)),
    ("ops/verification/live.py", "Give degrees, zero or more"): (times(joint_std=-1.0), times(joint_std=0.0)),
    ("ops/verification/live.py", "Give seconds, zero or more"): (times(latency_s=-1.0), times(latency_s=0.0)),
    ("ops/verification/live.py", "Leave --play away"): (supervised(play=True, **LIVE_EYES), supervised(**LIVE_EYES)),
    ("ops/sources/cameras.py", "Give live cameras, such as"): (
        supervised(left=f"camera:{SIM}:left", right=f"camera:{SIM}:right"),
        supervised(**LIVE_EYES),
    ),
    ("ops/verification/mastering.py", "Give --around q1"): (MASTERING, "{} --around 0.1,0.2,0.1,0.2,0.9,0.3"),
    ("ops/verification/mastering.py", "Give degrees above 0"): (around(span_rad=0.0), around(span_rad=0.3)),
    ("ops/verification/mastering.py", "Give a pose before both cameras"): (
        f"{IN_CELL} --around=0,-1.57,0,0,0,0",
        f"{IN_CELL} --around={START}",
    ),
    ("ops/identification/left_out.py", "Write for instance --limits"): (
        lambda: read_limits("0..3"),
        lambda: read_limits("0:3.1,-1:1"),
    ),
    ("ops/identification/left_out.py", "Give radians, or a unit"): (
        lambda: read_limits("-28:298,0:90"),
        lambda: [read_limits("-28deg:298deg,0mm:500mm"), read_limits("-0.49:5.2,0:1.57")],
    ),
    ("ops/identification/live.py", "Give --world beside --model"): (
        lambda: identified(model=UR),
        lambda: identified(model=UR, world=object()),
    ),
    ("ops/identify.py", "Write their numbers"): (lambda: joint_numbers("x"), lambda: joint_numbers("5,6")),
    ("calibrate/identify/plan.py", "Write lo:hi for every joint"): (
        lambda: checked_limits([[0.0, 1.0]], [0.1, 0.2]),
        lambda: checked_limits([[0.0, 1.0], [0.0, 1.0]], [0.1, 0.2]),
    ),
    ("calibrate/identify/plan.py", "Bring the arm to a pose within"): (
        lambda: checked_limits([[0.0, 1.0]], [2.0]),
        lambda: [checked_limits([[0.0, 1.0]], [0.5]), checked_limits([[0.0, 3.0]], [2.0])],
    ),
    ("control/teach.py", "Give 1 or more (--every)"): (recorder(0), recorder(1)),
    ("ops/teaching.py", "Give them, or --from"): ("teach -o taught", "teach --from poses.csv -o taught"),
    ("ops/teaching.py", "Give --world world.yaml, made with"): (f"{TEACH} {VIEWS}", "{} --world cell/world.yaml"),
    ("ops/teaching.py", "--image for a mirror rig, or"): (
        f"{TEACH} --world cell/world.yaml",
        f"{TEACH} {VIEWS} --world cell/world.yaml && teach --from poses.csv -o other",
    ),
    ("ops/robot/robot_run.py", "Give the arm's file (--arm)"): (
        followed(wrap=Untold),
        followed(wrap=Untold, arm="cell/arm.yaml"),
    ),
    ("ops/robot/robot_run.py", "Give the file of this arm"): (
        lambda: check_arm(telling(UR), preset("ur5e")),
        lambda: check_arm(telling(UR), UR),
    ),
    ("ops/verification/live.py", "Give the file of this arm"): (
        lambda: check_supervised_arm(preset("iiwa14"), SimpleNamespace(robot=telling(UR))),
        lambda: check_supervised_arm(UR, SimpleNamespace(robot=telling(UR))),
    ),
    ("control/play/plan.py", "Run the positions alone"): (
        planned(TURNED, **FIVE),
        planned(TURNED, keep_rotation=True, **FIVE),
    ),
    ("control/play/plan.py", "or give a wider weave"): (
        planned(CORNER, weave=Weave.parse("zigzag:0.02:0.002")),
        planned(CORNER, weave=WEAVE),
    ),
    ("control/play/shape.py", "Round the corners less (--blend, in m)"): (
        lambda: shaped(SPUN, 0.3, Weave(), 0.01),
        lambda: shaped(SPUN, 0.01, Weave(), 0.01),
    ),
    ("control/play/plan.py", ", or keep the tool's rotation (--keep-rotation)"): (
        planned(TILTED),
        planned(TILTED, keep_rotation=True),
    ),
}
