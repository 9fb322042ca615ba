"""Unknown arms, identified from a beacon's positions while one joint after the other moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from armsight.defaults import SWEEP_READINGS, SWEEP_SPEED
from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag
from armsight.ops.action import Input, action
from armsight.ops.flags import A_SRC, KNOWN_ARM, SRC, Cameras, Table
from armsight.ops.kinds import FRAMES, LIGHTS, READERS, ROBOT_READERS, AnyRigLike, ArmLike, CamerasLike
from armsight.ops.requests.motion import FollowedCell, RobotSettings, RsiConfig

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from armsight.calibrate.identify import Identification
    from armsight.calibrate.identify.result import PlanOutput, ProposedPlanOutput
    from armsight.records import Progress

__all__ = ["identify_arm", "identify_arm_live"]

LEFT, RIGHT = Doc(f"Left frames: {SRC}."), Doc("Right frames, in step with the left ones.")
Confirm: TypeAlias = bool | Callable[[str], bool]
Rig: TypeAlias = Annotated[AnyRigLike, Doc("rig.yaml: fit pixels instead of positions.")]
Beacon: TypeAlias = Annotated[Any, Doc("Instead of a sweep: target.yaml of the beacon, with frames."), LIGHTS]
Place: TypeAlias = Annotated[
    Any,
    Doc("world.yaml: where the rig stands to the arm's base."),
    Input(f"{READERS}:world", hashed=True),
    Flag("--world"),
]
Method: TypeAlias = Annotated[
    Literal["ml", "paper"], Doc("ml (maximum likelihood) or paper (triples, Chauvenet, means)."), Flag(read=str)
]
Sigma: TypeAlias = Annotated[
    float | None,
    Doc("Noise: px of a pixel with --rig, else m of a place; else it is found."),
    Bounds(least=1e-9),
]
Mask: TypeAlias = Annotated[
    Any,
    Doc("With frames or --live: image that is black where no light may be looked for."),
    Input(f"{READERS}:picture"),
]
Nominal: TypeAlias = Annotated[ArmLike, Doc(f"{KNOWN_ARM} to put beside, in the report.")]
SweepReadings: TypeAlias = Annotated[int, Doc("With --live: readings of a sweep."), Bounds(least=4, most=1000)]
Out: TypeAlias = Annotated[Path | None, Doc("arm.yaml to write."), Flag("-o --out", needed=True)]


def joint_numbers(text: str) -> tuple[int, ...]:
    """Return the joints of '5,6'. Raises UsageError."""
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"--leave-out {text!r} names no joints", cure="Write their numbers: --leave-out 5,6") from None


@action(
    "identify",
    working="identifying",
    examples=(
        "--sweep sweep.csv -o identified.yaml",
        "--live sim:kapucu2005-rrp --left camera:sim:kapucu2005-rrp:left --right camera:sim:kapucu2005-rrp:right "
        "--rig rig.yaml --target target.yaml --limits=-0.5:5.2,-0.4:1.9,0.3:1.1 -o identified.yaml",
    ),
    filed=True,
    judged=True,
    writes="write_identified",
    page="arm_report:identify_report",
)
def identify_arm(
    joint: Annotated[
        Any,
        Doc("sweep.csv: joint,q1..qn and positions (x_m,y_m,z_m), pixels, or both."),
        Input(f"{ROBOT_READERS}:sweeps", hashed=True),
        Flag("--sweep"),
    ] = None,
    q: ArrayLike | None = None,
    xyz_m: ArrayLike | None = None,
    *,
    joints: Annotated[
        Any, Doc("sweep_joints.csv: frame,joint,q1..qn of those frames."), Input(f"{READERS}:table", hashed=True)
    ] = None,
    rig: Rig = None,
    uv_px: ArrayLike | None = None,
    target: Beacon = None,
    left: Annotated[Any, LEFT, FRAMES, A_SRC] = None,
    right: Annotated[Any, RIGHT, FRAMES, A_SRC] = None,
    cameras: CamerasLike = None,
    T_base_rig: Place = None,
    method: Method = "ml",
    increments: Annotated[
        Literal["known", "order"],
        Doc("known: commanded values are exact; order: only their order."),
        Flag(read=str),
    ] = "known",
    sigma: Sigma = None,
    mask: Mask = None,
    nominal: Nominal = None,
    name: str | None = None,
    table: Table | None = None,
    out: Out = None,
    progress: Progress | None = None,
) -> Identification:
    """Find an unknown arm's joints, axes and table from a beacon's positions while one joint after the other moves.

    Parameters
    ----------
    joint
        (m,) which joint moves in each row, counted from 1; or a table's path, which brings readings and positions.
    q
        (m, n) joint values in rad and m.
    xyz_m
        (m, 3) where the beacon was, in m, in any fixed frame.
    uv_px
        (m, v, 2) the beacon's positions in the images of the rig's two to eight cameras, [row, camera], NaN where one
        does not show it: the fit is then of pixels.
    target, left, right, cameras, joints
        Instead of rows: the beacon, frames as `measure` takes them, and columns frame (from 0), joint (which moves,
        from 1) and q1 .. qn.
    rig
        The cameras. One alone shows a light's path in no size.
    T_base_rig
        Where the rig, or xyz_m's frame, is to the base; the first frame is then the base's foot on the first axis.
    method
        ml (maximum likelihood) or paper (triples, Chauvenet, means; Kapucu and Baysec 2005).
    increments
        known: q is exact; order: only its order.
    sigma
        Noise of a pixel in px, or of a place in m; else it is found.
    mask
        True, or white, where a light may be looked for.
    nominal
        An arm to put beside the result.
    name
        Of the arm.
    out
        arm.yaml to write; its page, and the sweeps that frames showed, go beside it.

    Raises
    ------
    NotEnoughData
        Too few readings of a joint, or too short a sweep; the beacon is seen in none of the frames.
    Inconsistent
        Rows that do not belong together.

    Examples
    --------
    >>> arm = armsight.presets.puma761()
    >>> q = np.zeros((90, 6))
    >>> joint = np.repeat(np.arange(1, 7), 15)
    >>> for j in range(6):
    ...     q[joint == j + 1, j] = np.linspace(-0.7, 0.7, 15)
    >>> seen = (arm.fk(q) @ [0.05, 0.03, 0.1, 1.0])[:, :3] + np.random.default_rng(1).normal(0.0, 1e-4, (90, 3))
    >>> armsight.identify_arm(joint, q, seen).arm.n
    6
    """
    from dataclasses import replace

    from armsight.calibrate.identify import even_ones
    from armsight.ops.identification.solve import BeaconFrames, solve_sweeps
    from armsight.records import Silent
    from armsight.store.interpret import OURS

    sweeps, notes = joint, list[str]()
    if sweeps is None:
        if rig is None or target is None or (left is None and not cameras) or joints is None:
            raise UsageError(
                "nothing to identify from", cure="Give --sweep; or --rig, --target, --left, --right and --joints"
            )
        frames = BeaconFrames(
            target=target,
            left=left,
            right=right,
            cameras=cameras or {},
            joints=joints,
            mask=mask,
            table=table or OURS,
        )
        sweeps, notes = frames.sweeps(rig, progress or Silent())
        sweeps, uneven = even_ones(sweeps)
        notes += uneven
    elif mask is not None:
        raise UsageError("--mask is for frames, and a sweep has none", cure="Leave it out")
    found = solve_sweeps(
        sweeps,
        rig=rig,
        world=T_base_rig,
        nominal=nominal,
        name=name or ("identified" if out is None else out.stem),
        sigma=sigma,
        method=method,
        increments=increments,
        notes=notes,
    )
    return replace(found, from_frames=joint is None)


@action("identify", working="identifying")
def identify_arm_live(
    robot: Annotated[
        str,
        Doc("Move this robot: DRIVER:DEVICE, or sim:SCENARIO with its own cameras."),
        Flag("--live", metavar="ROBOT"),
    ],
    rig: Rig,
    target: Beacon,
    left: Annotated[str | None, LEFT, A_SRC],
    right: Annotated[str | None, RIGHT, A_SRC],
    limits: Annotated[
        Any,
        Doc("With --live: lo:hi,lo:hi ... in rad or m (or -90deg:90deg,0mm:500mm), or limits.yaml. Never left."),
        Input("armsight.ops.identification.left_out:joint_limits", kind=str),
        Flag(metavar="LIMITS"),
    ],
    *,
    cameras: CamerasLike = None,
    confirm: Confirm = False,
    show: Callable[[PlanOutput], None] | None = None,
    world: Place = None,
    model: Annotated[
        ArmLike, Doc("With --live: an arm roughly right, its tool the beacon; no probe."), Flag(metavar="ARM")
    ] = None,
    readings: SweepReadings = SWEEP_READINGS,
    speed: Annotated[
        float, Doc("With --live: share of a joint's travel a second."), Bounds(least=0.001, most=1.0)
    ] = SWEEP_SPEED,
    sigma: Sigma = None,
    method: Method = "ml",
    nominal: Nominal = None,
    propose: Annotated[bool, Doc("With --live: probe and tell the plan only; with --model do not move.")] = False,
    leave_out: Annotated[
        Sequence[int],
        Doc("With --live: the last joints, not swept but held where they are."),
        Flag("--leave-out", metavar="5,6", read=joint_numbers),
    ] = (),
    mask: Mask = None,
    camera_settings: Cameras | None = None,
    follow: FollowedCell = None,
    out: Out = None,
    robot_settings: RobotSettings = None,
    rsi_config: RsiConfig = None,
    progress: Progress | None = None,
) -> Identification | ProposedPlanOutput:
    """Move an unknown arm joint by joint before cameras, and return its geometry; or propose the sweeps only.

    Parameters
    ----------
    robot, left, right, cameras
        DRIVER:DEVICE and 'camera:NAME'; or sim:SCENARIO and camera:sim:SCENARIO:left. Of other cameras than left and
        right, two to eight, by their names in the rig.
    follow
        In place of cameras (None): a scenario whose simulated ones watch the joints that the robot tells.
    robot_settings, rsi_config
        As `servo` takes them.
    limits
        (n, 2) least and largest reading of each joint in rad or m, never left; or limits.yaml.
    confirm
        True, or a function of the motion in words.
    show
        A function that is given the plan before the sweeps.
    model, world
        An arm that is roughly right, its tool the beacon, and where the rig stands: then nothing is probed.
    readings, speed
        Of a sweep; share of a joint's travel a second.
    propose
        Return the plan only.
    leave_out
        The last joints, from 1, which are held where they are.
    out
        arm.yaml to write; its page and what was read go beside it.

    Raises
    ------
    Cancelled
        Not confirmed.
    DataRefused, DeviceFailed, UsageError
        The beacon is lost, or the robot or a camera fails; the robot is stopped.
    """
    from armsight.control.joint_sweep import Pace
    from armsight.drivers import AUTOMATIC
    from armsight.ops.identification.live import Known, LiveSweeps, OperatorCallbacks, identify_live
    from armsight.ops.requests.motion import RobotJob
    from armsight.ops.sources.cameras import named_cameras
    from armsight.records import require_count, require_kind

    if show is not None and not callable(show):
        raise UsageError(f"show is {show!r}", cure="Give a function of the plan")
    if robot_settings is not None:
        require_kind("robot_settings", robot_settings, Mapping)
    require_kind("leave_out", leave_out, list, tuple, cure="Give the numbers of joints, from 1")
    for number in leave_out:
        require_count("an entry of leave_out", number, least=1)
    order = LiveSweeps(
        limits=limits,
        left_out=tuple(leave_out),
        readings=readings,
        pace=Pace(speed=speed),
        sigma=sigma,
        method=method,
        propose=propose,
        out=out,
    )
    ask = confirm if callable(confirm) else lambda _: bool(confirm)
    person = OperatorCallbacks(confirm=ask) if show is None else OperatorCallbacks(confirm=ask, show=show)
    link = RobotJob(robot=robot, robot_settings=robot_settings, rsi_config=rsi_config, follow=follow)
    known = Known(rig=rig, world=world, model=model, nominal=nominal)
    sources = named_cameras(cameras or {}, left, right)
    return identify_live(order, known, target, link, sources, person, camera_settings or AUTOMATIC, mask, progress)
