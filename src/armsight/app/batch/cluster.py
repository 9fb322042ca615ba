"""The workers: a cluster on this machine's cores, or one that is there already, by its scheduler's address."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import platform
import re
import signal
import threading
import time
from collections.abc import Coroutine, Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from armsight.drivers.sources import CORES, cores
from armsight.errors import DeviceFailed, UsageError

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
GONE_S = 2.0
"""Time without a process after which a worker is taken for gone; between two of its processes it takes less."""
MOST_WORKERS = 1024
ONE_THREAD = {
    **dict.fromkeys(
        ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", CORES, "ARMSIGHT_WORKERS"),
        "1",
    ),
    "OPENCV_LOG_LEVEL": "SILENT",
}
"""Of a worker's process, before it loads anything: one process for each core, whose threads would fight for them."""


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
            n_workers=count,
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
        _require_workers(client, "the worker processes did not begin", BEGIN)
        client.register_plugin(_leaves_interrupts_alone())
        keeping = cluster.sync(_begun, _keep(cluster, count))
        try:
            yield client
        except BaseException:
            cluster.loop.add_callback(keeping.cancel)
            with contextlib.suppress(Exception):  # closing them ends them too, after the jobs that they are at
                cluster.sync(_kill, cluster.workers.values())
            raise
        finally:
            cluster.loop.add_callback(keeping.cancel)


async def _begun(work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
    return asyncio.create_task(work)


async def _keep(cluster: Any, count: int) -> None:
    """Begin another worker where one is gone for good: a nanny begins its process anew when that ends at work, not when
    it is killed while it starts.
    """
    gone_since_s: dict[Any, float] = {}
    while True:
        await asyncio.sleep(GONE_S / 4)
        gone = {name for name, nanny in cluster.workers.items() if not (nanny.process and nanny.process.is_alive())}
        now_s = time.monotonic()
        gone_since_s = {name: gone_since_s.get(name, now_s) for name in gone}
        if lost := [name for name, since_s in gone_since_s.items() if now_s - since_s > GONE_S]:
            cluster.scale(count + len(lost))  # before the lost ones go: their names would be given again
            for name in lost:
                cluster.worker_spec.pop(name, None)


async def _kill(nannies: Iterable[Any]) -> None:
    """End worker processes in the middle of what they do."""
    await asyncio.gather(*(one.close(timeout=KILL_S) for one in nannies))


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
