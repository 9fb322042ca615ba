"""armsight path."""

from __future__ import annotations

from armsight.cli.actions import add_action
from armsight.cli.command import path
from armsight.ops import paths

for one in ("smooth", "resample", "fillet", "offset", "angle", "reverse", "join", "check", "export", "from_picks"):
    add_action(path, getattr(paths, one))
