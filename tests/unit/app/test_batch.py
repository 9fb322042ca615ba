"""Batches: every job once, its folder whole, one table of all figures, and what workers or people do meanwhile."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

sys.path.insert(0, str(Path(__file__).parent))  # workers inherit it

from batch_tasks import work

from armsight.errors import Cancelled, DeviceFailed, UsageError
from armsight.records import Silent
from armsight_lab.api.batch import _job, call
from armsight_lab.batch import run as batch_run
from armsight_lab.batch import work as batch_work
from armsight_lab.batch.cluster import ONE_THREAD, Workers, connected
from armsight_lab.batch.jobs import Ended, Job, check_inputs, check_names
from armsight_lab.batch.results import BatchOutput, write_batch, write_result_table
from armsight_lab.batch.run import run_batch
from armsight_lab.batch.work import RUNNING, Place
from refusals import refuses

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two workers for all tests here: they take seconds to begin."""
    with connected(Workers(n=2)) as client:
        yield client


def test_the_number_of_kernel_threads_is_told_to_workers_and_not_to_this_process_while_they_begin(cluster: Any) -> None:
    """Numba refuses another number once its threads run, at the next kernel that it compiles: here for ever."""
    assert cluster.submit(os.getenv, "NUMBA_NUM_THREADS", pure=False).result() == "1"
    assert not {name for name in ONE_THREAD if name.startswith("NUMBA")}


@pytest.fixture(autouse=True)
def on_cluster(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def same(_: Workers) -> Iterator[Any]:
        yield request.getfixturevalue("cluster")

    monkeypatch.setattr(batch_run, "connected", same)


def job(name: str, **arguments: object) -> Job:
    return Job(name=name, command="work", arguments=arguments)


def table(out: Path) -> dict[str, dict[str, Any]]:
    return {row["job"]: row for row in pq.read_table(out / "results.parquet").to_pylist()}


def run(jobs: list[Job], out: Path, **more: Any) -> BatchOutput:
    return run_batch(jobs, out, work, **more)


def test_every_job_has_its_folder_and_its_row(tmp_path: Path) -> None:
    jobs = [job(f"j{n}", n=n, at={"x_m": 0.5 * n}) for n in range(7)]
    jobs += [job("bad", refuse=1), job("lost", lose=1), job("crash", crash=1)]
    done = run(jobs, tmp_path / "out")
    assert done.statuses == {"done": 7, "refused": 1, "failed": 2}
    assert {one.job for one in done.not_done} == {"bad", "lost", "crash"}
    rows = table(tmp_path / "out")
    assert list(rows) == [one.name for one in jobs]
    assert [rows[f"j{n}"]["at.x_m"] for n in range(7)] == [0.5 * n for n in range(7)]
    assert (rows["bad"]["exit_code"], rows["bad"]["cure"], rows["bad"]["n"]) == (3, "Measure more", None)
    assert (rows["lost"]["exit_code"], rows["crash"]["exit_code"]) == (4, 1)
    assert "ValueError: nobody knows" in (tmp_path / "out" / "crash" / "result.json").read_text()
    assert rows["j1"]["out"] == str(tmp_path / "out" / "j1"), "not the folder that it ran in"
    assert (tmp_path / "out" / "j1" / "whole.txt").exists() and not (tmp_path / "out" / RUNNING).exists()


def test_a_job_whose_worker_is_killed_is_done_again_and_one_that_kills_three_is_done_by_one_as_its_cure_says(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of several workers that share the memory the system kills one: here they are told how many they are."""

    @contextmanager
    def counted(workers: Workers) -> Iterator[Any]:
        (tmp_path / "workers").write_text(str(workers.n))
        yield cluster

    monkeypatch.setattr(batch_run, "connected", counted)
    jobs = [job(f"j{n}", n=n) for n in range(6)]
    jobs[1:1] = [
        job("once", n=9, kill="once", mark=str(tmp_path / "mark")),
        job("large", kill="crowded", mark=str(tmp_path / "workers")),
    ]
    done = run(jobs, tmp_path / "out", workers=Workers(n=2))
    assert done.statuses == {"done": 7, "killed": 1}
    rows = table(tmp_path / "out")
    assert (rows["once"]["attempts"], rows["once"]["n"]) == (2, 9)
    assert (rows["large"]["attempts"], rows["large"]["status"]) == (3, "killed")
    assert "3 times" in rows["large"]["cause"] and "(--jobs)" in rows["large"]["cure"]
    assert not (tmp_path / "out" / "large" / "half.txt").exists()
    assert [(rows[f"j{n}"]["n"], rows[f"j{n}"]["status"]) for n in range(6)] == [(n, "done") for n in range(6)]
    done = run(jobs, tmp_path / "out", workers=Workers(n=1), resume=True)
    assert done.statuses == {"done": 8} and done.n_kept == 7


def test_resume_does_what_is_missing_changed_or_failed_by_chance(tmp_path: Path) -> None:
    rig, count = tmp_path / "rig.yaml", tmp_path / "count"
    rig.write_text("1")

    def jobs(n: int = 1) -> list[Job]:
        on_rig = Job(name="on-rig", command="work", arguments={"count": str(count)}, inputs=(str(rig), "no such file"))
        refused, lost = job("refused", refuse=1, count=str(count)), job("lost", lose=1, count=str(count))
        return [job("same", count=str(count)), job("told", n=n, count=str(count)), on_rig, refused, lost]

    def again(n: int = 1, **more: Any) -> list[str]:
        count.write_text("")
        done = run(jobs(n), tmp_path / "out", resume=True, **more)
        ran = sorted(count.read_text().split())
        assert done.n_kept == 5 - len(ran)
        return ran

    assert again() == ["lost", "on-rig", "refused", "same", "told"]
    assert again() == ["lost"]
    assert again(n=2) == ["lost", "told"]
    assert table(tmp_path / "out")["told"]["n"] == 2
    rig.write_text("2")
    assert again(n=2) == ["lost", "on-rig"]
    shutil.rmtree(tmp_path / "out" / "same")
    assert again(n=2) == ["lost", "same"]
    (tmp_path / "out" / "same" / "result.json").write_text('{"format": "armsight/batch-re')
    assert again(n=2) == ["lost", "same"]


class StopsAfter(Silent):
    def __init__(self, n: int) -> None:
        self.n, self.done = n, 0.0

    def update(self, done: float, total: float, note: str = "") -> None:
        self.done = done

    def cancelled(self) -> bool:
        return self.done >= self.n


def test_what_was_done_before_a_stop_is_in_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch_run, "MOST_IN_GROUP", 1)
    jobs = [job(f"j{n:03d}", n=n) for n in range(60)]
    with refuses(Cancelled, "of 60", "kept", "--resume"):
        run(jobs, tmp_path / "out", progress=StopsAfter(5))
    rows = table(tmp_path / "out")
    assert 5 <= len(rows) < 60 and all(row["status"] == "done" for row in rows.values())
    done = run(jobs, tmp_path / "out", resume=True)
    assert done.statuses == {"done": 60} and done.n_kept >= len(rows)
    assert [row["n"] for row in table(tmp_path / "out").values()] == list(range(60))


def test_a_full_disk_ends_the_batch_and_keeps_what_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch_run, "MOST_IN_GROUP", 1)
    jobs = [job("first"), job("full", full=1), *(job(f"j{n:03d}") for n in range(200))]
    with refuses(DeviceFailed, "no space", "'full'", "kept", "Make room"):
        run(jobs, tmp_path / "out")
    rows = table(tmp_path / "out")
    assert "full" not in rows and len(rows) < 200
    later = [Job(name=one.name, command="work") for one in jobs]
    assert run(later, tmp_path / "out", resume=True).statuses == {"done": 202}


def place_in(at: Path, **more: Any) -> Place:
    write_batch(at, "this", 1)
    return Place(**{"out": at, "shown": Path("shown"), "folder": Path.cwd(), "batch": "this"} | more)


def test_a_worker_of_other_software_or_without_the_folders_is_given_nothing(tmp_path: Path) -> None:
    for place, told in (
        (place_in(tmp_path, version="0.0.1"), "0.0.1"),
        (place_in(tmp_path, batch="another"), "does not see"),
        (place_in(tmp_path, out=tmp_path / "not-here"), "not-here"),
        (place_in(tmp_path, folder=tmp_path / "nor-this"), "nor-this"),
    ):
        with refuses(DeviceFailed, told):
            batch_work.run_group(work, place, [job("a")])
    assert batch_work.run_group(work, place_in(tmp_path), [job("a")])[0].status == "done"


def test_a_worker_that_was_taken_for_dead_does_not_replace_what_its_twin_has_done(tmp_path: Path) -> None:
    place, one = place_in(tmp_path), job("a", n=1)

    def overtaken(of: Job, folder: Path) -> Ended:
        assert batch_work.run_job(work, place, of).status == "done"
        assert not folder.exists(), "what is begun and not ended goes with the one that ends"
        raise DeviceFailed("its folder is gone")

    assert batch_work.run_job(overtaken, place, one).status == "done"
    told = (tmp_path / "a" / "result.json").read_text()
    assert '"done"' in told and '"attempts": 2' in told and (tmp_path / "a" / "whole.txt").exists()


def test_an_earlier_batch_is_left_alone_or_replaced_as_told(tmp_path: Path) -> None:
    out = tmp_path / "out"
    run([job("a"), job("b")], out)
    (out / "mine").mkdir()
    with refuses(UsageError, "batch", "--resume", "--overwrite"):
        run([job("a")], out)
    with refuses(UsageError, "--resume keeps"):
        run([job("a")], out, resume=True, overwrite=True)
    assert run([job("c")], out, overwrite=True).statuses == {"done": 1}
    assert {one.name for one in out.iterdir()} == {"c", "mine", "batch.json", "results.parquet"}
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").touch()
    for more in ({}, {"resume": True}, {"overwrite": True}):
        with refuses(UsageError, "other"):
            run([job("a")], tmp_path / "other", **more)
    with refuses(UsageError, "is a file"):
        run([job("a")], tmp_path / "other" / "thesis.tex")


@pytest.mark.parametrize(
    ("names", "told"),
    [
        ([], "no job"),
        (["a", "b", "a"], "1, 3"),
        (["a", "b", "A"], "1, 3"),
        (["\u00fc", "u\u0308"], "some disks"),
        ([""], "no name"),
        (["a/b"], "'/'"),
        ([".."], "dot"),
        (["CON.txt"], "Windows"),
        (["batch.json"], "the batch itself"),
        (["x" * 300], "too long"),
    ],
)
def test_names_that_cannot_be_folders(names: list[str], told: str) -> None:
    with refuses(UsageError, told):
        check_names([job(name) for name in names])


def test_no_password_of_an_argument_is_written(tmp_path: Path) -> None:
    secret = "postgresql://me:hidden@host/db"
    run([job("a", history=secret, words=[f"--history={secret}", "--n=3"])], tmp_path / "out")
    held = json.loads((tmp_path / "out" / "a" / "result.json").read_text())["arguments"]
    shown = "postgresql://me:***@host/db"
    assert held == {"history": shown, "words": [f"--history={shown}", "--n=3"]}


@pytest.mark.parametrize(
    "text", ["out/a/arm.yaml", "bag:out/a/run.bag:/camera", "out/*/arm.yaml", "out/b", "./out/../out/a"]
)
def test_a_job_that_reads_what_another_of_the_batch_writes_is_refused(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    jobs = [job("a"), Job(name="b", command="work", inputs=(text,))]
    with refuses(UsageError, "'b'", text, "no order"):
        run(jobs, Path("out"))
    check_inputs(jobs, Path("elsewhere"))
    check_inputs([jobs[0], Job(name="b", command="work", inputs=("out", "a", "out/c/arm.yaml"))], Path("out"))


def test_columns_keep_one_type_whatever_their_rows_hold(tmp_path: Path) -> None:
    rows: list[Mapping[str, object]] = [
        {"whole": 1, "number": 1, "list": [], "mixed": 1, "texts": ["a"], "flag": True, "deep": [{"a": 1}]},
        {"whole": None, "number": 0.5, "list": [1, None, 2.5], "mixed": "b", "flag": False, "late": 3},
        {"whole": 2**70},
    ]
    assert write_result_table(tmp_path / "t.parquet", lambda: rows[:2]) == 2
    read = pq.read_table(tmp_path / "t.parquet")
    types = {name: str(kind) for name, kind in zip(read.schema.names, read.schema.types, strict=True)}
    assert (types["whole"], types["number"], types["mixed"], types["late"]) == ("int64", "double", "string", "int64")
    assert types["list"].startswith("list") and "double" in types["list"] and "string" in types["texts"]
    assert read.to_pylist()[1]["list"] == [1.0, None, 2.5] and read.to_pylist()[0]["mixed"] == "1"
    assert read.to_pylist()[0]["deep"] == '[{"a": 1}]'
    write_result_table(tmp_path / "t.parquet", lambda: rows)
    assert pq.read_table(tmp_path / "t.parquet")["whole"].to_pylist()[2] == float(2**70)
    assert write_result_table(tmp_path / "t.parquet", list) == 0


def figures_of(folder: Path | None = None, *, out: Path, value: float = 1.0) -> dict[str, object]:
    return {"out": str(out), "value": value}


def test_a_function_of_python_gets_the_jobs_folder_and_gives_its_figures(tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    made = _job("a", "armsight.ops.measure.measure", {"rig": rig, "value": 2.0, "many": [rig, "x"]})
    assert (made.command, made.inputs) == ("measure.measure", (str(rig), str(rig), "x"))
    ended = call(figures_of, job("a", value=2.0), tmp_path)
    assert ended.figures == {"out": str(tmp_path), "value": 2.0}
    with refuses(UsageError, "int", "dictionary"):
        call(lambda: 3, job("a"), tmp_path)
    with refuses(UsageError, "rig", "'a'", "object", "path"):
        _job("a", "measure", {"rig": object()})
