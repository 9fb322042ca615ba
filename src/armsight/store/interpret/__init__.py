"""Tables as people have them: other units, rotations, names, files; brought to the columns of ours.

What reads them is in `read`, which takes as long to load as all else that most commands need of files.
"""

from armsight.store.interpret.rotations import (
    ROBOT_FORMATS,
    largest,
    limits_look_like_degrees,
    looks_like_degrees,
    looks_like_mm,
)
from armsight.store.interpret.table_format import OURS, TableFormat
