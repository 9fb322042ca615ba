"""The tables, public and described in docs/file-formats.md: a change of them is a migration, and HEAD its name."""

from __future__ import annotations

from sqlalchemy import Boolean, Column, Float, ForeignKey, Index, Integer, MetaData, String, Table, Text

from armsight.columns import POSE6_STD, POSE7

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
