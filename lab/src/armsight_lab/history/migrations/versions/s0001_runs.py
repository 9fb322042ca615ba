"""The first schema: runs, their inputs, figures, parameters and poses."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
POSE_STD = ("sx_m", "sy_m", "sz_m", "srx_rad", "sry_rad", "srz_rad")


def upgrade() -> None:
    """Make the tables. Written out, not taken from `tables`: those are the last schema's, and this stays the first."""
    op.create_table(
        "runs",
        sa.Column("id", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("cell", sa.String(100), nullable=False),
        sa.Column("command", sa.String(40), nullable=False),
        sa.Column("created", sa.String(32), nullable=False),
        sa.Column("filed", sa.String(32), nullable=False),
        sa.Column("software", sa.String(60), nullable=False),
        sa.Column("verdict", sa.Text, nullable=False),
        sa.Column("trusted", sa.Boolean, nullable=False),
        sa.Column("exit_code", sa.Integer, nullable=False),
        sa.Column("reason", sa.Text, nullable=False),
        sa.Column("arm", sa.String(200), nullable=False),
        sa.Column("joints", sa.String(60), nullable=False),
        sa.Column("fingerprint", sa.String(64), nullable=False, unique=True),
        sa.Column("result", sa.Text, nullable=False),
    )
    op.create_index("runs_by_cell", "runs", ["cell", "created"])
    op.create_index("runs_by_time", "runs", ["created"])
    _of_runs()


def _of_runs() -> None:
    """Make the tables of what belongs to a run."""
    op.create_table(
        "inputs",
        sa.Column("run_id", sa.Integer, sa.ForeignKey("runs.id"), primary_key=True),
        sa.Column("flag", sa.String(60), primary_key=True),
        sa.Column("path", sa.String(1000), primary_key=True),
        sa.Column("sha256", sa.String(64)),
    )
    for table in ("figures", "parameters"):
        op.create_table(
            table,
            sa.Column("run_id", sa.Integer, sa.ForeignKey("runs.id"), primary_key=True),
            sa.Column("name", sa.String(200), primary_key=True),
            sa.Column("value", sa.Float(53)),
            sa.Column("std", sa.Float(53)),
            sa.Column("unit", sa.String(16), nullable=False),
        )
    op.create_table(
        "poses",
        sa.Column("run_id", sa.Integer, sa.ForeignKey("runs.id"), primary_key=True),
        sa.Column("name", sa.String(200), primary_key=True),
        *(sa.Column(name, sa.Float(53), nullable=False) for name in POSE),
        *(sa.Column(name, sa.Float(53)) for name in POSE_STD),
    )
