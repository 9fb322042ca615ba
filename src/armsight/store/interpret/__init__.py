"""Tables as people have them: other units, rotations, names, files; brought to the columns of ours.

What reads them is loaded when it is first used: most commands read no table.
"""

from typing import TYPE_CHECKING

from armsight.fields import loaded_names
from armsight.store.interpret.rotations import (
    ROBOT_FORMATS,
    largest,
    limits_look_like_degrees,
    looks_like_degrees,
    looks_like_mm,
)
from armsight.store.interpret.table_format import OURS, TableFormat

if TYPE_CHECKING:
    from armsight.store.interpret.read import (
        Interpreted,
        check_joint_values,
        check_positions,
        interpret,
        joint_readings,
        kind_of_table,
        standard_bytes,
    )
else:
    READ = "Interpreted check_joint_values check_positions interpret joint_readings kind_of_table standard_bytes"
    __getattr__ = loaded_names(__name__, dict.fromkeys(READ.split(), "read"))
