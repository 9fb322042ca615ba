"""The workers: a cluster on this machine's cores, or one that is there already, by its scheduler's address."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import os
import platform
import re
import signal
import threading
import time
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from armsight import errors
from armsight.drivers.ahead import CORES, cores
from armsight.errors import DeviceFailed, UsageError
from armsight.records import Progress

if TYPE_CHECKING:
    from distributed import Client


CONNECT_S = 15.0
"""Longest wait for a scheduler that should be there."""
ADDRESS = re.compile(r"(?:[a-z]+://)?(?:\[[0-9a-fA-F:]+\]|[^\s:/\[\]]+):[0-9]{1,5}")
WORKERS_S = 60.0
"""Longest wait for its first worker."""
KILL_S = 0.5
"""Time that a worker has to end by itself where the batch is stopped."""
NOTHING = "Nothing was done"
BEGIN = (
    "Look whether there is memory left. A Python script that calls batch is imported by its workers: what it does "
    'stands below `if __name__ == "__main__":`'
)
CLOSE_S = 10.0
"""Longest wait for a worker to close."""
START_S = 20.0
"""Time in which a worker has to have a process at all."""
GONE_S = 2.0
"""Time without a process after which a worker is taken for gone; between two of its processes it takes less."""
MOST_WORKERS = 1024
ONE_THREAD = {
    **dict.fromkeys(
        ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", CORES, "ARMSIGHT_WORKERS"),
        "1",
    ),
    "OPENCV_LOG_LEVEL": "SILENT",
}
"""Of a worker's process, before it loads anything: one process for each core, whose threads would fight for them."""
ONE_KERNEL_THREAD = {"NUMBA_NUM_THREADS": "1"}
"""Of a worker's process, from its first turn on. Dask has what a process begins with in its own environment while it
starts one, and numba reads this of it at each kernel that it compiles, and refuses a change once its threads run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """Which workers are asked for: n processes on this machine (None: one for each core), or those of a scheduler."""

    n: int | None = None
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.n is not None and self.scheduler is not None:
            raise UsageError(
                "--jobs says how many workers are begun here, and --scheduler that they are there already",
                consequence=NOTHING,
                cure="Give one of them",
            )
        if self.n is not None and not 1 <= self.n <= MOST_WORKERS:
            raise UsageError(f"there cannot be {self.n} workers", cure=f"Give --jobs from 1 to {MOST_WORKERS}")


@contextlib.contextmanager
def connected(workers: Workers) -> Iterator[Client]:
    """Yield a client with at least one worker. Raises DeviceFailed where there is none in time, or of other software.

    Raises UsageError where Dask is not installed, or the address is none.
    """
    for name in ("distributed", "pyarrow"):
        if find_spec(name) is None:
            raise UsageError(
                f"batches need {name}, which is not installed",
                consequence=NOTHING,
                cure="pip install 'armsight[batch]'",
            )
    import dask
    import distributed  # noqa: F401  before the settings: they would go with its own when they are put back

    for name in ["tornado", "asyncio", *logging.root.manager.loggerDict]:
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):  # of lost workers the table tells
            logging.getLogger(name).setLevel(logging.CRITICAL)
    with dask.config.set(CONFIG), _theirs(workers.scheduler) if workers.scheduler else _own(workers.n) as client:
        yield client


CONFIG = {
    "distributed.logging": {"distributed": "critical"},
    "distributed.nanny.pre-spawn-environ": ONE_THREAD,  # without Dask's MALLOC_TRIM_THRESHOLD_: images come and go
    "distributed.nanny.environ": ONE_KERNEL_THREAD,
    "distributed.scheduler.allowed-failures": 1_000_000,  # a job's attempts are counted by its folders
    "distributed.scheduler.worker-ttl": None,  # compiling holds the interpreter's lock for longer than a heartbeat
    "distributed.scheduler.work-stealing": False,  # groups are handed out as workers become free
    "distributed.admin.tick.limit": "1h",
    # how often processes look at themselves: as Dask has it, 4 % of two cores while nothing is done, so 0.7 %
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.worker.memory.monitor-interval": "1s",
    "distributed.worker.profile.enabled": False,  # it looks at every worker a hundred times a second
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}


@contextlib.contextmanager
def _own(n: int | None) -> Iterator[Client]:
    from distributed import Client, LocalCluster
    from distributed.security import Security

    count = n or cores()
    # who reaches a scheduler may run anything: with a key of this run alone where there is the means to make one
    security = Security.temporary() if find_spec("cryptography") else None
    try:
        cluster: Any = LocalCluster(
            n_workers=0,  # they are begun below
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address=None,
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
            silence_logs=logging.CRITICAL,
            security=security,
        )
    except (RuntimeError, OSError) as error:
        raise DeviceFailed(f"the worker processes did not begin ({error})", consequence=NOTHING, cure=BEGIN) from error
    with cluster, Client(cluster, set_as_default=False) as client:
        client.register_plugin(_leaves_interrupts_alone())
        slots = cluster.sync(_begin, cluster, count)
        try:
            _require_workers(client, "the worker processes did not begin", BEGIN)
            yield client
        finally:  # closing them ends them in the middle of what they do
            with contextlib.suppress(Exception):
                cluster.sync(_end, slots)


async def _begin(cluster: Any, count: int) -> list[asyncio.Task[None]]:
    return [asyncio.create_task(_slot(cluster, slot)) for slot in range(count)]


async def _end(slots: Iterable[asyncio.Task[None]]) -> None:
    for slot in slots:
        slot.cancel()
    await asyncio.gather(*slots, return_exceptions=True)


async def _slot(cluster: Any, slot: int) -> None:
    """Hold one worker, and begin another where it is gone for good.

    Its nanny begins its process anew when that ends at work, but not when it is killed while it starts; closing such a
    nanny may never end, and a cluster that closes it waits for ever: each slot is by itself, and waits CLOSE_S.
    """
    kind, options = cluster.new_spec["cls"], cluster.new_spec["options"]
    for number in itertools.count():
        nanny = kind(cluster.scheduler_address, **{**options, "name": f"{slot}-{number}"})
        begun = asyncio.ensure_future(nanny.start())
        try:
            await _gone(nanny)
        finally:
            begun.cancel()
            with contextlib.suppress(Exception):
                await asyncio.wait_for(nanny.close(timeout=KILL_S), CLOSE_S)


async def _gone(nanny: Any) -> None:
    """Return when a worker has been without a process for so long that there will be none."""
    until_s = time.monotonic() + START_S
    while (now_s := time.monotonic()) < until_s:
        if nanny.process is not None and nanny.process.is_alive():
            until_s = now_s + GONE_S
        await asyncio.sleep(GONE_S / 4)


@contextlib.contextmanager
def _theirs(address: str) -> Iterator[Client]:
    from distributed import Client

    if not ADDRESS.fullmatch(address):
        raise UsageError(
            f"{address!r} is no scheduler's address",
            consequence=NOTHING,
            cure="Give one such as tcp://host:8786",
        )
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except Exception as error:  # what comes of other versions at the other end is anything
        raise DeviceFailed(
            f"no scheduler answers at {address} ({' '.join(str(error).split())[:120] or type(error).__name__})",
            consequence=NOTHING,
            cure="Check address and port, and that `dask scheduler` of the same version runs there",
        ) from error
    with client:
        _require_same_versions(client, address)
        _require_workers(client, f"the scheduler at {address} has no worker", "Begin some: dask worker ADDRESS")
        yield client


def _require_workers(client: Client, cause: str, cure: str) -> None:
    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
    except TimeoutError as error:
        raise DeviceFailed(f"{cause} within {WORKERS_S:.0f} s", consequence=NOTHING, cure=cure) from error


def _require_same_versions(client: Client, address: str) -> None:
    """Raise DeviceFailed where scheduler or workers have another Python or Dask; of armsight each worker tells."""
    found: Any = client.get_versions()
    own = {"python": platform.python_version_tuple()[:2], "distributed": version("distributed")}
    for name, one in [("scheduler", found["scheduler"]), *found["workers"].items()]:
        versions = dict(one["packages"]) if one else {}
        python = tuple(str(versions.get("python", "")).split(".")[:2])
        if python != own["python"] or versions.get("distributed") != own["distributed"]:
            raise DeviceFailed(
                f"{name} at {address} has Python {'.'.join(python)} and distributed {versions.get('distributed')}, "
                f"here are Python {'.'.join(own['python'])} and distributed {own['distributed']}",
                consequence="They do not understand each other; nothing was done",
                cure="Install the same lock file for the scheduler, its workers and here",
            )


def _leaves_interrupts_alone() -> Any:
    from distributed import WorkerPlugin

    class LeaveInterrupts(WorkerPlugin):
        """A terminal's Ctrl-C goes to all its processes, and only the batch itself is to hear it."""

        def setup(self, worker: Any) -> None:
            ignore_interrupts()

    return LeaveInterrupts()


def ignore_interrupts() -> None:
    """Leave Ctrl-C to others, in a process whose main thread this is."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)


PACKAGE = Path(errors.__file__).parent
CAMERAS = ("boards", "cameras")
GROUPS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "measure": ("measure/poses", ("spots", "boards", "poses", "motion", "measure")),
    "simulate": ("measure/poses", ("room", "simulator")),
    "verify": ("kinematics", ("kinematics",)),
    "identify": ("calibrate/identify", ("spots", "poses", "identify")),
    "calibrate camera": ("calibrate/cameras", CAMERAS),
    "calibrate stereo": ("calibrate/cameras", CAMERAS),
    "calibrate mirrors": ("calibrate/cameras", CAMERAS),
    "calibrate zoom-rig": ("calibrate/cameras", CAMERAS),
    "calibrate target": ("measure/spots", ("spots", "light target")),
    "calibrate timing": ("measure/poses", ("spots", "poses", "motion")),
    "calibrate cell": ("optics", ("spots", "kinematics", "arm")),
    "calibrate handeye": ("calibrate/handeye", ("boards", "hand-eye")),
    "calibrate arm": ("kinematics", ("kinematics", "arm")),
    "kinematics fk": ("kinematics", ("kinematics",)),
}
"""Command -> the folder whose kernels it needs, and what compiles them (ops.compilation)."""


def compile_for(commands: Collection[str], progress: Progress) -> None:
    """Compile what the commands need where nothing of it is kept on this machine; at once where it is.

    Raises Cancelled. What fails to compile here is tried again, and told, by the first job that needs it.
    """
    missing: dict[str, None] = {}
    for command in sorted(commands):
        folder, groups = GROUPS.get(command, ("kinematics", ("kinematics",)))
        if not _kept(folder):
            missing.update(dict.fromkeys(groups))
    if missing:
        from armsight.ops.compilation import compile_all

        compile_all(progress, tuple(missing))


def _kept(folder: str) -> bool:
    """Tell whether compiled kernels of a folder of the package are kept."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return any(Path(given).rglob("*.nbi"))
    return any((PACKAGE / folder).rglob("*.nbi"))
