"""From a checked scenario to the world, its robot and its cameras."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.clock import Clock
from armsight.errors import Inconsistent, UsageError
from armsight_sim.arms import Drive, FlangeLimits, Servo, SimArm, SimJoint
from armsight_sim.cell import SEED_PATH
from armsight_sim.motions import Drawn, HandJitter, JointMotion, Jumping, Swing, Turntable, Vibration, Waypoints
from armsight_sim.rigs import SIDES
from armsight_sim.robot import SimRobot
from armsight_sim.scenario_cameras import events_of, make_cameras, set_room, with_zoom, zero_jumps
from armsight_sim.scenario_keys import checked_room
from armsight_sim.scenario_motions import ArcKeys, EdgeKeys, RestKeys, SweepsKeys, SwingKeys, WayKeys
from armsight_sim.scenario_schema import Scenario, TargetKeys
from armsight_sim.scene import Light, Path, Rest
from armsight_sim.world import Carried, Timing, World

SEED_ARM, SEED_TREMOR, SEED_VIBRATION = 20, 21, 22

AHEAD_S = 0.5
"""How far past the last frame the motion is worked out: exposures, jitter and a rolling shutter reach beyond it."""

DWELL = 0.5
"""Share of a reading's time that a swept joint rests before it is read: five time constants of a lag of a tenth."""

TOLD = "every number is told in the scenario's file, with its source or why it was chosen"
"""All that is to be said of a world's assumptions."""

BGR = {"red": (0.05, 0.08, 1.0), "green": (0.08, 1.0, 0.10), "blue": (1.0, 0.10, 0.05)}
"""What a coloured light gives each channel: the filters of real sensors overlap by 5 to 10 %."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Robotics:
    """The scenario's arm: as its controller believes it, as it is, how it moves."""

    nominal: SimArm
    true: SimArm
    drive: Drive
    limits: FlangeLimits
    units: Array


def robotics(scenario: Scenario, seed: int) -> Robotics:
    """Return the arm of a scenario; its errors come from the seed. units (n,): of a file's joint value, rad or m."""
    keys = scenario.arm
    units = np.array([1.0 if joint.type == "prismatic" else np.pi / 180.0 for joint in keys.joints])
    joints = tuple(
        SimJoint(
            name=joint.name,
            prismatic=joint.type == "prismatic",
            a_m=joint.a_m,
            alpha_rad=np.deg2rad(joint.alpha_deg),
            d_m=joint.d_m,
            theta_rad=np.deg2rad(joint.theta_deg),
            lower=-np.inf if joint.lower is None else unit * joint.lower,
            upper=np.inf if joint.upper is None else unit * joint.upper,
            max_speed=joint.max_speed,
        )
        for joint, unit in zip(keys.joints, units, strict=True)
    )
    frame0 = keys.T_base_frame0.pose().as_matrix()
    nominal = SimArm(joints=joints, T_world_base=keys.T_world_base.pose(), T_base_frame0=frame0)
    rng = np.random.default_rng([seed, SEED_ARM])
    step = np.array([(1.0 if joint.prismatic else 2.0 * np.pi) / keys.steps for joint in joints])
    return Robotics(
        nominal=nominal,
        true=nominal.with_errors(rng, keys.error.length_m, np.deg2rad(keys.error.angle_deg)),
        drive=Drive(
            cycle_s=keys.cycle_s,
            lag_s=keys.lag_s,
            max_speed=np.array([joint.max_speed for joint in joints]),
            encoder_step=step,
        ),
        limits=FlangeLimits(
            speed_m_s=keys.max_speed_m_s or np.inf,
            speed_rad_s=np.deg2rad(keys.max_speed_deg_s) if keys.max_speed_deg_s else np.inf,
        ),
        units=units,
    )


def build_robot(scenario: Scenario, device: str, clock: Clock, *, home: Array | None = None) -> SimRobot:
    """Return the scenario's robot on a clock, standing at home (n,) in rad or m, or where its motion begins."""
    arm = robotics(scenario, scenario.seed)
    motion = scenario.motion
    first = motion.follow.home if not isinstance(motion, WayKeys | SweepsKeys | SwingKeys) else _first(scenario)
    robot = SimRobot(
        f"{scenario.name}{':' if device else ''}{device}",
        true=arm.true,
        nominal=arm.nominal,
        drive=arm.drive,
        home=arm.units * np.array(first) if home is None else home,
        clock=clock,
        limits=arm.limits,
    )
    robot.jump_zeros(zero_jumps(scenario, arm.units))
    return robot


def build_world(
    scenario: Scenario, *, seed: int | None = None, frames: int | None = None, room: Any = None, zoom: Any = None
) -> World:
    """Return a scenario's world; seed, frames, zoom and room (as the file's key takes it) are the file's if not given.

    Raises Inconsistent, naming the key, for a motion that the arm cannot make; UsageError for what is no room.
    """
    scenario, seed, frames = _as_asked(scenario, seed, frames, room, zoom)
    arm = robotics(scenario, seed)
    lights = _lights(scenario)
    cameras, rig = make_cameras(scenario.cameras, seed, ambient_level=_ambient(scenario))
    until_s = frames / scenario.fps + AHEAD_S
    T_mount_rig = scenario.cameras.T_mount_rig.pose()
    servo, T_flange_tool, rig_path, target = _moving(scenario, arm, T_mount_rig, seed, until_s)
    world = World(
        name=scenario.name,
        seed=seed,
        n_frames=frames,
        timing=_timing(scenario),
        views=("image",) if scenario.cameras.mirrors else tuple(scenario.cameras.lenses),
        cameras=cameras,
        lights=lights,
        moving=None,
        rig_path=rig_path,
        target_path=target,
        rig=rig,
        target=_target_mapping(scenario),
        nominal=arm.nominal,
        true=arm.true,
        T_flange_tool=T_flange_tool,
        servo=servo,
        vibration=_vibration(scenario, seed),
        T_base_rig=T_mount_rig if scenario.cameras.mount == "base" else None,
        T_flange_rig=T_mount_rig if scenario.cameras.mount == "flange" else None,
        radii_m=tuple(joint.radius_m for joint in scenario.arm.joints),
        events=events_of(scenario, ("occluded", "reflection")),
        frozen=events_of(scenario, ("frozen",)),
        dropped=events_of(scenario, ("dropped",)),
        cut_off=events_of(scenario, ("link_lost",)),
        sweeps=_sweep_rows(scenario, frames),
        zero_jumps=zero_jumps(scenario, arm.units),
        assumptions=(TOLD,),
    )
    return _in_room(_seen(world), scenario, until_s - AHEAD_S)


def _ambient(scenario: Scenario) -> float:
    """Return the grey levels of light that cameras get of no room."""
    return scenario.cameras.sensor.ambient_level if scenario.room.dark else 0.0


def _in_room(world: World, scenario: Scenario, until_s: float) -> World:
    """Return the world with the scenario's room behind what the cameras see until then."""
    paths = (world.rig_path, world.target_path)
    stands = scenario.cameras.mount == "base"
    cameras, moving = set_room(
        scenario.room, world.cameras, world.lights, paths, seed=world.seed, until_s=until_s, stands=stands
    )
    return replace(world, cameras=cameras, moving=moving)


def _as_asked(
    scenario: Scenario, seed: int | None, frames: int | None, room: Any, zoom: float | None
) -> tuple[Scenario, int, int]:
    """Return the scenario with room and zoom, the seed and the number of frames, each the file's if not given."""
    if room is not None:
        scenario = scenario.model_copy(update={"room": checked_room(room)})
    zoom = scenario.zoom if zoom is None else zoom
    if zoom is not None:
        scenario = scenario.model_copy(update={"cameras": with_zoom(scenario.cameras, zoom)})
    seed = scenario.seed if seed is None else seed
    frames = frames or scenario.frames
    if frames < 1 or seed < 0:
        raise UsageError(f"{frames} frames with the seed {seed} cannot be", cure="Ask for one or more, and a seed >= 0")
    return scenario, seed, frames


def _timing(scenario: Scenario) -> Timing:
    """Return when the cameras expose, and what becomes of their frames on the way."""
    keys = scenario.cameras
    return Timing(fps=scenario.fps, jitter_s=keys.jitter_s, latency_s=keys.latency_s, drop=keys.drop)


def _moving(
    scenario: Scenario, arm: Robotics, T_mount_rig: RigidTransform, seed: int, until_s: float
) -> tuple[Servo, RigidTransform, Path, Path]:
    """Return the arm's motion, what its tool is (T_flange_tool), and the paths of the rig and the target in world."""
    motion = scenario.motion
    vibration = _vibration(scenario, seed)
    if isinstance(motion, WayKeys | SweepsKeys | SwingKeys):
        servo = _commanded(scenario, arm, joint_motion(scenario, arm.units, seed), until_s)
        T_flange_tool = scenario.target.T_flange_target.pose() if scenario.target.T_flange_target else T_mount_rig
        target: Path = Carried(arm=arm.true, servo=servo, T_flange_thing=T_flange_tool, vibration=vibration)
        rig_path: Path = Rest(T_world_target=arm.true.T_world_base * T_mount_rig)
    else:
        target = _carried_target(motion, seed)
        servo = _following(scenario, arm, target, T_mount_rig, until_s)
        T_flange_tool = T_mount_rig
        rig_path = Carried(arm=arm.true, servo=servo, T_flange_thing=T_mount_rig, vibration=vibration)
    for event in scenario.events:
        if event.kind == "jump":
            end_s = event.at_s + event.for_s
            target = Jumping(path=target, by_m=np.array(event.by_m), start_s=event.at_s, end_s=end_s)
    return servo, T_flange_tool, rig_path, target


def _vibration(scenario: Scenario, seed: int) -> Vibration:
    """Return the flange's vibration, its frequencies a fifth apart at most."""
    keys, shake = scenario.arm.vibration, np.random.default_rng([seed, SEED_VIBRATION])
    return Vibration(
        amplitude_m=np.full(3, keys.amplitude_m),
        hz=keys.hz * shake.uniform(0.8, 1.2, 3),
        phase_rad=shake.uniform(0.0, 2.0 * np.pi, 3),
    )


def _first(scenario: Scenario) -> list[float]:
    motion = scenario.motion
    if isinstance(motion, WayKeys):
        return motion.q[0]
    if isinstance(motion, SwingKeys):
        return motion.home
    if isinstance(motion, SweepsKeys):
        return motion.sweeps[0].rest
    return motion.follow.home


def joint_motion(scenario: Scenario, units: Array, seed: int) -> JointMotion:
    """Return the motion of a scenario whose robot carries the target. Raises Inconsistent for any other."""
    motion = scenario.motion
    if isinstance(motion, SwingKeys):
        rng = np.random.default_rng([seed, SEED_PATH])
        return Swing(
            home=units * np.array(motion.home),
            amplitude=units * np.array(motion.amplitude),
            period_s=np.array(motion.period_s),
            phase_rad=rng.uniform(0.0, 2.0 * np.pi, len(units)),
        )
    if isinstance(motion, SweepsKeys):
        rows = []
        for sweep in motion.sweeps:
            for value in np.linspace(sweep.begin, sweep.end, sweep.readings):
                row = np.array(sweep.rest)
                row[sweep.joint - 1] = value
                rows.append(units * row)
        at_s = np.asarray(motion.every_s * np.arange(len(rows)), dtype=np.float64)
        arrive = at_s[1:] - DWELL * motion.every_s
        return Waypoints(q=np.array(rows), leave_s=at_s[:-1] + 0.1 * motion.every_s, arrive_s=arrive)
    if isinstance(motion, WayKeys):
        leave = np.asarray(motion.start_s + motion.lasts_s * np.arange(len(motion.q) - 1), dtype=np.float64)
        return Waypoints(q=units * np.array(motion.q), leave_s=leave, arrive_s=leave + motion.lasts_s)
    raise Inconsistent(f"motion.kind {motion.kind} moves no joints")


def _commanded(scenario: Scenario, arm: Robotics, motion: JointMotion, until_s: float) -> Servo:
    """Return the motion of an arm that is sent along a motion, one command a cycle; it begins at rest on the way."""
    cycle_s = arm.drive.cycle_s
    t_s = np.asarray(cycle_s * np.arange(int(until_s / cycle_s) + 2), dtype=np.float64)
    commands = motion(t_s)
    servo = Servo(arm.drive, commands[0])
    for moment, q in zip(t_s, commands, strict=True):
        servo.command(moment + _lateness(scenario, moment, cycle_s), q)
    servo.advance(until_s)
    return servo


def _following(scenario: Scenario, arm: Robotics, target: Path, T_flange_rig: RigidTransform, until_s: float) -> Servo:
    """Return the motion of an arm that keeps its rig before a target, by its nominal geometry."""
    motion = scenario.motion
    if isinstance(motion, WayKeys | SweepsKeys | SwingKeys):
        raise Inconsistent(f"motion.kind {motion.kind} follows nothing")
    follow, cycle_s = motion.follow, arm.drive.cycle_s
    t_s = np.asarray(cycle_s * np.arange(int(until_s / cycle_s) + 2), dtype=np.float64)
    T_rig_goal = RigidTransform.from_translation([0.0, 0.0, follow.distance_m])
    seen = target(np.maximum(t_s - follow.delay_s, 0.0))
    goals = (arm.nominal.T_world_base.inv() * seen * (T_flange_rig * T_rig_goal).inv()).as_matrix()
    try:
        q = arm.nominal.reach(goals[0], arm.units * np.array(follow.home))
        servo = Servo(arm.drive, q)
        longest = arm.drive.max_speed * cycle_s
        moved = np.append(True, np.abs(np.diff(goals, axis=0)).max(axis=(1, 2)) > 0.0)
        arrived = False
        for index, moment in enumerate(t_s):
            if arrived and not moved[index]:
                continue
            here = arm.nominal.frames(q)[-1]
            goal, _ = arm.limits.cut(here, goals[index], cycle_s)
            way = arm.nominal.reach(goal, q) - q
            q = q + way * min(1.0, float(np.min(longest / np.maximum(np.abs(way), 1e-300))))
            arrived = not np.abs(way).max() > 1e-12
            servo.command(moment + _lateness(scenario, moment, cycle_s), q)
    except Inconsistent as error:
        raise Inconsistent(
            f"motion: {error.cause}", consequence="The robot cannot follow the target", cure=error.cure
        ) from error
    servo.advance(until_s)
    return servo


def _lateness(scenario: Scenario, t_s: float, cycle_s: float) -> float:
    """Return by how much a command is late on command: one cycle."""
    late = any(e.kind == "late_cycle" and e.at_s <= t_s < e.at_s + e.for_s for e in scenario.events)
    return cycle_s if late else 0.0


def _carried_target(motion: RestKeys | ArcKeys | EdgeKeys, seed: int) -> Path:
    path: Path
    if isinstance(motion, RestKeys):
        path = Rest(T_world_target=motion.T_world_target.pose())
    elif isinstance(motion, ArcKeys):
        path = Turntable(
            T_world_base=motion.T_world_centre.pose(),
            T_base_target=RigidTransform.from_translation([motion.radius_m, 0.0, 0.0]) * motion.T_arm_target.pose(),
            from_rad=np.deg2rad(motion.from_deg),
            to_rad=np.deg2rad(motion.to_deg),
            start_s=motion.start_s,
            lasts_s=motion.lasts_s,
        )
    else:
        R = Rotation.from_euler("xyz", motion.turn_deg, degrees=True)
        path = Drawn(motion.corners_m, R, motion.speed_m_s, motion.smooth_s, motion.start_s)
    if motion.hand.rms_m or motion.hand.rms_deg:
        rng = np.random.default_rng([seed, SEED_TREMOR])
        path = HandJitter(path, motion.hand.rms_m, np.deg2rad(motion.hand.rms_deg), rng)
    return path


def _facing(keys: TargetKeys, name: str) -> tuple[float, float, float]:
    x, y, z = (0.0, 0.0, -1.0) if keys.facing is None else keys.facing[name]
    return x, y, z


def _lights(scenario: Scenario) -> tuple[Light, ...]:
    keys = scenario.target
    bgr = BGR[keys.colour] if keys.colour else (1.0, 1.0, 1.0)
    return tuple(
        Light(
            name=name,
            xyz_m=(x, y, z),
            level=keys.level,
            sigma_px=keys.sigma_px,
            diameter_m=keys.diameter_m,
            bgr=bgr,
            facing=(0.0, 0.0, 0.0) if keys.everywhere else _facing(keys, name),
            wide_deg=keys.wide_deg,
        )
        for name, (x, y, z) in keys.spots_m.items()
    )


def _target_mapping(scenario: Scenario) -> dict[str, Any]:
    keys = scenario.target
    target: dict[str, Any] = {"kind": "spots", "spots_m": {name: list(xyz) for name, xyz in keys.spots_m.items()}}
    if keys.diameter_m is not None:
        target["diameter_m"] = keys.diameter_m
    if keys.colour is not None:
        target["colour"] = keys.colour
    return target


def _sweep_rows(scenario: Scenario, frames: int) -> tuple[tuple[int, int], ...]:
    """Return (frame, joint) of each reading of a sweep."""
    if not isinstance(scenario.motion, SweepsKeys):
        return ()
    joints = [sweep.joint for sweep in scenario.motion.sweeps for _ in range(sweep.readings)]
    every = scenario.motion.every_s * scenario.fps
    return tuple((round(i * every), joint) for i, joint in enumerate(joints) if round(i * every) < frames)


def _seen(world: World) -> World:
    """Return the world; Inconsistent where no light of the target is in a view, or in any of many, at the beginning."""
    blind: list[str] = []
    for side, camera in world.cameras.items():
        uv = camera.centres_px(world.lights, world.path, 0.0)
        inside = ((uv >= 0.0) & (uv <= [camera.lens.width - 1, camera.lens.height - 1])).all(axis=1)
        blind += () if inside.any() else (side,)
        if not inside.any() and (len(world.cameras) <= len(SIDES) or len(blind) == len(world.cameras)):
            raise Inconsistent(
                f"cameras.T_mount_rig, target or motion: the {side} view sees no light at the beginning "
                f"(the first would be at {np.round(uv[0], 1).tolist()} px)",
                consequence="There is nothing to simulate",
                cure="Turn the rig to the target, or the target's z axis away from the rig",
            )
    return world
