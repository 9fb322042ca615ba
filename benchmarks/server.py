"""The robot server: punctuality of the loop under clients, a day of forced disconnects, and messages that lie.

python benchmarks/server.py loop [--seconds 60]     p99 of the loop's wake-up lateness, with 0 and with 10 clients
python benchmarks/server.py day [--hours 24] [--disconnects 1000]    loop time simulated; each ends in a hold
python benchmarks/server.py lies [--messages 2000]  wrong tokens, malformed, oversized, replayed: refused, logged
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import random
import tempfile
import time
from collections import Counter
from contextlib import ExitStack, suppress
from importlib.resources import files
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from armsight.control.session.loop_side import lateness_s
from armsight.control.session.service import Service
from armsight.drivers.remote import Link, ServerAddress
from armsight.drivers.remote import protocol as say
from armsight.errors import ArmsightError
from armsight.ops.robot.hosting import ProcessHost, RobotSpec, ThreadHost
from armsight.ops.robot.opening import arm_model
from armsight.ops.robot.recorder import RecordingLog
from armsight.server.serving import background
from armsight.server.web_server import ServeOptions
from armsight.store.arm_file import arm_from_mapping
from armsight.store.tokens import add_token
from armsight.testing.clocks import GatedClock
from armsight_sim.arms import Drive, FlangeLimits, SimArm, SimJoint
from armsight_sim.robot import SimRobot

CLIENTS = 10
CYCLE_S = 0.004
DAY_CYCLE_S = 0.028
WINDOW_S = 10.0
HOLD_CYCLES = 2
BEAT_S = 0.1


class CountingLog:
    """Counts what a recording would keep."""

    def __init__(self) -> None:
        self.warnings: Counter[str] = Counter()
        self.n_commands, self.dropped, self.failed = 0, 0, ""

    def event(self, t_s: float, level: str, message: str) -> None:
        if level == "warning":
            self.warnings[message.rpartition(": ")[2][:60] if "refused" in message else message[:60]] += 1

    def command(self, t_s: float, who: str, kind: str, values: dict) -> None:
        self.n_commands += 1

    def joints(self, reading: object) -> None:
        pass


def drive(url: str, over) -> None:
    """One driver who jogs with 50 velocities a second, and watchers, until over is set."""
    watchers = [Link(ServerAddress(url=url), say.STREAM_PATH) for _ in range(CLIENTS - 1)]
    driver = Link(ServerAddress(url=url), say.DRIVE_PATH)
    for link in [*watchers, driver]:
        link.open()
    n, count = driver.welcome.robot.n_joints, 0
    while not over.wait(0.02):
        with suppress(ArmsightError):
            driver.ask(say.Heartbeat, enable=True)
            driver.ask(say.JointVelocityMessage, qd=[0.05 * (-1) ** (count // 50)] * n)
        count += 1
        for link in watchers:
            link.ask(say.ReadMessage)
    for link in [*watchers, driver]:
        link.close()


def loop(seconds: float) -> None:
    text = (files("armsight_sim") / "scenarios" / "webcam-cell.yaml").read_text()
    line = next(line for line in text.splitlines() if line.strip().startswith("cycle_s:"))
    context = multiprocessing.get_context("spawn")
    counts = {0: 0, CLIENTS: 0}
    shares: list[tuple[float, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cell.yaml"
        path.write_text(text.replace(line, line[: line.index(":")] + f": {CYCLE_S}"))
        robot = f"sim:{path}"
        with (
            RecordingLog(Path(folder) / "log.mcap") as log,
            ProcessHost(RobotSpec(robot=robot, arm=arm_model(robot, None))) as host,
            background(Service(host, log)) as url,
        ):
            time.sleep(2.0)
            for _ in range(max(1, round(seconds / WINDOW_S))):
                pair = []
                for clients in (0, CLIENTS):
                    over = context.Event()
                    process = context.Process(target=drive, args=(url, over)) if clients else None
                    if process is not None:
                        process.start()
                        time.sleep(4.0)
                    before = host.lateness_counts()
                    time.sleep(WINDOW_S)
                    new = host.lateness_counts() - before
                    counts[clients] = counts[clients] + new
                    pair.append(lateness_s(new, 0.99))
                    if process is not None:
                        over.set()
                        process.join()
                shares.append((pair[0], pair[1]))
            now = host.status()
            dropped = log.dropped
    print(
        f"{os.cpu_count()} cores, cycle {CYCLE_S * 1e3:g} ms, load {os.getloadavg()[0]:.1f}; upper edges of 2.2 % bins"
    )
    for clients, found in counts.items():
        figures = ", ".join(f"{name} {lateness_s(found, share) * 1e6:.1f} us" for name, share in
                            (("median", 0.5), ("p99", 0.99), ("p99.9", 0.999), ("max", 1.0)))  # fmt: skip
        print(f"{clients:2d} clients: {int(found.sum())} cycles, lateness {figures}")
    none, ten = lateness_s(counts[0], 0.99), lateness_s(counts[CLIENTS], 0.99)
    print(f"p99 with {CLIENTS} clients / with none: {ten / none:.3f} (change {100 * (ten / none - 1):+.1f} %)")
    print("by window: " + ", ".join(f"{b / a:.2f}" for a, b in shares))
    print(f"late {now.late}, missed {now.missed} of {now.cycle} cycles; records dropped by the log: {dropped}")


def arm_and_robot(clock: GatedClock) -> tuple[SimRobot, object]:
    q, rows = np.pi / 2, ((0.04, -1, 0.44), (0.25, 0, 0), (0.12, 0, 0), (0.09, 1, 0), (0, -1, 0), (0, 0, 0.15))
    nominal = SimArm(
        joints=tuple(
            SimJoint(name=f"j{i}", a_m=a, alpha_rad=k * q, d_m=d, lower=-3.0, upper=3.0)
            for i, (a, k, d) in enumerate(rows, 1)
        )
    )
    robot = SimRobot(
        "sim",
        true=nominal.with_errors(np.random.default_rng(1), 5e-4, 1e-3),
        nominal=nominal,
        drive=Drive(cycle_s=DAY_CYCLE_S, lag_s=0.05, max_speed=np.full(6, 1.5), encoder_step=np.full(6, 1e-5)),
        home=[0.1, -1.2, 2.0, -0.8, -1.3, 0.4],
        clock=clock,
        limits=FlangeLimits(speed_m_s=0.2, speed_rad_s=2.0),
    )
    mapping = {"format": "armsight/arm", "version": 1, **nominal.mapping(RigidTransform.identity())}
    return robot, arm_from_mapping(mapping, "the arm")


def day(hours: float, disconnects: int, seed: int) -> None:
    rng, clock, log = random.Random(seed), GatedClock(0.0), CountingLog()
    robot, arm = arm_and_robot(clock)
    host = ThreadHost(robot, arm, clock, ended=clock.leave)
    host.begin()
    clock.advance(0.5)
    host.wait()
    service = Service(host, log)
    part_s = hours * 3600.0 / disconnects
    begun_s = time.monotonic()
    found: dict[str, Counter] = {}
    slowest: dict[str, tuple[int, float]] = {}
    with ExitStack() as stack:
        url = stack.enter_context(background(service))
        for _ in range(CLIENTS - 1):
            link = Link(ServerAddress(url=url), say.STREAM_PATH)
            link.open()
            stack.callback(link.close)
        for trial in range(disconnects):
            until_s = clock.now_s() + part_s
            how = ("reset", "close", "silent")[trial % 3]
            outcome, cycles, rest_s = disconnect(host, service, clock, url, how, rng)
            found.setdefault(how, Counter())[outcome] += 1
            most = slowest.get(how, (0, 0.0))
            slowest[how] = (max(most[0], cycles), max(most[1], rest_s))
            clock.advance(max(0.0, until_s - clock.now_s()))
            if (trial + 1) % 50 == 0:
                hours_done, took_s = clock.now_s() / 3600.0, time.monotonic() - begun_s
                print(f"{trial + 1} disconnects, {hours_done:.2f} h, {took_s:.0f} s: {found}", flush=True)
        now = host.status()
    host.end(lambda: clock.advance(0.1))
    took_s = time.monotonic() - begun_s
    print(f"{clock.now_s() / 3600:.2f} h of loop time, {now.cycle} cycles, {CLIENTS} clients, in {took_s:.0f} s")
    for how, outcomes in found.items():
        cycles, rest_s = slowest[how]
        print(f"{how}: {dict(outcomes)}; at most {cycles} cycles to the hold, {rest_s:.2f} s to rest")
    print("cycles count from when the server saw the disconnect; of the silent from the last heartbeat")
    print(f"{log.n_commands} commands logged; warnings: {dict(log.warnings)}")


def disconnect(host, service, clock, url, how, rng) -> tuple[str, int, float]:
    """Drive for a while, then disconnect; return what came of it, cycles until the hold, s until rest."""
    link = Link(ServerAddress(url=url), say.DRIVE_PATH)
    link.open()
    link.ask(say.Heartbeat, enable=True)
    here = np.array(host.status().q_sent)
    if rng.random() < 0.5:
        goal = np.clip(np.array([0.1, -1.2, 2.0, -0.8, -1.3, 0.4]) + [rng.uniform(-0.5, 0.5) for _ in range(6)], -3, 3)
        make, fields = say.JointGoalMessage, {"q": goal.tolist()}
    else:
        toward = np.sign(np.array([0.1, -1.2, 2.0, -0.8, -1.3, 0.4]) - here)
        make, fields = say.JointVelocityMessage, {"qd": (0.2 * toward * rng.random()).tolist()}
    left = rng.randint(4, 40)
    while left > 0:
        link.ask(say.Heartbeat, enable=True)
        link.ask(make, **fields)
        cycles = min(left, 3)
        clock.advance(cycles * DAY_CYCLE_S)
        left -= cycles
    ran = host.status().guard == "running"
    if how == "silent":
        cycles = settle(host, clock)
    else:
        (link.cut if how == "reset" else link.close)()
        deadline_s = time.monotonic() + 20.0
        while service.desk.driver is not None:
            if time.monotonic() > deadline_s:
                return "not noticed", 0, 0.0
            time.sleep(0.0005)
        cycles = settle(host, clock)
    rest_s = rest(host, clock)
    link.close()
    while service.desk.driver is not None:
        time.sleep(0.0005)
    if not ran:
        return "did not run", cycles, rest_s
    return (
        ("hold" if cycles <= HOLD_CYCLES + (10 if how == "silent" else 0) and rest_s < 2.0 else "NO HOLD"),
        cycles,
        rest_s,
    )


def settle(host, clock) -> int:
    """Return after how many cycles the guard no longer runs; 1000 where it does not stop."""
    for cycle in range(1, 1000):
        clock.advance(DAY_CYCLE_S)
        if host.status().guard != "running":
            return cycle
    return 1000


def rest(host, clock) -> float:
    """Return after how many s the robot is told nothing new any more, looked at for 0.5 s; inf where it moves on."""
    begun_s, before, still = clock.now_s(), host.status().q_sent, 0
    while clock.now_s() - begun_s < 10.0:
        clock.advance(DAY_CYCLE_S)
        now = host.status().q_sent
        still = still + 1 if np.array_equal(now, before) else 0
        before = now
        if still * DAY_CYCLE_S > 0.5:
            return clock.now_s() - begun_s - still * DAY_CYCLE_S
    return float("inf")


def lies(messages: int, seed: int) -> None:
    rng, log = random.Random(seed), CountingLog()
    clock = GatedClock(0.0)
    robot, arm = arm_and_robot(clock)
    host = ThreadHost(robot, arm, clock, ended=clock.leave)
    host.begin()
    clock.advance(0.5)
    host.wait()
    answers: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tokens.yaml"
        token = add_token(path, "anna", "drive")
        service = Service(host, log)
        service._affordable = lambda t_s: True  # type: ignore[method-assign]  # count each, though time stands still
        with background(service, ServeOptions(port=0, tokens=path)) as url:
            for _ in range(messages // 5):
                answers.update(connection_of_lies(url, token, rng))
            for number in range(messages // 10):
                try:
                    connect(
                        url + say.DRIVE_PATH, additional_headers={"Authorization": f"Bearer {number}"}, proxy=None
                    ).__enter__()
                    answers["let in without a token"] += 1
                except InvalidStatus as error:
                    answers[f"token refused with {error.response.status_code}"] += 1
    before = host.status().q_sent
    clock.advance(1.0)
    answers["robot moved"] += int(not np.array_equal(before, host.status().q_sent))
    host.end(lambda: clock.advance(0.1))
    print(f"answers: {dict(answers)}")
    print(f"logged: {sum(log.warnings.values())} warnings of {len(log.warnings)} kinds")


def connection_of_lies(url: str, token: str, rng: random.Random) -> list[str]:
    """Send up to five lies on one connection; return the answers."""
    answers = []
    headers = {"Authorization": f"Bearer {token}"}
    deadline_s = time.monotonic() + 10.0
    while True:
        socket = connect(url + say.DRIVE_PATH, additional_headers=headers, proxy=None, compression=None).__enter__()
        hello = json.loads(socket.recv())
        if hello["type"] == "welcome":
            break
        socket.close()
        if time.monotonic() > deadline_s:
            return ["no entry"]
        time.sleep(0.001)
    good = {"type": "heartbeat", "session": hello["session"], "seq": 1, "enable": False}
    lies_ = [lie(good, rng) for _ in range(5)]
    socket.send(json.dumps(good))
    try:
        for text in (None, *lies_):
            if text is not None:
                socket.send(text)
            while True:
                answer = json.loads(socket.recv(timeout=10.0))
                if "reply_to" in answer and (answer["type"] != "state" or answer["reply_to"] is not None):
                    break
            if text is not None:
                answers.append(answer["type"])
    except ConnectionClosed as error:
        answers.append(f"closed with {error.rcvd.code if error.rcvd else 'nothing'}")
    socket.close()
    return answers


def lie(good: dict, rng: random.Random) -> str | bytes:
    text = json.dumps(good | {"seq": 2})
    match rng.randrange(7):
        case 0:
            return json.dumps(good)  # replayed
        case 1:
            return json.dumps(good | {"seq": 2, "session": f"{rng.getrandbits(128):032x}"})
        case 2:
            return text[: rng.randrange(len(text))]
        case 3:
            return " " * (say.MAX_BYTES + 1)
        case 4:
            return rng.randbytes(rng.randrange(1, 200))
        case 5:
            return json.dumps(
                {"type": "joint_goal", "session": good["session"], "seq": 2, "q": [rng.choice([1e400, "1", None])] * 6}
            )
        case _:
            return json.dumps(good | {"seq": 2, "also": rng.random()})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("loop", "day", "lies"))
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--disconnects", type=int, default=1000)
    parser.add_argument("--messages", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    if args.what == "loop":
        loop(args.seconds)
    elif args.what == "day":
        day(args.hours, args.disconnects, args.seed)
    else:
        lies(args.messages, args.seed)


if __name__ == "__main__":
    main()
