"""Every way to run a robot, each on a clock that only its loop moves: what was sent in each cycle, and what came of it.

    python tests/robot_runs.py

writes the figures that test_robot_runs.py compares with. A motion of a robot changes only where that is meant.
"""

from __future__ import annotations

import queue
import sys
import tempfile
import threading
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.clock import Clock, ManualClock
from armsight.control.guard import Box, Limits
from armsight.control.setpoints import Hold
from armsight.drivers.jog_inputs import JogAxes
from armsight.errors import ArmsightError, NotEnoughData
from armsight.ops import motion, robots
from armsight.ops.action import action_of
from armsight.ops.robot.opening import ClockedRobot, arm_of, open_robot
from armsight.ops.servo.vision import ServoDevices, SteppedClock
from armsight.ops.simulation.run import simulate
from armsight.ops.simulation.scenarios import live_cell
from armsight.ops.teach import teach
from armsight.records import Motion, Silent, TaughtPath
from armsight.store import write_text
from armsight.store.limits_file import write_limits
from armsight.store.path_file import write_path
from armsight.store.recording import Recording
from armsight.store.tracks import write_joints

FIGURES = Path(__file__).parent / "golden" / "data" / "robot_runs"
STEP = 1e-9
"""rad, m, s: figures are kept as multiples of it."""
WEBCAM, ROBOT = "sim:webcam-cell", "webcam-cell"
CARRIED = "pachidis2005-static"
STATES = ("running", "holding", "retreating", "disabled", "stopped")
WORDS = {"end", "operator", "time", "", "hand-eye"}


@dataclass
class Run:
    """What came of a run: the error that ended it, its result as JSON has it, and what was asked, told and recorded."""

    recording: Path
    error: ArmsightError | None = None
    result: dict[str, Any] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)
    shown: list[Any] = field(default_factory=list)
    begun: int = 0

    def confirm(self, question: str) -> bool:
        self.asked.append(question)
        return True

    def of(self, call: Callable[[], Any]) -> Run:
        """Take what a call comes to."""
        try:
            self.result = call().to_dict()
        except ArmsightError as error:
            self.error = error
        return self


class Until(Silent):
    """Lets go at a time of the clock."""

    def __init__(self, clock: Clock, after_s: float) -> None:
        self._clock, self._after_s, self._begun_s = clock, after_s, clock.now_s()

    def cancelled(self) -> bool:
        return self._clock.now_s() - self._begun_s > self._after_s


class Steps:
    """Asked each cycle whether the enable is held: does what is set for that cycle, and lets go in some."""

    def __init__(self, acts: dict[int, Callable[[Any], object]], open_: range = range(0)) -> None:
        self.acts, self._open, self.cycle = acts, open_, 0
        self.source: Any = None

    def begun(self, source: Any) -> None:
        self.source = source

    def enabled(self) -> bool:
        self.cycle += 1
        self.acts.get(self.cycle, lambda _: None)(self.source)
        return self.cycle not in self._open


def acted(call: Callable[..., Any], **given: Any) -> Any:
    """Do an action (armsight.ops) as the command line does: files are named, and so are flags in errors."""
    return action_of(call).run(given)


def tool_path(file: Path, length_m: float = 0.01) -> Path:
    """Write a path before the tool of the webcam cell's robot as it stands, with a corner in it."""
    clock = ManualClock()
    with open_robot(WEBCAM, clock) as robot:
        clock.advance(0.04)
        arm = arm_of(robot, None)
        stand = RigidTransform.from_matrix(arm.fk(arm.values(robot.read().q)))
    places = ([0.0, 0.0, 0.005], [length_m, 0.0, 0.005], [length_m, length_m / 2, 0.005])
    turns = (0.0, 0.05, 0.05)
    rows = [
        (stand * RigidTransform.from_components(place, Rotation.from_rotvec([0.0, turn, 0.0]))).as_matrix()
        for place, turn in zip(places, turns, strict=True)
    ]
    tags = ("weld_on", "", "weld_off")
    write_path(file, TaughtPath(T_world_tip=np.array(rows), t_s=np.arange(3.0), speed_m_s=np.full(3, 0.04), tags=tags))
    return file


def play(out: Path, *, after_s: float = 60.0, steps: Steps | None = None, fault: str = "", **more: Any) -> Run:
    """Run a path of the webcam cell's robot."""
    clock, steps = ManualClock(), steps or Steps({})
    robot, run = open_robot(WEBCAM, clock), Run(out / "play.mcap")
    if fault:
        steps.acts[50] = lambda _: robot.fault(fault)
    return run.of(
        lambda: acted(
            motion.play,
            robot=ClockedRobot(robot=robot, clock=clock, called=WEBCAM),
            path=tool_path(out.parent / "path.csv"),
            out=out,
            confirm=run.confirm,
            progress=Until(clock, after_s),
            begun=steps.begun,
            enabled=steps.enabled,
            **{"approach_speed_m_s": 0.05, "retract_m": 0.004, "blend_m": 0.002, **more},
        )
    )


def steered() -> Steps:
    """Slow down, pause, go on, let go of the enable for a while, go faster."""
    return Steps(
        {
            40: lambda source: setattr(source, "override", 0.5),
            100: lambda source: source.pause(),
            150: lambda source: source.resume(),
            260: lambda source: setattr(source, "override", 1.0),
        },
        range(200, 230),
    )


def held() -> Steps:
    """Let the source ask for a hold, with why, for longer than a hold lasts that is given up."""
    return Steps({60: lambda source: setattr(source, "next", lambda _: Hold(why="odd"))})


def devices(name: str, **more: Any) -> ServoDevices:
    """Return a simulated cell whose clock moves with the loop."""
    clock = SteppedClock()
    made = live_cell(name, clock, room="dark", **more)
    return ServoDevices(
        robot=made.robot,
        pairs=made.pairs,
        clock=clock,
        overlaid=made.one_image,
        origin_s=lambda: float(made.origin_s),
        stepped=clock,
    )


def cell(out: Path, name: str) -> Path:
    """Return the files of a scenario."""
    simulate(name, out.parent / "cell", frames=1, room="dark")
    return out.parent / "cell"


def watched(out: Path) -> Run:
    """Run a path before cameras that see the nominal arm's tip elsewhere, until they stop it."""
    made, run, files = devices(ROBOT, fps=20.0), Run(out / "play.mcap"), cell(out, ROBOT)
    return run.of(
        lambda: acted(
            motion.play,
            robot=made,
            path=tool_path(out.parent / "path.csv"),
            out=out,
            confirm=run.confirm,
            show=lambda *args: run.shown.append(args),
            approach_speed_m_s=0.05,
            retract_m=0.004,
            stop_m=0.0003,
            **{name: files / f"{name}.yaml" for name in ("rig", "target", "handeye")},
        )
    )


def servo(
    out: Path, name: str, *, after_s: float = 60.0, taught: bool = False, turned: bool = False, **more: Any
) -> Run:
    """Follow a target; taught: and record the tip's path. turned: with cameras mounted upside down, as handeye.yaml."""
    led = {key: more.pop(key) for key in ("hand", "speed_m_s", "fps") if key in more}
    made, run, files = devices(name, **led), Run(out / "servo.mcap"), cell(out, name)
    if turned:
        handeye = yaml.safe_load((files / "handeye.yaml").read_text())
        quat = Rotation.from_quat(handeye["T_flange_camera"]["quat_xyzw"]) * Rotation.from_rotvec([0.0, 0.0, np.pi])
        handeye["T_flange_camera"]["quat_xyzw"] = quat.as_quat().tolist()
        (files / "handeye.yaml").write_text(yaml.safe_dump(handeye))
    named = {key: files / f"{key}.yaml" for key in ("rig", "target", "handeye")}
    progress, show = Until(made.clock, after_s), lambda *args: run.shown.append(args)
    asked = {"robot": made, **named, "out": out, "confirm": run.confirm, "show": show, "progress": progress, **more}
    if taught:
        return run.of(lambda: acted(teach, **asked, every=2, mean=True))
    return run.of(lambda: acted(motion.servo, **asked))


def joint_motion(out: Path, *, after_s: float = 60.0, steps: Steps | None = None, fault: str = "", **more: Any) -> Run:
    """Run a motion of the joints."""
    clock, steps, run = ManualClock(), steps or Steps({}), Run(out / "motion.mcap")
    robot = open_robot(WEBCAM, clock)
    if fault:
        steps.acts[50] = lambda _: robot.fault(fault)
    with robot:
        q = robot.read().q
    t = np.arange(200) / 100.0
    swing = 0.02 + 0.05 * np.outer(np.sin(np.pi * t / 2.0) ** 2, [1.0, -0.5, 0.4, 0.3, 0.2, 0.1])
    write_joints(out.parent / "motion.csv", Motion(t_s=t, q=q + swing))
    return run.of(
        lambda: acted(
            robots.run_motion,
            robot=ClockedRobot(robot=robot, clock=clock, called=WEBCAM),
            motion=out.parent / "motion.csv",
            out=out,
            confirm=run.confirm,
            progress=Until(clock, after_s),
            begun=steps.begun,
            enabled=steps.enabled,
            **more,
        )
    )


def jog(out: Path, *, after_s: float = 60.0, cut: bool = False, **more: Any) -> Run:
    """Move one joint; cut: by a controller that takes every step and goes nowhere."""
    clock, run = ManualClock(), Run(out / "jog.mcap")
    robot = open_robot(WEBCAM, clock)
    if cut:
        step = robot.step_joints
        kept: list[Any] = []

        def cut_to_nothing(values: NDArray[np.float64]) -> Any:
            kept.extend([] if kept else [step(0.0 * values)])
            return kept[0]

        robot.step_joints = cut_to_nothing  # type: ignore[method-assign]
    out.mkdir()
    asked = {"record": out / "jog.mcap", "progress": Until(clock, after_s), "joint": 2, "by": 0.1, **more}
    given = ClockedRobot(robot=robot, clock=clock, called=WEBCAM)
    return run.of(lambda: acted(robots.jog, robot=given, confirm=run.confirm, **asked))


class Led:
    """A hand that is looked at once a cycle, before the robot is read."""

    def __init__(self, looks: list[JogAxes]) -> None:
        self._looks = iter(looks)
        self._asked: queue.Queue[JogAxes | None] = queue.Queue()
        self._done: queue.Queue[None] = queue.Queue()
        self._held = False

    def help(self) -> str:
        return "Hold it."

    def wait(self, timeout_s: float) -> JogAxes | None:
        if self._held:
            self._done.put(None)
        self._held, look = True, self._asked.get()
        return look

    def cycle(self) -> None:
        """Have the next look taken, and wait until it was."""
        look = next(self._looks, None)
        if look is not None:
            self._asked.put(look)
            if look.ended:
                for thread in threading.enumerate():  # nobody waits for the hand any more: its thread ends
                    if thread.name == "jog input":
                        thread.join()
            else:
                self._done.get()


def led(out: Path, frame: str) -> Run:
    """Move by a hand that pushes, lets go, pushes elsewhere, and ends."""
    clock, run = ManualClock(), Run(out / "jog.mcap")
    robot = open_robot(WEBCAM, clock)
    n = 6
    push = [JogAxes(tuple(float(i == k) for i in range(n)), enabled=True) for k in (0, 4)]
    rest, end = JogAxes((0.0,) * n, enabled=False), JogAxes((0.0,) * n, enabled=False, ended=True)
    hand = Led([push[0]] * 60 + [rest] * 40 + [push[1]] * 40 + [end])
    step, begun = robot.step_joints, []

    def looked_at(values: NDArray[np.float64]) -> Any:
        if np.asarray(values).any() or begun:
            hand.cycle()
        return step(values)

    @contextmanager
    def inputs(name: str, axes: int) -> Iterator[Led]:
        yield hand

    def confirm(question: str) -> bool:
        begun.append(question)
        return run.confirm(question)

    robot.step_joints = looked_at  # type: ignore[method-assign]
    out.mkdir()
    given = ClockedRobot(robot=robot, clock=clock, called=WEBCAM)
    asked = {"hand": "keyboard", "frame": frame, "record": out / "jog.mcap", "inputs": inputs}
    return run.of(lambda: acted(robots.jog, robot=given, confirm=confirm, **asked))


def tight(out: Path) -> Path:
    """Return limits with a workspace that the tool leaves soon."""
    clock = ManualClock()
    with open_robot(WEBCAM, clock) as robot:
        arm = arm_of(robot, None)
        place = arm.fk(arm.values(robot.read().q))[:3, 3]
    write_limits(out.parent / "limits.yaml", Limits(workspace=Box(lower_m=place - 0.03, upper_m=place + 0.03)))
    return out.parent / "limits.yaml"


def tip(out: Path) -> Path:
    """Return a tip beside the flange."""
    write_text(out.parent / "tip.yaml", "format: armsight/tip\nversion: 1\ntip_m: [0.02, 0.0, 0.1]\n")
    return out.parent / "tip.yaml"


CIRCLE = {"hand": "circle", "speed_m_s": 0.03, "fps": 1.0 / 0.07}
CASES: dict[str, Callable[[Path], Run]] = {
    "play": play,
    "play steered": lambda out: play(out, steps=steered()),
    "play of a tip that weaves": lambda out: play(out, tip=tip(out), weave="sine:0.002:0.008", speed=0.5),
    "play let go of": lambda out: play(out, after_s=0.4),
    "play held on": lambda out: play(out, steps=held()),
    "play of a link lost": lambda out: play(out, fault="link_lost"),
    "play out of reach": lambda out: play(out, limits=tight(out), retract_m=0.1),
    "play watched": watched,
    "servo carried": lambda out: servo(out, CARRIED, seconds_s=1.0, **CIRCLE),
    "servo let go of": lambda out: servo(out, CARRIED, after_s=2.0, rotation="keep", predict=False, **CIRCLE),
    "servo beside": lambda out: servo(out, ROBOT, at="tool", seconds_s=0.5, hand="circle", rotation="hold", gain=1.0),
    "servo of wrong cameras": lambda out: servo(out, CARRIED, seconds_s=6.0, hand="still", turned=True),
    "servo taught": lambda out: servo(out, CARRIED, seconds_s=1.0, taught=True, **CIRCLE),
    "run": joint_motion,
    "run steered": lambda out: joint_motion(out, steps=steered(), speed=0.6),
    "run let go of": lambda out: joint_motion(out, after_s=1.0),
    "run held on": lambda out: joint_motion(out, steps=held()),
    "run of a frozen link": lambda out: joint_motion(out, fault="frozen"),
    "jog": jog,
    "jog back at full speed": lambda out: jog(out, joint=6, by=-0.3, speed=1.0),
    "jog let go of": lambda out: jog(out, after_s=0.3),
    "jog out of the workspace": lambda out: jog(out, by=0.5, limits=tight(out)),
    "jog that goes nowhere": lambda out: jog(out, cut=True, joint=6),
    "led joints": lambda out: led(out, "joints"),
    "led tool": lambda out: led(out, "tool"),
}


def figures(run: Run) -> dict[str, NDArray[np.int64]]:
    """Return what a run came to in multiples of STEP, and in numbers of states: set points, commands, events, result.

    Texts are none of it, but whether they are there.
    """
    found: dict[str, NDArray[np.int64]] = {}
    rows: dict[str, list[list[float]]] = {"wanted": [], "sent": [], "events": [], "readings": [], "poses": []}
    if run.recording.exists():
        _read(run.recording, rows)
    rows["result"] = [[value] for _, value in sorted(_leaves(run.result))]
    rows["told"] = [[len(run.asked), len(run.shown), zlib.crc32(type(run.error).__name__.encode())]]
    for name, values in rows.items():
        table = np.array(values, dtype=float)
        whole = np.round(np.nan_to_num(table, nan=-4.0, posinf=4.0) / STEP).astype(np.int64)
        found[name] = np.diff(whole, axis=0, prepend=0 * whole[:1]) if len(whole) else whole
    return found


def _read(file: Path, rows: dict[str, list[list[float]]]) -> None:
    with Recording(file) as recording:
        for command in recording.commands():
            values = dict(command.values)
            if command.kind == "set_point":
                wanted = [*_numbers(values), *([np.nan] * 7)][:7]
                rows["wanted"].append([command.t_s, float("hold" in values), *wanted])
            else:
                state = STATES.index(values["state"])
                rows["sent"].append([command.t_s, state, len(values["limited"]), *values["q"]])
        rows["events"] = [[e.t_s, e.level, zlib.crc32(e.name.encode())] for e in recording.events()]
        rows["readings"] = [[reading.t_s, *reading.q] for reading in recording.joints()]
        with suppress(NotEnoughData):  # no cameras took part
            rows["poses"] = [[pose.t_s, *_place(pose)] for pose in recording.poses()]


def _numbers(values: dict[str, Any]) -> list[float]:
    return [number for value in values.values() if isinstance(value, list) for number in value]


def _place(pose: Any) -> list[float]:
    return [np.nan] * 3 if pose.T_parent_target is None else np.asarray(pose.T_parent_target)[:3, 3].tolist()


TIMED = {"vision_ms"}
"""What real time enters."""


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """Yield every number of a result with its name; of a text whether it is one of WORDS, and how it stands there."""
    if isinstance(value, dict):
        for key, part in value.items():
            if key not in TIMED:
                yield from _leaves(part, f"{name}.{key}")
    elif isinstance(value, (list, tuple)):
        yield f"{name}.n", float(len(value))
        for k, part in enumerate(value):
            yield from _leaves(part, f"{name}.{k:03d}")
    elif isinstance(value, str):
        yield name, 0.0 if value not in {*WORDS, *STATES} else float(zlib.crc32(value.encode()) % 1000) + 1.0
    elif value is None:
        yield name, -1.0
    else:
        yield name, float(value)


def kept(name: str) -> Path:
    """Return the file of a case's figures."""
    return FIGURES / f"{name.replace(' ', '-')}.npz"


def made(name: str, folder: Path) -> Run:
    """Run a case in a folder of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    return CASES[name](folder / "out")


def write(*names: str) -> None:
    """Write the figures of some cases, or of all."""
    FIGURES.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for name in names or CASES:
            np.savez_compressed(kept(name), **figures(made(name, Path(folder) / name)))  # type: ignore[arg-type]


if __name__ == "__main__":
    write(*sys.argv[1:])
