"""armsight batch: its jobs are the commands themselves, and what cannot be is refused before the first begins."""

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from armsight.errors import BadFile, DeviceFailed, NotEnoughData, UsageError
from armsight.ops import compilation
from armsight_lab.batch import cluster as batch_cluster
from armsight_lab.batch import run as batch_run
from armsight_lab.batch.cluster import Workers, connected
from armsight_lab.batch.jobs import Job
from armsight_lab.cli.batch_commands import NOBODY, OUTPUTS, checked_job, parameters, run_command
from armsight_lab.cli.batch_jobs import jobs_of_file, jobs_of_pattern
from refusals import refuses

NO_SETTINGS: dict[str, object] = {"fps": None, "max_skew_s": None}


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with connected(Workers(n=1)) as client:
        yield client


@pytest.fixture
def on_cluster(cluster: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def same(_: Workers) -> Iterator[Any]:
        yield cluster

    monkeypatch.setattr(batch_run, "connected", same)


def joints(path: Path, n: int = 2) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("t_s,q1,q2,q3,q4,q5,q6\n" + "".join(f"{k},0.{k},0,0,0,0.1,0\n" for k in range(n)))
    return path


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
@pytest.mark.usefixtures("on_cluster")
def test_each_job_gives_what_its_command_gives(armsight: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, n in (("first", 2), ("second", 3)):
        joints(tmp_path / "runs" / f"{name}.csv", n)
    (tmp_path / "runs" / "third.csv").write_text("t_s,q1\n0,nan\n")
    words = ["kinematics", "fk", "--arm", "ur10", "--joints"]
    done = armsight("batch", "--json", "--each", "runs/*.csv", "-o", "out", "--", *words, "{}")
    assert done.code == 3, done.text
    assert done.json["statuses"] == {"done": 2, "refused": 1}
    assert "third: refused" in done.text
    rows = {row["job"]: row for row in pq.read_table("out/results.parquet").to_pylist()}
    assert list(rows) == ["first", "second", "third"]
    for name in rows:
        alone = armsight(*words, f"runs/{name}.csv", "-o", "alone.csv")
        told = json.loads((tmp_path / "out" / name / "result.json").read_text())
        assert rows[name]["exit_code"] == alone.code
        if alone.code:
            assert (rows[name]["cause"], told["error"]) == (alone.json["error"]["cause"], alone.json["error"])
            continue
        same = {key: value for key, value in alone.json.items() if key != "file"}
        assert same == {key: value for key, value in told["result"].items() if key != "file"}
        assert (tmp_path / "out" / name / "poses.csv").read_bytes() == (tmp_path / "alone.csv").read_bytes()
        assert "poses of" in told["said"] and ".running" not in json.dumps(told)
    again = armsight("batch", "--json", "--each", "runs/*.csv", "-o", "out", "--resume", "--", *words, "{}")
    assert again.json["n_kept"] == 3


def job(folder: Path, *words: str, command: str = "kinematics fk") -> Job:
    return checked_job("a", command, words, NO_SETTINGS, "row")


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
@pytest.mark.usefixtures("on_cluster")
def test_a_command_that_ends_in_a_crash_or_without_memory_ends_its_job_alone(
    armsight: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = job(tmp_path, "--arm", "ur10", "--joints", str(joints(tmp_path / "joints.csv")))
    assert one.inputs == ("ur10", str(tmp_path / "joints.csv"))

    for raised, code, told in ((MemoryError(), 4, "memory"), (ValueError("nobody knows"), 1, "nobody knows")):

        def fails(*given: object, raised: Exception = raised, **more: object) -> None:
            raise raised

        monkeypatch.setattr("armsight.ops.kinematics_results.read_values", fails)
        ended = run_command(one, tmp_path)
        assert ended.exit_code == code and ended.error is not None and told in ended.error.cause
        assert ("fewer workers (--jobs)" in ended.error.cure) == (code == 4)
    assert "Traceback" in ended.said
    monkeypatch.undo()
    words = ["kinematics", "fk", "--arm", "ur10", "--joints", "{}"]
    at = ["--each", str(tmp_path / "joints.csv"), "-o", tmp_path / "out"]
    assert armsight("batch", "--json", "--jobs", "1", *at, "--", *words).json["statuses"] == {"done": 1}


def test_every_command_of_a_batch_is_one_and_says_what_moves() -> None:
    for command in OUTPUTS:
        assert parameters(command), command
    assert "robot" in NOBODY
    for command, words in (("verify", ("--live",)), ("identify", ("--live", "sim:x"))):
        with refuses(UsageError, command, "--live", "a person"):
            checked_job("a", command, words, NO_SETTINGS, "row 1")


def test_what_is_compiled_ahead_is_of_commands_groups_and_folders_that_there_are() -> None:
    for command, (folder, groups) in batch_cluster.GROUPS.items():
        assert command in OUTPUTS and set(groups) <= set(compilation.GROUPS), command
        sources = (batch_cluster.PACKAGE / folder).rglob("*.py")
        assert any(re.search(r"^@(fast_|sum_|parallel_)?kernel", path.read_text(), re.MULTILINE) for path in sources)


CSV = "name,command,arm,joints,as-stated\n"


def written(folder: Path, text: str, name: str = "jobs.csv") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_jobs_are_read_from_csv_and_yaml_alike(tmp_path: Path) -> None:
    table = written(tmp_path, CSV + 'a,kinematics fk,ur10,j.csv,true\n\nb,kinematics fk,"my arm.yaml",k.csv,\n')
    text = """\
format: armsight/jobs
version: 1
defaults: {command: kinematics fk, arm: ur10}
jobs:
  - {name: a, joints: j.csv, as_stated: true}
  - {name: b, arm: my arm.yaml, joints: k.csv}
"""
    of_table = jobs_of_file(table, NO_SETTINGS)
    of_yaml = jobs_of_file(written(tmp_path, text, "jobs.yaml"), NO_SETTINGS)
    assert [(one.name, one.command, set(one.inputs)) for one in of_table] == [
        (one.name, one.command, set(one.inputs)) for one in of_yaml
    ]
    assert of_table[0].arguments["words"] == ["--arm=ur10", "--joints=j.csv", "--as-stated"]
    simulated = written(tmp_path, "name,command,scenario,seed,out\ns,simulate,hand-cell,-1,\n", "seeds.csv")
    with refuses(UsageError, "seeds.csv", "line 2", "'s'", "--seed"):
        jobs_of_file(simulated, NO_SETTINGS)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("", ("empty",)),
        (CSV, ("no job",)),
        ("name,arm\na,ur10\n", ("command", "missing")),
        ("name;command;arm\na;kinematics fk;ur10\n", ("semicolons", "CSV")),
        ("name,command,arm,arm\na,b,c,d\n", ("'arm'", "twice")),
        (CSV + "a,kinematics fk\n", ("line 2", "2 cells")),
        (CSV + "a,,ur10,j.csv,\n", ("line 2", "no command")),
        (CSV + "a,kinematics fk,ur10,j.csv,perhaps\n", ("line 2", "as-stated", "'perhaps'")),
        ("name,command,arm,jonts\na,kinematics fk,ur10,j.csv\n", ("line 2", "'a'", "'jonts'", "'joints'", "arm")),
    ],
)
def test_a_csv_of_jobs_that_cannot_be(text: str, names: tuple[str, ...], tmp_path: Path) -> None:
    with refuses(BadFile, "jobs.csv", names):
        jobs_of_file(written(tmp_path, text), NO_SETTINGS)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("", ("empty",)),
        ("jobs: [", ("line 1",)),
        ("format: armsight/rig\njobs: []", ("armsight/rig",)),
        ("version: 2\njobs: []", ("version 2",)),
        ("job: []", ("'job'", "'jobs'")),
        ("jobs: [a]", ("job 1", "'a'", "no mapping")),
        ("jobs: [{name: a, command: measure, rig: {x: 1}}]", ("job 1", "'rig'")),
        ("jobs: [{name: a, command: measure, rig: true}]", ("job 1", "rig", "true")),
    ],
)
def test_a_yaml_of_jobs_that_cannot_be(text: str, names: tuple[str, ...], tmp_path: Path) -> None:
    with refuses(BadFile, "jobs.yaml", names):
        jobs_of_file(written(tmp_path, text, "jobs.yaml"), NO_SETTINGS)


@pytest.mark.parametrize(
    ("command", "names"),
    [("serve", ("'serve'", "not for batches", "measure", "verify")), ("mesure", ("'mesure'", "'measure'"))],
)
def test_a_command_that_is_not_for_batches_is_refused_with_the_choices(
    command: str, names: tuple[str, ...], tmp_path: Path
) -> None:
    with refuses(UsageError, "line 2", "'a'", names):
        jobs_of_file(written(tmp_path, f"name,command\na,{command}\n"), NO_SETTINGS)


WORDS = ["kinematics", "fk", "--arm", "ur10", "--joints", "{}"]


@pytest.mark.parametrize(
    ("pattern", "name", "words", "kind", "names"),
    [
        ("runs/*.mcap", "{name}", WORDS, NotEnoughData, ("runs/*.mcap", "quotes")),
        ("runs/*", "{nme}", WORDS, UsageError, ("nme", "name", "number")),
        ("runs/*", "{name}", [*WORDS[:-1], "j.csv"], UsageError, ("2 files", "same")),
        ("runs/*", "{name}", [*WORDS, "--jonts", "x"], UsageError, ("--jonts", "--joints")),
        ("runs/*", "{name}", WORDS[:-2], UsageError, ("2 files",)),
        ("runs/2.csv", "{name}", WORDS[:-2], UsageError, ("--joints", "missing")),
        ("runs/*", "{name}", [*WORDS, "-o", "../x.csv"], UsageError, ("../x.csv", "poses.csv")),
        ("runs/*", "{name}", ["measure", "{}", "--help"], UsageError, ("--help",)),
    ],
)
def test_a_pattern_or_template_that_cannot_be(
    pattern: str,
    name: str,
    words: list[str],
    kind: type[Exception],
    names: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    for one in ("2", "10"):
        joints(tmp_path / "runs" / f"{one}.csv")
    with refuses(kind, names):
        jobs_of_pattern(pattern, name, words, NO_SETTINGS)
    found = jobs_of_pattern("runs/*", "{parent}-{number}-{name}", [*WORDS, "-o", "p.csv"], NO_SETTINGS)
    assert [one.name for one in found] == ["runs-1-2", "runs-2-10"]
    assert "runs/10.csv" in found[1].inputs


def test_what_is_asked_must_be_one_thing(armsight: Any, tmp_path: Path) -> None:
    out = ("-o", tmp_path / "out")
    for words in (
        (),
        ("a.csv", "b.csv"),
        ("a.csv", "--name", "{parent}"),
        ("--each", "*.csv"),
        ("a.csv", "--jobs", 2, "--scheduler", "tcp://there:8786"),
        ("--each", str(tmp_path), "--scheduler", "nowhere", "--", "kinematics", "show", "--arm", "{}"),
    ):
        done = armsight("batch", "--json", *out, *words)
        assert done.code == 2 and done.json["error"]["cure"], words
    assert not (tmp_path / "out").exists()


class Scheduler:
    """What a scheduler says of itself."""

    def __init__(self, python: str, distributed: str) -> None:
        self._said = {"packages": {"python": python, "distributed": distributed}}

    def get_versions(self) -> Any:
        return {"scheduler": self._said, "workers": {"tcp://w:1": self._said}, "client": self._said}


def test_a_scheduler_that_is_not_there_or_of_other_software_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    from importlib.metadata import version
    from platform import python_version

    monkeypatch.setattr(batch_cluster, "CONNECT_S", 0.2)
    with (
        refuses(DeviceFailed, "tcp://127.0.0.1:1", "dask scheduler"),
        connected(Workers(scheduler="tcp://127.0.0.1:1")),
    ):
        pass
    own = version("distributed")
    batch_cluster._require_same_versions(Scheduler(python_version(), own), "there")  # type: ignore[arg-type]
    for other in (Scheduler("3.8.1.final.0", own), Scheduler(python_version(), "2020.1.0")):
        with refuses(DeviceFailed, "there", own, "lock file"):
            batch_cluster._require_same_versions(other, "there")  # type: ignore[arg-type]
