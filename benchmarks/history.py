"""The history of cells: how long `trend` takes, whether drifts are found and false alarms as rare as said, lost writes.

python benchmarks/history.py [trend] [drift] [steps] [alarms] [writers]        # all without a word
"""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from datetime import timedelta
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # histories.py

import histories
from armsight_lab.history import queries
from armsight_lab.history.adding import file_entry
from armsight_lab.history.database import reading, writing
from armsight_lab.history.drift import SLACK, charted, limits_for
from armsight_lab.history.place import place_of
from armsight_lab.history.queries import Filter

CELLS, RUNS = 50, 10_000
FIGURES = 16
"""Charted at once: 6 joint zeros, 6 of the hand-eye, baseline, 3 of the tip."""
YEARS_APART = 100.0
DRIFT_DEG_A_WEEK = 0.02
WEEKS_A_YEAR = 52
WRITERS, SECONDS, LEAST_BYTES = 8, 20.0, 100
"""Processes that write at once, seconds in which one after the other is killed, bytes that each has said by then."""

WRITER = """
import sys
import histories
from armsight_lab.history.adding import file_entry
from armsight_lab.history.place import place_of
place = place_of(sys.argv[1])
for entry in histories.runs(sys.argv[2], 100_000, seed=int(sys.argv[3]), every_days=0.01):
    print(file_entry(place, entry).run, flush=True)
"""


def table(title: str, header: list[str], rows: list[list[object]]) -> None:
    print(f"\n{title}\n")
    print("| " + " | ".join(header) + " |")
    print("|" + "---|" * len(header))
    for row in rows:
        print("| " + " | ".join(map(str, row)) + " |", flush=True)


def fill(path: Path) -> None:
    """Write the runs of CELLS cells, a run a week each, a hand-eye calibration beside each arm's."""
    from scipy.spatial.transform import Rotation

    place = place_of(str(path))
    rng = np.random.default_rng(0)
    each = RUNS // CELLS // 2
    start = histories.START - timedelta(weeks=each)
    arms = [iter(histories.runs(f"cell {c}", each, seed=c, start=start)) for c in range(CELLS)]
    with writing(place) as connection:
        for i in range(each):
            for c, arm in enumerate(arms):
                when = start + timedelta(weeks=i, hours=1)
                turn = Rotation.from_rotvec(rng.normal(0.0, 1e-4, 3)) * Rotation.from_euler("x", 30, degrees=True)
                hand = histories.handeye_run(f"cell {c}", rng.normal(0.1, 1e-4, 3), turn, when)
                for entry in (next(arm), hand):
                    queries.add(connection, entry, entry.created)


def trend() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "history.sqlite"
        fill(path)
        with reading(place_of(str(path))) as connection:
            n = queries.count(connection, Filter())
        rows = []
        for name, words in {
            "trend, 12 figures": ["trend", "--cell", "cell 7", "-o", f"{folder}/drift", "--overwrite"],
            "list, the newest 50": ["list"],
            "show": ["show", "5000"],
        }.items():
            command = [sys.executable, "-m", "armsight", "history", *words, "--history", str(path), "--json"]
            took, worked = [], []
            for _ in range(8):
                began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
                subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
                after = resource.getrusage(resource.RUSAGE_CHILDREN)
                took.append(time.perf_counter() - began)
                worked.append(after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)
            rows.append([name, f"{np.median(took[1:]):.2f}", f"{min(took[1:]):.2f}", f"{np.median(worked[1:]):.2f}"])
        table(
            f"{n} runs of {CELLS} cells, {path.stat().st_size / 1e6:.0f} MB: the whole command, start included, s",
            ["command", "median of 7", "shortest", "processor's time, median"],
            rows,
        )


def drift() -> None:
    """A ramp in one figure after some weeks without; noticed: from the first week of the drift on."""
    rows = []
    rng = np.random.default_rng(1)
    n = 4000
    for std_deg, a_week, before, scatter in (
        (0.0037, 1, 12, 1.0),
        (0.0037, 1, 12, 1.5),
        (0.0037, 1, 26, 1.5),
        (0.0111, 1, 26, 1.0),
        (0.0111, 1, 52, 1.0),
        (0.0111, 1, 52, 1.5),
        (0.0111, 3, 12, 1.0),
        (0.0111, 3, 12, 1.5),
        (0.0111, 5, 12, 1.5),
        (0.0111, 7, 12, 1.5),
    ):
        limits = limits_for(YEARS_APART, WEEKS_A_YEAR * a_week, FIGURES)
        weeks = (np.arange((before + 8) * a_week) - before * a_week + 1.0) / a_week
        ramp = np.maximum(weeks, 0.0) * DRIFT_DEG_A_WEEK
        x = ramp[:, None] + std_deg * scatter * rng.standard_normal((len(ramp), n))
        jumps, drifts = charted(x, np.full_like(x, std_deg)).alarms(limits)
        either = jumps | drifts
        at = np.where(either.any(axis=0), weeks[either.argmax(axis=0)], np.inf)
        rows.append(
            [
                f"{std_deg:.4f}",
                a_week,
                before,
                f"{scatter:.1f}",
                f"{100.0 * np.mean(at <= 4.0):.1f} %",
                f"{np.median(at):.1f}",
                f"{np.quantile(at, 0.95):.1f}" if np.isfinite(np.quantile(at, 0.95)) else "> 8",
            ]
        )
    table(
        f"A joint zero that drifts {DRIFT_DEG_A_WEEK} deg a week among {FIGURES} figures, {n} cells each, one false "
        f"alarm in {YEARS_APART:g} cell-years, slack {SLACK:g}",
        [
            "told deviation of a run, deg",
            "runs a week",
            "weeks before",
            "true scatter over told",
            "found within 4 weeks",
            "weeks, median",
            "weeks, 95 %",
        ],
        rows,
    )


def steps() -> None:
    """A lasting change of one figure, in deviations of a run."""
    rows = []
    rng = np.random.default_rng(4)
    limits = limits_for(YEARS_APART, WEEKS_A_YEAR, FIGURES)
    for before in (12, 30, 60):
        shares = []
        for size in (1.5, 2.0, 2.5, 3.0, 4.0, 6.0):
            x = rng.standard_normal((before + 20, 2000))
            x[before:] += size
            jumps, drifts = charted(x, np.ones_like(x)).alarms(limits)
            shares.append(f"{100.0 * (jumps | drifts).any(axis=0).mean():.0f} %")
        rows.append([before, *shares])
    table(
        f"Lasting changes found within 20 runs, a run a week, {FIGURES} figures",
        ["runs before", *(f"{size} deviations" for size in ("1.5", "2", "2.5", "3", "4", "6"))],
        rows,
    )


def alarms() -> None:
    rows = []
    for a_week, years, cells, batches, scatter, r in (
        (1, 5, 1000, 4, 1.0, 0.0),
        (1, 5, 1000, 4, 1.5, 0.0),
        (1, 5, 1000, 4, 2.0, 0.0),
        (1, 5, 1000, 2, 1.5, 0.3),
        (5, 2, 500, 8, 1.0, 0.0),
        (5, 2, 500, 8, 1.5, 0.0),
    ):
        rng = np.random.default_rng(2)
        n, p = WEEKS_A_YEAR * a_week * years, cells * FIGURES
        limits = limits_for(YEARS_APART, WEEKS_A_YEAR * a_week, FIGURES)
        count, looked_at = 0, 0.0
        for _ in range(batches):
            x = rng.standard_normal((n, p))
            for i in range(1, n if r else 0):
                x[i] = r * x[i - 1] + np.sqrt(1.0 - r**2) * x[i]
            jumps, drifts = charted(scatter * x, np.ones_like(x)).alarms(limits)
            either = (jumps | drifts).reshape(n, cells, FIGURES).any(axis=2)
            first = np.where(either.any(axis=0), either.argmax(axis=0) + 1, n)
            count += int(either.any(axis=0).sum())
            looked_at += float(first.sum()) / (WEEKS_A_YEAR * a_week)
        rows.append([a_week, f"{scatter:.1f}", r, f"{looked_at:.0f}", count, f"{100.0 * count / looked_at:.2f}"])
    table(
        f"False alarms of cells in which nothing changes, {FIGURES} figures at once, from the first run on; said: one "
        f"in {YEARS_APART:g} cell-years",
        [
            "runs a week",
            "true scatter over told",
            "correlation of runs",
            "cell-years",
            "false alarms",
            "in 100 cell-years",
        ],
        rows,
    )


def writers() -> None:
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "history.sqlite"
        search = [str(Path(__file__).parents[1] / "tests"), *filter(None, [os.environ.get("PYTHONPATH")])]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(search)}
        logs = [Path(folder) / f"{i}.log" for i in range(WRITERS)]
        with contextlib.ExitStack() as held:
            started = [
                subprocess.Popen(
                    [sys.executable, "-c", WRITER, str(path), f"cell {i}", str(i)],
                    env=environment,
                    stdout=held.enter_context(log.open("wb")),
                )
                for i, log in enumerate(logs)
            ]
            while min(log.stat().st_size for log in logs) < LEAST_BYTES:
                time.sleep(0.1)
            for one in started:  # in the middle of whatever it does
                time.sleep(SECONDS / WRITERS)
                one.send_signal(signal.SIGKILL)
                one.wait()
        acknowledged = [
            int(line) for log in logs for line in log.read_text().splitlines(keepends=True) if line[-1] == "\n"
        ]
        with reading(place_of(str(path))) as connection:
            there = {one.id for one in queries.newest(connection, Filter())}
        with contextlib.closing(sqlite3.connect(path)) as checked:
            sound = checked.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        lost = set(acknowledged) - there
        rows.append([WRITERS, len(acknowledged), len(there), len(lost), "ok" if sound else "BROKEN"])
        file_entry(place_of(str(path)), next(histories.runs("after", 1)))
    table(
        f"{WRITERS} processes write to one file at once, every one killed by SIGKILL",
        ["processes", "acknowledged", "in the database", "acknowledged and lost", "integrity_check"],
        rows,
    )


def main() -> None:
    parts = {"trend": trend, "drift": drift, "steps": steps, "alarms": alarms, "writers": writers}
    for name in sys.argv[1:] or parts:
        parts[name]()


if __name__ == "__main__":
    main()
