"""armsight convert."""

from __future__ import annotations

from armsight.cli.actions import add_action
from armsight.cli.command import convert
from armsight.ops.convert import any_table, arm, camera, export_recording, handeye, poses, rig

for one in (camera, rig, poses, any_table, handeye, arm, export_recording):
    add_action(convert, one)
