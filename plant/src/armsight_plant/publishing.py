"""From flags to what is published, what a served robot or a supervision is, and the thread that feeds publishers."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from armsight.control.session.loop_host import flange_pose
from armsight.control.session.service import Service
from armsight.errors import ArmsightError, UsageError
from armsight.ops.requests.plant import STALE_S, PlantFlags
from armsight.records import JointReading
from armsight.verify.supervision import Seen
from armsight_plant import certificates
from armsight_plant.options import PlantOptions, foxglove_options, mqtt_options, opcua_options
from armsight_plant.process import PlantProcess
from armsight_plant.state import AlarmBook, Note, PlantState, Request, RobotSeen, conditions

if TYPE_CHECKING:
    from armsight.ops.verification.supervising import Supervision


FEED_S = 0.02
"""How often the newest state is handed on."""
AGAIN_S = 5.0
"""Publishers that ended by themselves are started anew after so long."""

Source = Callable[[], PlantState]
"""Returns the newest state without alarms; never waits, never raises."""
Log = Callable[[str, str], None]
"""Takes a level (info, warning, error) and a message."""


class Feed:
    """The alarms of a source, and what is done with what comes back. Pure but for the log; for one thread."""

    def __init__(self, log: Log, stale_s: float) -> None:
        self._log, self._stale_s = log, stale_s
        self._book = AlarmBook()

    def with_alarms(self, state: PlantState) -> PlantState:
        """Return the state with the alarms that are there now; what became of them is logged."""
        for text in self._book.update(conditions(state, self._stale_s), state.made_unix_s):
            self._log("info", text)
        return replace(state, alarms=self._book.alarms)

    def take(self, request: Request) -> None:
        """Log a note; acknowledge an alarm, and log who did."""
        if isinstance(request, Note):
            self._log(request.level, request.message)
            return
        by = f"{request.who} at {request.address}"
        try:
            alarm = self._book.acknowledge(request.id, request.who)
        except UsageError as error:
            self._log("warning", f"{by}: {error.cause}")
            return
        self._log("info", f"alarm {alarm.id} was acknowledged by {by}")


class _FeedThread(threading.Thread):
    """Feeds a process until told to end."""

    def __init__(self, process: PlantProcess, source: Source, log: Log, stale_s: float) -> None:
        super().__init__(name="armsight-plant", daemon=True)
        self._process, self._source, self._log = process, source, log
        self._feed = Feed(log, stale_s)
        self._end = threading.Event()
        self._ended_s: float | None = None
        self._said = ""

    def run(self) -> None:
        """Hand on what is new."""
        while not self._end.wait(FEED_S):
            self._process.show(self._feed.with_alarms(self._source()))
            for request in self._process.requests():
                self._feed.take(request)
            self._look_after()

    def end(self) -> None:
        """End it and wait."""
        self._end.set()
        self.join()

    def _look_after(self) -> None:
        came = self._process.came
        if self._process.alive:
            if self._said and isinstance(came, dict):
                self._said = ""
                self._log("info", f"published again{''.join(f', {name}: port {port}' for name, port in came.items())}")
            return
        now_s = time.monotonic()
        if self._ended_s is None:
            self._ended_s = now_s
            why = came.cause if isinstance(came, ArmsightError) else "that process has ended"
            if why != self._said:  # once, not with every try
                self._said = why
                self._log("error", f"nothing is published: {why}; it is started anew every {AGAIN_S:g} s")
        elif now_s - self._ended_s > AGAIN_S:
            self._ended_s = None
            self._process.restart()


@contextlib.contextmanager
def published(options: PlantOptions, source: Source, log: Log) -> Iterator[dict[str, int]]:
    """Publish a source while the block runs; gives the ports that are listened at, by name.

    Raises DeviceNotFound for a package that is missing, BadFile for certificates, DeviceFailed for a port in use.
    """
    with PlantProcess(options) as process:
        thread = _FeedThread(process, source, log, options.stale_s)
        thread.start()
        try:
            yield process.ports
        finally:
            thread.end()


def addresses(options: PlantOptions, ports: Mapping[str, int]) -> list[str]:
    """Return where the plant's systems find what is published, a line each."""
    lines = []
    if options.opcua is not None:
        lines.append(f"OPC UA: opc.tcp://{_host(options.opcua.host)}:{ports['opcua']}")
    if options.mqtt is not None:
        lines.append(f"MQTT: {options.mqtt.prefix}/state at {options.mqtt.host}:{options.mqtt.port}")
    if options.foxglove is not None:
        lines.append(f"Foxglove: ws://{_host(options.foxglove.host)}:{ports['foxglove']}")
    return lines


def _host(host: str) -> str:
    return f"[{host}]" if ":" in host else host


SERVE, SUPERVISES = "armsight serve", "armsight verify --live"


@dataclass(frozen=True, slots=True)
class Publishing:
    """What is published, checked; nothing is before a block of `served` or `supervised` runs."""

    options: PlantOptions

    @contextlib.contextmanager
    def served(
        self, service: Service, tell: Callable[[str], None], seen: Callable[[], Seen | None] = lambda: None
    ) -> Iterator[None]:
        """Publish a robot while the block runs. tell: the addresses, and failures. seen: what a supervision measured
        last. Raises as feed.published."""
        with published(self.options, source_of(service, seen), log_of(service, tell)) as ports:
            for text in addresses(self.options, ports):
                tell(text)
            yield

    @contextlib.contextmanager
    def supervised(self, run: Supervision) -> Iterator[None]:
        """Publish a supervision that is open while the block runs. Raises as feed.published."""
        with published(self.options, lambda: state_of(run), run.note) as ports:
            for text in addresses(self.options, ports):
                run.tell(text)
            yield


def publishing(flags: PlantFlags, notify: Callable[[str], None], users: Path | None = None) -> Publishing:
    """Return what flags ask for, of which at least one is given. users: in place of --opcua-users.

    Raises UsageError, BadFile.
    """
    _check_alone(flags)
    opcua = mqtt = foxglove = None
    if flags.opcua is not None:
        opcua = opcua_options(
            flags.opcua,
            certificate=flags.opcua_certificate,
            key=flags.opcua_key,
            trusted=flags.opcua_trusted,
            users=flags.opcua_users or users,
            anonymous=flags.opcua_anonymous,
        )
        if flags.opcua_anonymous:
            notify("Note: --opcua-anonymous lets everyone who reaches its port read, unencrypted if they like.")
    if flags.mqtt is not None:
        mqtt = mqtt_options(flags.mqtt, ca=flags.mqtt_ca, user=flags.mqtt_user, password_file=flags.mqtt_password_file)
    if flags.foxglove is not None:
        foxglove = foxglove_options(flags.foxglove)
        notify("Note: Foxglove's protocol knows no passwords: whoever reaches its port may watch.")
    made = PlantOptions(opcua=opcua, mqtt=mqtt, foxglove=foxglove, stale_s=flags.stale_after_s)
    certificates.check(made)
    return Publishing(made)


def _check_alone(flags: PlantFlags) -> None:
    """Raise UsageError for a flag of something that is not published."""
    for main, names in (
        ("opcua", ("opcua_certificate", "opcua_key", "opcua_trusted", "opcua_users", "opcua_anonymous")),
        ("mqtt", ("mqtt_ca", "mqtt_user", "mqtt_password_file")),
    ):
        given = [f"--{name.replace('_', '-')}" for name in names if getattr(flags, name)]
        if given and getattr(flags, main) is None:
            raise UsageError(
                f"{', '.join(given)} without --{main}",
                consequence="Nothing is published",
                cure=f"Give --{main} URL",
            )
    if flags.stale_after_s != STALE_S and flags.opcua is None and flags.mqtt is None and flags.foxglove is None:
        raise UsageError(
            "--stale-after is of what is published, and nothing is",
            consequence="It would change nothing",
            cure="Give --opcua, --mqtt or --foxglove, or leave it away",
        )
    if flags.opcua_certificate is None and (flags.opcua_users or flags.opcua_trusted):
        raise UsageError(
            "--opcua-users and --opcua-trusted need a certificate of the server",
            consequence="Tokens would cross the network in plain text; nothing is published",
            cure="Give --opcua-certificate and --opcua-key",
        )


def source_of(service: Service, seen: Callable[[], Seen | None] = lambda: None) -> Source:
    """Return what looks at a service; seen: what a supervision beside it measured last, None where none goes on."""

    def look() -> PlantState:
        measured = seen()
        robot, why = None, ""
        try:
            robot = _robot(service)
        except ArmsightError as error:
            why = error.cause
        return PlantState(
            source=SERVE,
            made_s=time.monotonic(),
            made_unix_s=time.time(),
            robot=robot,
            why=why,
            seen=measured,
            recording=service.recording_failed,
            measures=measured is not None,
        )

    return look


def log_of(service: Service, tell: Callable[[str], None] = lambda _: None) -> Log:
    """Return what keeps notes in a service's log; errors are told the person too."""

    def keep(level: str, message: str) -> None:
        service.authority.note(level, message)
        if level == "error":
            tell(message)

    return keep


def _robot(service: Service) -> RobotSeen:
    status = service.authority.status()
    reading: JointReading | None = status.reading
    T = None if reading is None else flange_pose(service.host.arm, reading.q)
    return RobotSeen(
        name=service.authority.robot.name,
        status=status,
        reading=reading,
        at_s=float("nan") if reading is None else time.monotonic() - (service.host.now_s() - reading.t_s),
        T_base_flange=None if T is None else T.as_matrix(),
    )


def state_of(run: Supervision) -> PlantState:
    """Return all of a supervision's newest moment; any thread may call this."""
    reading, at_s, why = run.joints()
    robot = RobotSeen(name=run.devices.robot.name, status=None, reading=reading, at_s=at_s, T_base_flange=None)
    return PlantState(
        source=SUPERVISES,
        made_s=time.monotonic(),
        made_unix_s=time.time(),
        robot=None if why else robot,
        why=why,
        seen=run.seen,
        measures=True,
    )
