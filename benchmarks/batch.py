"""Batches: many short recordings beside two processes begun by hand, workers killed at random, and Dask's own cost.

--n N recordings (of FEW that differ), measured by `armsight batch` on --workers W, by W processes begun by hand that
each call the same function over their share, and by a shell's loop (a few, and what N would take); then by a batch
whose workers are killed --kills K times, whose table must be the same. --overhead N: the processor
time of scheduler and client for each of N jobs that sleep 10 ms (N / 5 one by one, N in groups), and the table's.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import bench

FEW, PAIRS, LOOPED, SLEEP_S, THREADS = 8, 4, 3, 0.01, 50
VARY = ("duration_s", "attempts")
"""Columns that differ from run to run; and times, ms_per_frame."""
MB = 1024.0


def recordings(folder: Path, n: int) -> list[Path]:
    """Record FEW short recordings, and name them n times."""
    from armsight.ops.measure import record
    from armsight.ops.simulation.run import simulate

    if not (folder / "cell").exists():
        simulate("hand-cell", folder / "cell", frames=1)
    kept = [folder / f"recorded-{seed}.mcap" for seed in range(min(FEW, n))]
    for seed, path in enumerate(kept):
        if not path.exists():
            record(path, cell="hand-cell", seed=seed, frames=PAIRS)
    (folder / "recordings").mkdir()
    named = [folder / "recordings" / f"r{number:05d}.mcap" for number in range(n)]
    for number, path in enumerate(named):
        os.link(kept[number % len(kept)], path)
    return named


def flags(folder: Path) -> list[str]:
    return ["--rig", f"{folder}/cell/rig.yaml", "--target", f"{folder}/cell/target.yaml"]


def by_hand(folder: Path, out: Path, share: Sequence[str]) -> None:
    """Measure a share of the recordings in this process, with the function that the command calls."""
    import cv2

    from armsight.errors import ArmsightError
    from armsight.ops.measure import measure

    cv2.setNumThreads(1)
    cell = folder / "cell"
    for name in share:
        with suppress(ArmsightError):
            measure(cell / "rig.yaml", cell / "target.yaml", name, out=out / Path(name).stem)


def used_s() -> float:
    """Return the processor time of all processes that this one began and that have ended."""
    told = resource.getrusage(resource.RUSAGE_CHILDREN)
    return told.ru_utime + told.ru_stime


class Pace:
    """How many folders are finished over time: the rate between a fifth and nine tenths, without begin and end."""

    def __init__(self, out: Path, marker: str, n: int) -> None:
        self._pattern, self._n, self._start_s = (out, f"*/{marker}"), n, time.perf_counter()
        self._seen: list[tuple[float, int]] = []

    def look(self) -> None:
        out, pattern = self._pattern
        self._seen.append((time.perf_counter() - self._start_s, sum(1 for _ in out.glob(pattern))))

    @property
    def rate(self) -> float:
        inner = [one for one in self._seen if 0.2 * self._n <= one[1] <= 0.9 * self._n]
        (at_s, first), (end_s, last) = (inner[0], inner[-1]) if inner else ((0.0, 0), (1.0, 0))
        return (last - first) / (end_s - at_s) if end_s > at_s else 0.0


def processes_by_hand(folder: Path, named: Sequence[Path], n: int, pace: Pace) -> float:
    """Return the seconds that n processes begun by hand take."""
    environ = os.environ | dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    start_s = time.perf_counter()
    begun = []
    for share in range(n):
        (folder / f"share-{share}").write_text("\n".join(map(str, named[share::n])))
        words = [sys.executable, __file__, "--share", str(folder), str(share)]
        begun.append(subprocess.Popen(words, env=environ))
    while any(one.poll() is None for one in begun):
        pace.look()
        time.sleep(0.25)
    if any(one.wait() for one in begun):
        raise SystemExit("a process begun by hand failed")
    return time.perf_counter() - start_s


def loop_of_a_shell(folder: Path, named: Sequence[Path]) -> float:
    """Return the seconds that `armsight measure` takes for one recording, begun anew for each."""
    start_s = time.perf_counter()
    for path in named[:LOOPED]:
        words = [sys.executable, "-m", "armsight", "measure", "--left", str(path), *flags(folder)]
        subprocess.run([*words, "-o", str(folder / "loop" / path.stem)], stderr=subprocess.DEVNULL, check=False)
    return (time.perf_counter() - start_s) / LOOPED


def children(pid: int) -> list[int]:
    """Return the worker processes of a batch."""
    found = []
    for folder in Path("/proc").iterdir():
        with suppress(OSError):
            of = (folder / "stat").read_text().rpartition(")")[2].split()[1] if folder.name.isdecimal() else ""
            if of == str(pid) and "spawn_main" in (folder / "cmdline").read_text():
                found.append(int(folder.name))
    return found


def rss_mb(pid: int) -> float:
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        return next(float(line.split()[1]) / MB for line in lines if line.startswith("VmRSS"))
    except (OSError, StopIteration):
        return 0.0


@contextmanager
def batch(folder: Path, out: Path, workers: int, *more: str) -> Iterator[subprocess.Popen[str]]:
    words = [sys.executable, "-m", "armsight", "batch", "--each", f"{folder}/recordings/*.mcap", "-o", str(out)]
    words += [*more, "--jobs", str(workers), "--", "measure", "--left", "{}", *flags(folder)]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as process:
        yield process


def watched(folder: Path, out: Path, workers: int, pace: Pace) -> tuple[float, list[tuple[float, float, float]], str]:
    """Return the seconds of a batch, what it and its largest worker held over time, and what it told."""
    start_s, seen = time.perf_counter(), []
    with batch(folder, out, workers) as process:
        while process.poll() is None:
            each = [rss_mb(pid) for pid in children(process.pid)]
            seen.append((time.perf_counter() - start_s, rss_mb(process.pid), max(each, default=0.0)))
            pace.look()
            time.sleep(0.25)
        told = process.stderr.read() if process.stderr else ""
    return time.perf_counter() - start_s, seen, told


def disturbed(folder: Path, out: Path, workers: int, kills: int, seconds: float) -> tuple[int, float]:
    """Kill workers at random times while a batch runs; return how many, and the seconds that it took."""
    rng, killed, start_s = random.Random(1), 0, time.perf_counter()
    with batch(folder, out, workers) as process:
        while process.poll() is None and killed < kills:
            time.sleep(rng.uniform(0.0, 1.4 * seconds / kills))
            if begun := children(process.pid):
                os.kill(rng.choice(begun), signal.SIGKILL)
                killed += 1
        process.communicate()
    return killed, time.perf_counter() - start_s


def rows(out: Path) -> dict[str, dict[str, Any]]:
    """Return the rows of a table by job, without what differs from run to run: times, and the folder's own name."""
    import pyarrow.parquet as pq

    def same(value: Any) -> Any:
        return value.replace(str(out), "OUT") if isinstance(value, str) else value

    told = pq.read_table(out / "results.parquet").to_pylist()
    kept = [{k: same(v) for k, v in row.items() if k not in VARY and "ms_per_frame" not in k} for row in told]
    return {row["job"]: row for row in kept}


def overhead(n: int, in_groups: bool) -> None:
    """Print the processor time of scheduler and client for each job; what jobs do on the disk is their workers'."""
    import dask
    from distributed import Client, LocalCluster

    from armsight.records import Silent
    from armsight_lab.batch import run as batch_run
    from armsight_lab.batch.cluster import CONFIG
    from armsight_lab.batch.jobs import Job

    sys.path.insert(0, str(Path(__file__).parent))
    import batch_sleep

    batch_run.MOST_IN_GROUP = 500 if in_groups else 1
    jobs = [Job(name=f"j{number:06d}", command="sleep", arguments={"s": SLEEP_S}) for number in range(n)]
    with (
        dask.config.set(CONFIG),
        LocalCluster(2, threads_per_worker=THREADS, dashboard_address=None, silence_logs=50) as cluster,
        Client(cluster) as client,
    ):
        work = partial(batch_sleep.group)
        done = batch_run._HandOut(client, work, jobs, Silent(), lambda: n)
        start_s, used_s, held_mb = time.perf_counter(), time.process_time(), rss_mb(os.getpid())
        done._run()
        wall_s, own_s = time.perf_counter() - start_s, time.process_time() - used_s
        grown_mb = rss_mb(os.getpid()) - held_mb
    print(f"{n} jobs of {1e3 * SLEEP_S:.0f} ms on {2 * THREADS} threads, {'in groups' if in_groups else 'one by one'}:")
    print(f"  {wall_s:.1f} s, {n / wall_s:.0f} a second; memory +{grown_mb:.0f} MB")
    print(f"  scheduler and client: {1e3 * own_s / n:.3f} ms of a processor a job")


def table(n: int) -> None:
    """Print what the table of n jobs with the figures of a measurement costs."""
    from armsight_lab.batch.results import JobResult, rows_of, write_job_result, write_result_table

    with tempfile.TemporaryDirectory() as name:
        out = Path(name)
        figures = {f"part{k}": {f"figure{i}_m": 0.1 * i for i in range(10)} for k in range(6)}
        one = JobResult(
            batch="b",
            job="j",
            command="measure",
            arguments={},
            status="done",
            exit_code=0,
            error=None,
            result=figures,
            said="",
            duration_s=1.0,
            attempts=1,
            input_hash="0",
        )
        (out / "j").mkdir()
        write_job_result(out / "j", one, called=out / "j")
        start_s, held_mb = time.process_time(), rss_mb(os.getpid())
        write_result_table(out / "t.parquet", partial(rows_of, out, ["j"] * n))
        used_s, grown_mb = time.process_time() - start_s, rss_mb(os.getpid()) - held_mb
        size = (out / "t.parquet").stat().st_size / 1e6
        print(f"table of {n} rows: {1e3 * used_s / n:.3f} ms a row, memory +{grown_mb:.0f} MB, {size:.1f} MB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=100)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--kills", type=int, default=5)
    parser.add_argument("--overhead", type=int, default=0)
    parser.add_argument("--folder", type=Path, help="where the recordings are kept, for another run of this")
    parser.add_argument("--share", nargs=2)
    asked = parser.parse_args()
    if asked.share:
        folder = Path(asked.share[0])
        names = (folder / f"share-{asked.share[1]}").read_text().splitlines()
        by_hand(folder, folder / "by-hand", names)
        return
    print(bench.machine())
    if asked.overhead:
        overhead(asked.overhead // 5, False)
        overhead(asked.overhead, True)
        table(asked.overhead)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = asked.folder or Path(name)
        folder.mkdir(exist_ok=True)
        for earlier in ("recordings", "by-hand", "out", "loop", "killed"):
            shutil.rmtree(folder / earlier, ignore_errors=True)
        compare(folder, asked.n, asked.workers, asked.kills)


def compare(folder: Path, n: int, workers: int, kills: int) -> None:
    named = recordings(folder, n)
    hand_used_s = used_s()
    hand, own = Pace(folder / "by-hand", "report.html", n), Pace(folder / "out", "result.json", n)
    hand_s = processes_by_hand(folder, named, workers, hand)
    hand_used_s = used_s() - hand_used_s
    batch_used_s = used_s()
    batch_s, seen, told = watched(folder, folder / "out", workers, own)
    batch_used_s = used_s() - batch_used_s
    each_s = loop_of_a_shell(folder, named)
    print(told.strip().splitlines()[-1])
    print(f"\n{n} recordings of {PAIRS} pairs, {workers} workers\n")
    print(f"  armsight batch                     {batch_s:8.1f} s   {n / batch_s:6.2f} a second")
    print(f"  {workers} processes begun by hand          {hand_s:8.1f} s   {n / hand_s:6.2f} a second")
    print(f"  batch / by hand                    {hand_s / batch_s:8.2f}   throughput, from start to end")
    pace = f"batch {own.rate:.2f} a second, by hand {hand.rate:.2f} ({own.rate / max(hand.rate, 1e-9):.2f})"
    print(f"  once begun (20 to 90 % done): {pace}")
    print(
        f"  processor time: batch {batch_used_s:.1f} s, by hand {hand_used_s:.1f} s ({hand_used_s / batch_used_s:.2f})"
    )
    print(f"  a shell's loop, of {LOOPED}               {n * each_s:8.1f} s   {1.0 / each_s:6.2f} a second (one core)")
    same = sum(
        (folder / "by-hand" / path.stem / "poses.csv").read_bytes()
        == (folder / "out" / path.stem / "poses.csv").read_bytes()
        for path in named
    )
    print(f"  poses.csv the same as by hand      {same:8d} of {n}")
    print("\nMemory over time, MB: the batch itself, its largest worker")
    for at_s, own, worker in seen[:: max(1, len(seen) // 10)]:
        print(f"  {at_s:7.1f} s  {own:7.0f} {worker:7.0f}")
    if kills:
        killed, took_s = disturbed(folder, folder / "killed", workers, kills, batch_s)
        calm, restless = rows(folder / "out"), rows(folder / "killed")
        differ = [name for name in calm if restless.get(name) != calm[name]]
        again = sum(row["status"] == "killed" for row in restless.values())
        print(f"\n{killed} workers killed at random: {took_s:.1f} s, {len(restless)} of {n} rows, {len(differ)} differ")
        print(f"  jobs that were under three killed workers by chance, and are named so: {again}")
        if again:
            with batch(folder, folder / "killed", workers, "--resume") as process:
                process.communicate()
            restless = rows(folder / "killed")
            differ = [name for name in calm if restless.get(name) != calm[name]]
            print(f"  after --resume {len(differ)} differ")


if __name__ == "__main__":
    main()
