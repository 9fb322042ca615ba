"""The history's database: the same class of tests over SQLite and over a PostgreSQL that the tests start themselves."""

import contextlib
import json
import os
import pwd
import shutil
import signal
import socket
import sqlite3
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import select, text

import histories
import warm_python
from armsight.errors import BadFile, DeviceFailed, DeviceNotFound, UsageError
from armsight_lab.history import database, queries
from armsight_lab.history.adding import file_entry
from armsight_lab.history.database import HEAD, reading, writing
from armsight_lab.history.place import Place, place_of
from armsight_lab.history.queries import Filter
from refusals import refuses

POSTGRES = sorted(Path("/usr/lib/postgresql").glob("*/bin"))
PASSWORD = "s3cret:/@word"
QUOTED = "s3cret%3A%2F%40word"


@pytest.fixture(scope="session")
def server() -> Iterator[str]:
    """A PostgreSQL on a free port of this machine, its data in a folder of its own; yields its URL."""
    if not POSTGRES:
        pytest.skip("PostgreSQL's server is not installed (Debian: apt-get install postgresql)")
    folder = Path(tempfile.mkdtemp(prefix="pg", dir="/tmp"))
    user: dict[str, int] = {}
    if os.geteuid() == 0:  # it refuses to run as root
        who = pwd.getpwnam("postgres")
        os.chown(folder, who.pw_uid, who.pw_gid)
        user = {"user": who.pw_uid, "group": who.pw_gid}
    secret = folder / "secret"
    secret.write_text(PASSWORD)
    secret.chmod(0o644)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    data = folder / "data"
    words = ["-D", data, "-U", "armsight", "-A", "scram-sha-256", f"--pwfile={secret}", "-E", "UTF8", "--no-sync"]
    options = f"-c listen_addresses=127.0.0.1 -c port={port} -c unix_socket_directories={folder} -c fsync=off"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder, **user}
    try:
        subprocess.run([POSTGRES[-1] / "initdb", *words], check=True, **quiet)
        start = [POSTGRES[-1] / "pg_ctl", "-D", data, "-w", "-t", "60", "-l", folder / "log"]
        subprocess.run([*start, "-o", options, "start"], check=True, **quiet)
        yield f"postgresql://armsight:{QUOTED}@127.0.0.1:{port}"
    finally:
        subprocess.run([POSTGRES[-1] / "pg_ctl", "-D", data, "-m", "immediate", "stop"], check=False, **quiet)
        shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(params=["sqlite", "postgresql"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Place:
    """A history that is not there yet."""
    if request.param == "sqlite":
        return place_of(str(tmp_path / "folder" / "history.sqlite"))
    base = request.getfixturevalue("server")
    name = f"h{abs(hash(request.node.nodeid)):x}"
    _on_server(base, f'CREATE DATABASE "{name}"')
    return place_of(f"{base}/{name}")


def _on_server(base: str, order: str) -> None:
    from sqlalchemy import create_engine

    engine = create_engine(place_of(f"{base}/postgres").url, isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        connection.execute(text(order))
    engine.dispose()


WRITER = """
import sys
import histories
from armsight_lab.history.adding import file_entry
from armsight_lab.history.place import place_of
place = place_of(sys.argv[1])
for entry in histories.runs(sys.argv[2], 1000, seed=int(sys.argv[3])):
    print(file_entry(place, entry).run, flush=True)
    if not sys.stdin.readline():
        break
"""


class TestDatabase:
    """What both kinds of database do."""

    def test_a_run_comes_back_as_it_was_filed(self, place: Place):
        entry = next(histories.runs("Zelle \N{SNOWMAN} '\"; DROP TABLE runs; --", 1))
        filed = file_entry(place, entry)
        assert filed.new
        with reading(place) as connection:
            run = queries.one(connection, filed.run)
            assert run is not None
            assert (run.cell, run.command, run.created, run.arm, run.joints) == (
                entry.cell,
                "calibrate arm",
                entry.created,
                entry.arm,
                "RRRRRR",
            )
            by_name = {one.name: one for one in queries.parameters_of(connection, [run.id])[run.id]}
            assert by_name == {one.name: one for one in entry.parameters}
            figures = {one.name: one.value for one in queries.figures_of(connection, [run.id])[run.id]}
            assert figures == {"n": 60.0, "after.rms_m": 7e-5}
            held = connection.execute(select(queries.runs.c.result).where(queries.runs.c.id == run.id)).scalar_one()
            assert json.loads(held) == entry.result

    def test_poses_come_back_and_the_same_run_is_filed_once(self, place: Place):
        from scipy.spatial.transform import Rotation

        entry = histories.handeye_run("c", (0.1, 0.2, 0.3), Rotation.from_rotvec([0.1, 0.2, 3.0]), histories.START)
        first, again = file_entry(place, entry), file_entry(place, entry)
        assert (first.new, again.new, again.run) == (True, False, first.run)
        with reading(place) as connection:
            assert queries.poses_of(connection, [first.run])[first.run] == list(entry.poses)
            assert queries.count(connection, Filter()) == 1

    def test_filters_and_order(self, place: Place):
        for entry in (*histories.runs("a", 4), *histories.runs("b", 2, seed=1)):
            file_entry(place, entry)
        with reading(place) as connection:
            of_a = queries.newest(connection, Filter(cell="a"))
            assert [one.created for one in of_a] == sorted((one.created for one in of_a), reverse=True)
            assert len(of_a) == 4
            assert queries.count(connection, Filter(command="calibrate")) == 6
            assert queries.count(connection, Filter(command="calib")) == 0
            assert queries.count(connection, Filter(since=of_a[1].created)) == 2
            assert queries.count(connection, Filter(until=of_a[1].created)) == 4
            assert queries.cells(connection) == ["a", "b"]

    def test_a_run_is_filed_whole_or_not_at_all(self, place: Place, monkeypatch: pytest.MonkeyPatch):
        entries = list(histories.runs("a", 2))
        file_entry(place, entries[0])

        def fail(*_: object) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(queries, "_pose_row", fail)
        monkeypatch.setattr(queries, "_fill", fail)
        with pytest.raises(KeyboardInterrupt):
            file_entry(place, entries[1])
        monkeypatch.undo()
        with reading(place) as connection:
            assert queries.count(connection, Filter()) == 1

    def test_an_older_schema_is_brought_up_to_date_and_a_newer_one_refused(
        self, place: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ):
        """By an armsight of tomorrow, which knows one schema more."""
        filed = file_entry(place, next(histories.runs("a", 1)))
        tomorrow = tmp_path / "migrations"
        shutil.copytree(database.MIGRATIONS, tomorrow)
        (tomorrow / "versions" / "s9999_more.py").write_text(
            "import sqlalchemy as sa\nfrom alembic import op\n"
            f"revision, down_revision = '9999', '{HEAD}'\nbranch_labels = depends_on = None\n"
            "def upgrade():\n    op.add_column('runs', sa.Column('more', sa.Text))\n"
        )
        monkeypatch.setattr(database, "MIGRATIONS", tomorrow)
        monkeypatch.setattr(database, "HEAD", "9999")
        with reading(place) as connection:
            assert connection.execute(text("SELECT id, more FROM runs")).all() == [(filed.run, None)]
        monkeypatch.undo()
        with refuses(BadFile, "9999", HEAD, "Update"), reading(place):
            pass
        with refuses(BadFile, "9999"):
            file_entry(place, next(histories.runs("b", 1)))

    def test_writers_at_once_and_one_killed_lose_nothing_that_was_acknowledged(self, place: Place):
        """Each writes on as soon as it is told to; one is killed in the middle of whatever it does then."""
        url = place.url.replace("+pg8000", "") if place.path is None else str(place.path)
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        words = [[warm_python.commands() / "python", "-c", WRITER, url, f"cell {i}", str(i)] for i in range(2)]
        tests = Path(__file__).parents[2]  # where histories.py is
        writers = [subprocess.Popen(each, cwd=tests, **pipes) for each in words]
        acknowledged: list[int] = []
        for turn in range(4):
            for writer in writers:
                if writer.poll() is None:
                    acknowledged.append(int(writer.stdout.readline()))
                    with contextlib.suppress(BrokenPipeError):
                        writer.stdin.write("on\n")
                        writer.stdin.flush()
            if turn == 1:
                writers[0].send_signal(signal.SIGKILL)
                writers[0].wait()
                acknowledged += [int(one) for one in writers[0].stdout.read().split()]  # what it had said before
                writers[0].stdout.close()
                writers[0].stdin.close()
        for writer in writers[1:]:
            acknowledged += [int(one) for one in writer.communicate()[0].split()]
            assert writer.returncode == 0
        with reading(place) as connection:
            there = [one.id for one in queries.newest(connection, Filter())]
            assert set(acknowledged) <= set(there)
            assert len(set(acknowledged)) == len(acknowledged) >= 2 * 2 + 1 * 3
            parameters = queries.parameters_of(connection, there)
            assert all(len(parameters[one]) == 30 for one in there)
        if place.path is not None:
            with contextlib.closing(sqlite3.connect(place.path)) as checked:
                assert checked.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
                assert checked.execute("PRAGMA foreign_key_check").fetchall() == []


def test_a_wrong_password_host_and_database_are_told_without_the_password(server: str):
    right = f"{server}/postgres"
    port = server.rpartition(":")[2]
    wrong = {
        right.replace(QUOTED, "hunter2"): (DeviceFailed, "armsight"),
        right.replace(f":{port}", ":1"): (DeviceNotFound, "127.0.0.1:1"),
        f"{server}/nowhere": (DeviceNotFound, "nowhere"),
    }
    for url, (kind, name) in wrong.items():
        with pytest.raises(kind) as told:
            file_entry(place_of(url), next(histories.runs("a", 1)))
        assert name in str(told.value)
        assert "hunter2" not in str(told.value)
        assert QUOTED not in str(told.value)
        assert PASSWORD not in str(told.value)


@pytest.mark.parametrize(
    ("content", "names"),
    [(b"not a database, but long enough to look like a file of one " * 40, "history.sqlite"), (None, "history.sqlite")],
)
def test_a_file_that_is_none_or_cut_off_is_refused_and_left(tmp_path: Path, content: bytes | None, names: str):
    path = tmp_path / "history.sqlite"
    place = place_of(str(path))
    if content is None:
        for entry in histories.runs("a", 12):
            file_entry(place, entry)
        with contextlib.closing(sqlite3.connect(path)) as held:
            held.execute("PRAGMA journal_mode=DELETE")
        content = path.read_bytes()[:20_000]
    path.write_bytes(content)
    with refuses(BadFile, names):
        file_entry(place, next(histories.runs("b", 1)))
    with refuses(BadFile, names), reading(place) as connection:
        queries.newest(connection, Filter())
    assert path.read_bytes() == content


def test_a_database_of_another_program_a_folder_and_nothing_are_refused(tmp_path: Path):
    other = tmp_path / "other.sqlite"
    with contextlib.closing(sqlite3.connect(other)) as held:
        held.execute("CREATE TABLE bookmarks (url TEXT)")
    with refuses(BadFile, "bookmarks"):
        file_entry(place_of(str(other)), next(histories.runs("a", 1)))
    with refuses(UsageError, "folder"):
        file_entry(place_of(str(tmp_path)), next(histories.runs("a", 1)))
    with refuses(UsageError, "--cell"), reading(place_of(str(tmp_path / "none.sqlite"))):
        pass
    assert not (tmp_path / "none.sqlite").exists()
    with refuses(DeviceFailed, "/proc/none/history.sqlite"):
        file_entry(place_of("/proc/none/history.sqlite"), next(histories.runs("a", 1)))


def test_a_database_that_another_holds_is_told_after_a_while(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    place = place_of(str(tmp_path / "history.sqlite"))
    file_entry(place, next(histories.runs("a", 1)))
    monkeypatch.setattr(database, "BUSY_S", 0.01)
    with contextlib.closing(sqlite3.connect(place.path, isolation_level=None)) as holder:
        holder.execute("BEGIN IMMEDIATE")
        with refuses(DeviceFailed, "held"):
            file_entry(place, next(histories.runs("b", 1)))
        with reading(place) as connection:  # readers need not wait for it
            assert queries.count(connection, Filter()) == 1
    other = sqlite3.connect(place.path, timeout=0.0, isolation_level=None)
    with contextlib.closing(other), writing(place), pytest.raises(sqlite3.OperationalError):
        other.execute("BEGIN IMMEDIATE")  # held from its beginning: else of two that read first one fails
