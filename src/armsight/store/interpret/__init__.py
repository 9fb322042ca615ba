"""Tables as people have them: other units, rotations, names, files; brought to the columns of ours."""

from armsight.store.interpret.read import (
    Interpreted,
    check_joint_values,
    check_positions,
    interpret,
    joint_readings,
    kind_of_table,
    standard_bytes,
)
from armsight.store.interpret.rotations import (
    ROBOT_FORMATS,
    largest,
    limits_look_like_degrees,
    looks_like_degrees,
    looks_like_mm,
)
from armsight.store.interpret.table_format import OURS, TableFormat
