"""The tables, public and described in docs/file-formats.md: a change of them is a migration, and HEAD its name."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

from sqlalchemy import (
    Boolean,
    Column,
    Connection,
    Engine,
    Float,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    create_engine,
    event,
    exc,
    inspect,
    text,
)
from sqlalchemy.pool import NullPool

from armsight._files import real_path
from armsight.columns import POSE6_STD, POSE7
from armsight.errors import ArmsightError, BadFile, DeviceFailed, DeviceNotFound, UsageError
from armsight_lab.history.place import Place, require_packages

HEAD = "0001"
"""The schema that this armsight reads and writes: the last file of `migrations/versions`."""
VERSION_TABLE = "armsight_history_version"

metadata = MetaData()

runs = Table(
    "runs",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=True),
    Column("cell", String(100), nullable=False),
    Column("command", String(40), nullable=False),
    Column("created", String(32), nullable=False),
    Column("filed", String(32), nullable=False),
    Column("software", String(60), nullable=False),
    Column("verdict", Text, nullable=False),
    Column("trusted", Boolean, nullable=False),
    Column("exit_code", Integer, nullable=False),
    Column("reason", Text, nullable=False),
    Column("arm", String(200), nullable=False),
    Column("joints", String(60), nullable=False),
    Column("fingerprint", String(64), nullable=False, unique=True),
    Column("result", Text, nullable=False),
    Index("runs_by_cell", "cell", "created"),
    Index("runs_by_time", "created"),
)

inputs = Table(
    "inputs",
    metadata,
    Column("run_id", ForeignKey("runs.id"), primary_key=True),
    Column("flag", String(60), primary_key=True),
    Column("path", String(1000), primary_key=True),
    Column("sha256", String(64)),
)


def _quantities(name: str) -> Table:
    return Table(
        name,
        metadata,
        Column("run_id", ForeignKey("runs.id"), primary_key=True),
        Column("name", String(200), primary_key=True),
        Column("value", Float(53)),
        Column("std", Float(53)),
        Column("unit", String(16), nullable=False),
    )


figures, parameters = _quantities("figures"), _quantities("parameters")


poses = Table(
    "poses",
    metadata,
    Column("run_id", ForeignKey("runs.id"), primary_key=True),
    Column("name", String(200), primary_key=True),
    *(Column(name, Float(53), nullable=False) for name in POSE7),
    *(Column(name, Float(53)) for name in POSE6_STD),
)


BUSY_S = 30.0
"""How long a writer waits for others: each holds the database for some milliseconds."""
CONNECT_S = 10.0
"""How long a server may take to answer."""
MIGRATIONS = Path(__file__).with_name("migrations")
MIGRATING = 7_261_044_101
"""Key of the lock under which one process at a time changes the schema on a server."""
SHARED = ("nfs", "nfs4", "cifs", "smb3", "smbfs", "9p", "fuse.sshfs", "afs", "ceph", "glusterfs", "fuse.glusterfs")
"""File systems of a network, on which several machines have no memory in common, as SQLite's write-ahead log needs."""
KEPT = "What is in it stays as it is"


@contextlib.contextmanager
def reading(place: Place) -> Iterator[Connection]:
    """Open a history that is there. Raises UsageError where none is, BadFile, DeviceFailed."""
    require_packages(place)
    if place.path is not None and not place.path.exists():
        raise UsageError(
            f"there is no history at {place}",
            consequence="Nothing was done",
            cure="File a run with --cell NAME, or say where the history is (--history, ARMSIGHT_HISTORY)",
        )
    with _told(place):
        with _engine(place, write=False).begin() as connection:
            outdated = _version(connection, place) != HEAD
        if outdated:
            with writing(place):
                pass
        with _engine(place, write=False).begin() as connection:
            yield connection


@contextlib.contextmanager
def writing(place: Place) -> Iterator[Connection]:
    """Open a history for one transaction, and make it where there is none; what is written counts once this ends.

    Raises UsageError, BadFile, DeviceFailed.
    """
    require_packages(place)
    with _told(place):
        if place.path is not None:
            place.path.parent.mkdir(parents=True, exist_ok=True)
        with _engine(place, write=True).begin() as connection:
            if _version(connection, place) != HEAD:
                _migrate(connection, place)
            yield connection


def _engine(place: Place, *, write: bool) -> Engine:
    if place.path is None:
        engine = create_engine(place.url, poolclass=NullPool, connect_args={"timeout": CONNECT_S}, hide_parameters=True)
        begin = f"SET LOCAL lock_timeout = '{BUSY_S:.0f}s'"
    else:
        connect = _writer(place.path) if write else _reader(place.path)
        engine = create_engine("sqlite://", poolclass=NullPool, creator=connect, hide_parameters=True)
        # a transaction that will write takes the lock at its beginning: one that reads first could not get it later
        begin = "BEGIN IMMEDIATE" if write else "BEGIN"

    @event.listens_for(engine, "begin")
    def begun(connection: Connection) -> None:
        connection.exec_driver_sql(begin)

    return engine


def _writer(path: Path) -> Callable[[], sqlite3.Connection]:
    def connect() -> sqlite3.Connection:
        connection = _opened(path, "mode=rwc")
        # readers and one writer at once. Two that change the mode at once do not wait for each other: one is enough
        with contextlib.suppress(sqlite3.OperationalError):
            mode = "DELETE" if on_network(path) else "WAL"
            if connection.execute("PRAGMA journal_mode").fetchone()[0].upper() != mode:
                connection.execute(f"PRAGMA journal_mode={mode}")
        connection.execute("PRAGMA synchronous=FULL")  # what was acknowledged outlives a power cut
        connection.execute("PRAGMA foreign_keys=ON")
        return connection

    return connect


def _reader(path: Path) -> Callable[[], sqlite3.Connection]:
    def connect() -> sqlite3.Connection:
        connection = _opened(path, "mode=ro")
        try:
            connection.execute("SELECT name FROM sqlite_master LIMIT 1")
        except sqlite3.OperationalError:
            log = path.with_name(f"{path.name}-wal")
            connection.close()
            if log.exists() and log.stat().st_size:
                raise
            # in a place where nothing may be written its shared memory cannot be made, nor is it needed
            connection = _opened(path, "mode=ro&immutable=1")
        return connection

    return connect


def _opened(path: Path, how: str) -> sqlite3.Connection:
    # isolation_level: SQLAlchemy begins transactions, not Python
    return sqlite3.connect(f"file:{quote(str(real_path(path)))}?{how}", uri=True, timeout=BUSY_S, isolation_level=None)


def on_network(path: Path) -> bool:
    """Tell whether a file is on a file system of a network, where the system says which they are."""
    found = ("", "")
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/mounts").read_text(encoding="utf-8", errors="replace").splitlines():
            _, point, kind, *_ = line.split(" ")
            if real_path(path).is_relative_to(point) and len(point) >= len(found[0]):
                found = (point, kind)
    return found[1] in SHARED


def _version(connection: Connection, place: Place) -> str | None:
    """Return the schema's name, None of a new database. Raises BadFile for one of another program."""
    tables = inspect(connection).get_table_names()
    if VERSION_TABLE in tables:
        found = connection.execute(text(f"SELECT version_num FROM {VERSION_TABLE}")).scalar()
        return None if found is None else str(found)
    if tables and place.path is not None:
        raise BadFile(
            f"{place} is a database of another program (its tables: {', '.join(sorted(tables)[:4])})",
            consequence=f"Nothing was done. {KEPT}",
            cure="Give another file with --history",
        )
    return None


def _migrate(connection: Connection, place: Place) -> None:
    """Bring the schema up to date, one process at a time. Raises BadFile for one that is not known here."""
    from alembic.config import Config  # takes as long as the rest, and is seldom needed
    from alembic.runtime.environment import EnvironmentContext
    from alembic.script import ScriptDirectory

    if place.path is None:
        connection.execute(text(f"SELECT pg_advisory_xact_lock({MIGRATING})"))
    version = _version(connection, place)
    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS))
    script = ScriptDirectory.from_config(config)
    known = {one.revision for one in script.walk_revisions()}
    if version is not None and version not in known:
        raise BadFile(
            f"the history at {place} has the schema {version} of a newer armsight; this one knows up to {HEAD}",
            consequence=f"Nothing was done. {KEPT}",
            cure="Update armsight, or give another place with --history",
        )

    def steps(revision: Any, context: Any) -> Any:
        return script._upgrade_revs("head", revision)  # what Alembic's own command `upgrade` hands over

    with EnvironmentContext(config, script, fn=steps) as environment:
        environment.configure(connection=connection, version_table=VERSION_TABLE, transactional_ddl=True)
        environment.run_migrations()


@contextlib.contextmanager
def _told(place: Place) -> Iterator[None]:
    """Turn what the database says into our errors."""
    try:
        yield
    except ArmsightError:
        raise
    except exc.SQLAlchemyError as error:
        raise _refused(place, error) from None  # its text may hold what was bound, and the URL
    except sqlite3.Error as error:
        raise _of_file(place, str(error)) from None
    except OSError as error:
        raise _failed(place, error.strerror or str(error)) from None


def _refused(place: Place, error: exc.SQLAlchemyError) -> ArmsightError:
    cause = getattr(error, "orig", None)
    if isinstance(error, exc.ArgumentError):
        return UsageError(
            f"{place} is no URL of a database",
            consequence="Nothing was done",
            cure="Give a file (SQLite), or postgresql://USER:PASSWORD@HOST/DATABASE",
        )
    if place.path is not None:
        return _of_file(place, str(cause or error))
    told = cause.args[0] if cause is not None and cause.args else str(cause or error)
    code = told.get("C", "") if isinstance(told, dict) else ""
    said = str(told.get("M", "")) if isinstance(told, dict) else str(told)
    if code in ("28P01", "28000"):
        return DeviceFailed(
            f"{place}: the server does not let this user in ({said})",
            consequence="Nothing was filed or read",
            cure="Check user and password in the URL; a password's : / @ are written %3A %2F %40",
        )
    if code == "3D000":
        return DeviceNotFound(
            f"{place}: {said}", consequence="Nothing was filed or read", cure="Make it: createdb NAME"
        )
    if code == "55P03":
        return _locked(place)
    if isinstance(error, exc.InterfaceError) or not code:
        return DeviceNotFound(
            f"{place}: the server does not answer",
            consequence="Nothing was filed or read",
            cure="Check host and port, and that PostgreSQL runs and listens there",
        )
    return _failed(place, said)


def _of_file(place: Place, said: str) -> ArmsightError:
    path = place.path or Path()
    if path.is_dir():
        return UsageError(
            f"{place} is a folder",
            consequence="Nothing was done",
            cure=f"Give a file, such as {path / 'history.sqlite'}",
        )
    if "locked" in said or "busy" in said:
        return _locked(place)
    if "not a database" in said or "malformed" in said or "corrupt" in said or "encrypted" in said:
        return BadFile(
            f"{place} is no history, or a damaged one ({said.split(chr(10))[0]})",
            consequence="Nothing was filed or read, and the file stays as it is",
            cure="Give another file with --history, bring a copy back, or save what it holds: sqlite3 FILE .recover",
        )
    return _failed(place, said.split("\n")[0])


def _locked(place: Place) -> DeviceFailed:
    return DeviceFailed(
        f"the history at {place} was held by another program for {BUSY_S:.0f} s",
        consequence="Nothing was filed or read",
        cure="End what holds it (fuser FILE), and try again",
    )


def _failed(place: Place, said: str) -> DeviceFailed:
    return DeviceFailed(
        f"the history at {place} cannot be used ({said})",
        consequence="Nothing was filed or read",
        cure="Check folder, permissions and free space, or give another place with --history",
    )
