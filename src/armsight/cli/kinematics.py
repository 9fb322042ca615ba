"""armsight kinematics."""

from __future__ import annotations

from armsight.cli.actions import add_action
from armsight.cli.command import kinematics
from armsight.ops.kinematics import fk, ik, jacobian, path, show_arm, write_formulas

for one in (fk, ik, jacobian, path):
    add_action(kinematics, one, streamed=True)
add_action(kinematics, write_formulas)
add_action(kinematics, show_arm)
