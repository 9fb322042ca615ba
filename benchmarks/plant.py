"""OPC UA, MQTT and Foxglove beside a robot's loop and beside the measuring.

python benchmarks/plant.py clients [--minutes 10]   10 clients of each kind; the server is killed and started again
python benchmarks/plant.py loop [--minutes 2]       lateness of a 4 ms loop without publishers, with clients, flooded
python benchmarks/plant.py measuring [--frames 200] what a decision of verify --live takes, without and with a flood
python benchmarks/plant.py refused                  wrong certificates, tokens and passwords: refused, logged
"""

from __future__ import annotations

import argparse
import asyncio
import json
import logging
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion

from armsight.ops.requests.plant import PlantFlags

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # mosquitto.py

from armsight.control.session.loop_side import lateness_s
from armsight.control.session.service import Service
from armsight.ops.robot.hosting import ProcessHost, RobotSpec
from armsight.ops.robot.opening import arm_model
from armsight.ops.robot.recorder import RecordingLog
from armsight.records import JointReading, PoseStatus, TargetPose
from armsight.store.recording import Recording
from armsight.store.tokens import add_token
from armsight.verify.supervision import Compared, Level, Limits, Seen
from armsight_plant.certificates import make_pair
from armsight_plant.opcua.publisher import NAMESPACE
from armsight_plant.options import PlantOptions
from armsight_plant.process import PlantProcess
from armsight_plant.publishing import FEED_S, Feed
from armsight_plant.state import PlantState, RobotSeen
from mosquitto import PASSWORD, USER, Broker, missing

CLIENTS = 10
CYCLE_S = 0.004
WINDOW_S = 10.0
SCENARIO = "webcam-cell"
WATCHED = ("robot.joints", "robot.state", "verdict.in_tolerance", "alarms.stopped.active")
os.environ["ARMSIGHT_MQTT_PASSWORD"] = PASSWORD
ARMSIGHT = (sys.executable, "-m", "armsight")


class Site:
    """Certificates, tokens, a broker, and the flags that name them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.pairs = {who: make_pair(folder / who, f"{who}.example") for who in ("server", "client", "stranger")}
        trusted = folder / "trusted"
        trusted.mkdir()
        (trusted / "client.pem").write_bytes(self.pairs["client"][0].read_bytes())
        self.tokens = folder / "tokens.yaml"
        self.token = add_token(self.tokens, "plc", "acknowledge")
        self.broker = Broker(folder)
        with socket.create_server(("127.0.0.1", 0)) as found:
            self.port = found.getsockname()[1]
        self.url = f"opc.tcp://127.0.0.1:{self.port}"
        certificate, key = self.pairs["server"]
        self.flags = PlantFlags(
            opcua=self.url,
            opcua_certificate=certificate,
            opcua_key=key,
            opcua_trusted=trusted,
            opcua_users=self.tokens,
            mqtt=f"{self.broker.url}/bench",
            mqtt_ca=self.broker.ca,
            mqtt_user=USER,
            foxglove="0",
        )

    @property
    def written(self) -> list[str]:
        """The flags as they are typed."""
        given = ((name, getattr(self.flags, name)) for name in PlantFlags.__dataclass_fields__)
        return [
            part
            for name, value in given
            if value
            for part in (f"--{name.removesuffix('_s').replace('_', '-')}", str(value))
        ]

    @property
    def keys(self) -> tuple[str, tuple[Path, Path], str]:
        """What a client needs: address, certificate and key, token."""
        return self.url, self.pairs["client"], self.token


def opcua_client(keys: tuple[str, tuple[Path, Path], str]) -> Client:
    url, _, token = keys
    client = Client(url, timeout=20)
    client.application_uri, client.session_timeout = "urn:client.example:armsight", 60_000
    client.set_user("plc")
    client.set_password(token)
    return client


class Heard:
    """What a client saw: ages of values as they came, changes of quality, and when it was good and not."""

    def __init__(self) -> None:
        self.ages_s: list[float] = []
        self.changes: list[tuple[float, str]] = []

    def value(self, quality: str, source_unix_s: float | None) -> None:
        now_s = time.time()
        if not self.changes or self.changes[-1][1] != quality:
            self.changes.append((now_s, quality))
        if quality == "good" and source_unix_s is not None:
            self.ages_s.append(now_s - source_unix_s)

    def datachange_notification(self, node: object, value: object, data: object) -> None:
        told = data.monitored_item.Value
        stamp = told.SourceTimestamp
        self.value("good" if told.StatusCode.is_good() else "stale", None if stamp is None else stamp.timestamp())


async def watch_opcua(keys: tuple[str, tuple[Path, Path], str], heard: Heard, over: object) -> None:
    """Subscribe to the joints, and come again where the server is gone."""
    while not over.is_set():
        try:
            client = opcua_client(keys)
            await client.set_security(
                SecurityPolicyBasic256Sha256, *map(str, keys[1]), mode=ua.MessageSecurityMode.SignAndEncrypt
            )
            async with client:
                index = await client.get_namespace_index(NAMESPACE)
                subscription = await client.create_subscription(50, heard)
                asked = ua.MonitoringParameters()
                asked.QueueSize, asked.SamplingInterval, asked.ClientHandle = 1, 0, 1
                asked.Filter = ua.DataChangeFilter(Trigger=ua.DataChangeTrigger.StatusValueTimestamp)
                node = client.get_node(ua.NodeId(WATCHED[0], index))
                item = ua.MonitoredItemCreateRequest(
                    ItemToMonitor=ua.ReadValueId(NodeId=node.nodeid, AttributeId=ua.AttributeIds.Value),
                    MonitoringMode=ua.MonitoringMode.Reporting,
                    RequestedParameters=asked,
                )
                await subscription.create_monitored_items([item])
                while not over.is_set():
                    await asyncio.sleep(0.2)
                    await client.get_node(ua.NodeId(WATCHED[1], index)).read_value()  # as a PLC that polls
        except Exception:
            heard.value("stale", None)
            await asyncio.sleep(0.5)


def watch_mqtt(site: dict[str, object], heard: Heard) -> paho.Client:
    def on_message(client: object, data: object, message: object) -> None:
        said = json.loads(message.payload)
        good = said["online"] and not said["stale"] and said["robot"]["quality"] == "good"
        stamp = None
        if good:
            stamp = time.mktime(time.strptime(said["robot"]["time"][:19], "%Y-%m-%dT%H:%M:%S")) - time.timezone
            stamp += float(said["robot"]["time"][19:-1])
        heard.value("good" if good else "stale", stamp)

    client = paho.Client(CallbackAPIVersion.VERSION2)
    client.username_pw_set(USER, PASSWORD)
    client.tls_set(str(site["ca"]))
    client.on_message = on_message
    client.on_connect = lambda mine, *_: mine.subscribe("bench/state")
    client.connect("127.0.0.1", site["port"])
    client.loop_start()
    return client


def clients(site: dict[str, object], over: object, results: object) -> None:
    """Run ten clients of OPC UA and ten of MQTT until over is set."""
    logging.disable(logging.CRITICAL)
    of_opcua, of_mqtt = ([Heard() for _ in range(CLIENTS)] for _ in range(2))
    listeners = [watch_mqtt(site, one) for one in of_mqtt]

    async def run() -> None:
        await asyncio.gather(*(watch_opcua(site["keys"], one, over) for one in of_opcua))

    asyncio.run(run())
    for one in listeners:
        one.disconnect()
        one.loop_stop()
    results.put({kind: [(one.ages_s, one.changes) for one in all_] for kind, all_ in
                 (("OPC UA", of_opcua), ("MQTT", of_mqtt))})  # fmt: skip


def flood(site: dict[str, object], over: object) -> None:
    """Read as fast as answers come, four requests at a time, until over is set."""
    logging.disable(logging.CRITICAL)

    async def run() -> None:
        while not over.is_set():
            with suppress(Exception):  # a server that is flooded may turn its clients out
                await read_on()

    async def read_on() -> None:
        client = opcua_client(site["keys"])
        await client.set_security(
            SecurityPolicyBasic256Sha256, *map(str, site["keys"][1]), mode=ua.MessageSecurityMode.SignAndEncrypt
        )
        async with client:
            index = await client.get_namespace_index(NAMESPACE)
            nodes = [client.get_node(ua.NodeId(name, index)) for name in WATCHED] * 20
            while not over.is_set():
                await asyncio.gather(*(client.read_attributes(nodes) for _ in range(4)))

    asyncio.run(run())


def told(site: Site) -> dict[str, object]:
    return {"keys": site.keys, "ca": site.broker.ca, "port": site.broker.port}


def started(target: object, *args: object) -> tuple[object, object]:
    context = multiprocessing.get_context("spawn")
    over = context.Event()
    process = context.Process(target=target, args=(*args[:1], over, *args[1:]))
    process.start()
    return process, over


def serve(site: Site, name: str) -> subprocess.Popen[bytes]:
    command = [*ARMSIGHT, "serve", "--robot", f"sim:{SCENARIO}", "--port", "0", "--log", str(site.folder / name)]
    process = subprocess.Popen([*command, *site.written], stderr=subprocess.PIPE)
    said = []
    for line in process.stderr:
        said.append(line.decode())
        if b"is served at" in line:
            return process
    raise SystemExit(f"the server did not begin: {''.join(said)}")


def figures(values: list[float]) -> str:
    found = np.array(values) * 1e3
    median, p99 = np.median(found), np.percentile(found, 99)
    return f"{len(found)} values, median {median:.0f}, 99 % {p99:.0f}, most {found.max():.0f} ms"


def with_clients(minutes: float) -> None:
    context = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        site = Site(Path(name))
        stack.enter_context(site.broker)
        server = serve(site, "one.mcap")
        results = context.Queue()
        process, over = started(clients, told(site), results)
        time.sleep(30.0 * minutes)
        killed_s = time.time()
        os.kill(server.pid, signal.SIGKILL)
        server.wait()
        time.sleep(10.0)
        begun_s = time.time()
        server = serve(site, "two.mcap")
        ready_s = time.time()
        time.sleep(30.0 * minutes)
        over.set()
        found = results.get(timeout=120)
        process.join()
        server.send_signal(signal.SIGINT)
        server.wait()
    print(f"load {os.getloadavg()[0]:.1f}; the server was killed; a start takes {ready_s - begun_s:.0f} s")
    for kind, all_ in found.items():
        ages = [age for one, _ in all_ for age in one]
        stale = [min((t_s for t_s, how in changes if how == "stale" and t_s >= killed_s), default=np.nan) - killed_s
                 for _, changes in all_]  # fmt: skip
        good = [min((t_s for t_s, how in changes if how == "good" and t_s >= begun_s), default=np.nan) - begun_s
                for _, changes in all_]  # fmt: skip
        lost = sum(
            how == "stale" and not killed_s <= t_s <= ready_s + 20 for _, changes in all_ for t_s, how in changes[1:]
        )
        print(f"{kind}: source to client {figures(ages)}")
        print(f"  stale {np.max(stale):.1f} s after the kill, good {np.max(good):.1f} s after its new start: the last")
        print(f"  of {len(all_)} clients; stale at other times: {lost}")


def loop(minutes: float) -> None:
    text = (files("armsight_sim") / "scenarios" / f"{SCENARIO}.yaml").read_text()
    line = next(line for line in text.splitlines() if line.strip().startswith("cycle_s:"))
    context = multiprocessing.get_context("spawn")
    ways = ("nothing published", "published, no client", f"{CLIENTS} clients of each", "... and one that floods")
    counts: dict[str, object] = dict.fromkeys(ways, 0)
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        site = Site(folder)
        stack.enter_context(site.broker)
        path = folder / "cell.yaml"
        path.write_text(text.replace(line, line[: line.index(":")] + f": {CYCLE_S}"))
        robot = f"sim:{path}"
        log = stack.enter_context(RecordingLog(folder / "log.mcap"))
        host = stack.enter_context(ProcessHost(RobotSpec(robot=robot, arm=arm_model(robot, None))))
        service = Service(host, log)
        publishing = site.flags.made(lambda _: None)
        time.sleep(2.0)
        for _ in range(max(1, round(60.0 * minutes / WINDOW_S / len(ways)))):
            for way in ways:
                with ExitStack() as during:
                    if way != ways[0]:
                        during.enter_context(publishing.served(service, lambda _: None))
                    begun = []
                    results = context.Queue()
                    if way in ways[2:]:
                        begun.append(started(clients, told(site), results))
                    if way == ways[3]:
                        begun.append(started(flood, told(site)))
                    time.sleep(12.0 if begun else 2.0)
                    service.pump()
                    before = host.lateness_counts()
                    time.sleep(WINDOW_S)
                    counts[way] = counts[way] + (host.lateness_counts() - before)
                    for _, over in begun:
                        over.set()
                    if begun:
                        results.get(timeout=120)
                    for process, _ in begun:
                        process.join()
    print(
        f"{os.cpu_count()} cores, cycle {CYCLE_S * 1e3:g} ms, load {os.getloadavg()[0]:.1f}; upper edges of 2.2 % bins"
    )
    for way, found in counts.items():
        shown = ", ".join(f"{what} {lateness_s(found, share) * 1e6:.1f}" for what, share in
                          (("median", 0.5), ("p99", 0.99), ("p99.9", 0.999), ("max", 1.0)))  # fmt: skip
        print(f"{way}: {int(found.sum())} cycles, lateness {shown} us")


def measuring(frames: int) -> None:
    with tempfile.TemporaryDirectory() as name:
        site, cell = Site(Path(name)), Path(name) / "cell"
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "check": True}
        subprocess.run([*ARMSIGHT, "simulate", SCENARIO, "--frames", "1", "--room", "dark", "-o", str(cell)], **quiet)
        views = (f"camera:sim:{SCENARIO}:{side}" for side in ("left", "right"))
        command = [*ARMSIGHT, "verify", "--live", "--robot", f"sim:{SCENARIO}", "--play", "--warn-mm", "5", "--json"]
        command += ["--left", next(views), "--right", next(views), "--frames", str(frames)]
        for flag, file in (("rig", "rig"), ("target", "target"), ("arm", "arm_true"), ("world", "world")):
            command += [f"--{flag}", str(cell / f"{file}.yaml")]
        with site.broker:
            for way in ("nothing published", "published, no client", "one client that floods"):
                out = Path(name) / way.replace(" ", "-")
                more = [] if way.startswith("nothing") else site.written
                run = subprocess.Popen(
                    [*command, "-o", str(out), *more], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
                )
                flooding = None
                if way.startswith("one"):
                    while run.poll() is None:
                        with suppress(OSError), socket.create_connection(("127.0.0.1", site.port), timeout=0.2):
                            break
                        time.sleep(0.2)
                    flooding = started(flood, told(site))
                done = json.loads(run.communicate()[0])
                if flooding is not None:
                    flooding[1].set()
                    flooding[0].join(20)
                    flooding[0].kill()
                ms = done["decision_ms"]
                print(f"{way}: {done['n']} pairs, decision median {ms['median']:.2f}, 99 % {ms['p99']:.2f} ms")


def feeding(n: int = 2000) -> None:
    """What it takes of the measuring process to hand one state on, of an arm of six joints with a measured pose."""
    pose = TargetPose(
        t_s=0.0, status=PoseStatus.OK, parent="rig", T_parent_target=np.eye(4), covariance=np.eye(6) * 1e-8
    )
    compared = Compared(
        t_s=0.0, error=np.full(6, 1e-4), random=np.eye(6) * 1e-8,
        systematic=np.zeros((6, 6)), expected_std=np.ones(6),
    )  # fmt: skip
    process, feed, took_s = PlantProcess(PlantOptions()), Feed(lambda *_: None, 1.0), []  # which is never started
    for k in range(n):
        begun_s = time.perf_counter()
        now_s = time.monotonic()
        reading = JointReading(t_s=now_s, q=np.zeros(6), sequence=k, source="bench")
        seen = Seen(
            pose=pose, compared=compared, level=Level.GOOD, why="", limits=Limits(warn_m=1e-3), lost="", at_s=now_s
        )
        robot = RobotSeen(name="bench", status=None, reading=reading, at_s=now_s, T_base_flange=np.eye(4))
        state = PlantState(source="bench", made_s=now_s, made_unix_s=time.time(), robot=robot, seen=seen, measures=True)
        process.show(feed.with_alarms(state))
        took_s.append(time.perf_counter() - begun_s)
    ms = np.array(took_s) * 1e3
    median, p99 = np.median(ms), np.percentile(ms, 99)
    print(f"handing a state on: median {median:.3f}, 99 % {p99:.3f} ms, every {FEED_S * 1e3:g} ms")


def refused() -> None:
    with tempfile.TemporaryDirectory() as name:
        site = Site(Path(name))
        url, pair, token = site.keys
        cases = {
            "a certificate that is not trusted": (url, site.pairs["stranger"], token),
            "a wrong token": (url, pair, "wrong"),
            "no token": (url, pair, None),
            "no certificate": (url, None, token),
        }
        with site.broker:
            server = serve(site, "log.mcap")
            for what, (_, files_, given) in cases.items():
                print(f"OPC UA, {what}: {asyncio.run(answer(site, files_, given))}")
            server.send_signal(signal.SIGINT)
            server.wait()
            wrong = replace(site.flags, mqtt_ca=site.broker.other_ca)
            for what, flags, password in (
                ("an authority that did not sign", wrong, PASSWORD),
                ("a wrong password", site.flags, "wrong"),
            ):
                os.environ["ARMSIGHT_MQTT_PASSWORD"] = password
                site.flags = flags
                server = serve(site, f"{len(what)}.mcap")
                time.sleep(4.0)
                server.send_signal(signal.SIGINT)
                server.wait()
                print(f"MQTT, {what}: {'; '.join(logged(site.folder / f'{len(what)}.mcap', 'MQTT'))}")
        print("log: " + "; ".join(logged(site.folder / "log.mcap", "OPC UA")))


async def answer(site: Site, pair: tuple[Path, Path] | None, token: str | None) -> str:
    client = opcua_client(site.keys)
    if token is None:
        client._username = client._password = None
    else:
        client.set_password(token)
    try:
        if pair is not None:
            await client.set_security(
                SecurityPolicyBasic256Sha256, *map(str, pair), mode=ua.MessageSecurityMode.SignAndEncrypt
            )
        async with client:
            return "LET IN"
    except ua.UaStatusCodeError as error:
        return f"refused ({type(error).__name__})"
    except ua.UaError as error:
        return f"refused ({error})"


def logged(file: Path, part: str) -> list[str]:
    said = (json.loads(bytes(one.data))["message"] for one in Recording(file).messages(("/events",)))
    return [text for text in said if part in text]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("clients", "loop", "measuring", "refused"))
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--frames", type=int, default=200)
    args = parser.parse_args()
    logging.disable(logging.CRITICAL)  # asyncua's client tells every refusal
    if missing():
        raise SystemExit(missing())
    if args.what == "clients":
        with_clients(args.minutes)
    elif args.what == "loop":
        loop(args.minutes)
    elif args.what == "measuring":
        feeding()
        measuring(args.frames)
    else:
        refused()


if __name__ == "__main__":
    main()
