"""What a batch's commands need compiled, before its workers begin: each would else compile the same."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from pathlib import Path

from armsight import errors
from armsight.records import Progress

PACKAGE = Path(errors.__file__).parent
CAMERAS = ("boards", "cameras")
GROUPS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "measure": ("measure/poses", ("spots", "boards", "poses", "motion", "measure")),
    "simulate": ("measure/poses", ("room", "simulator")),
    "verify": ("kinematics", ("kinematics",)),
    "identify": ("calibrate/identify", ("spots", "poses", "identify")),
    "calibrate camera": ("calibrate/cameras", CAMERAS),
    "calibrate stereo": ("calibrate/cameras", CAMERAS),
    "calibrate mirrors": ("calibrate/cameras", CAMERAS),
    "calibrate zoom-rig": ("calibrate/cameras", CAMERAS),
    "calibrate target": ("calibrate/light_target", ("spots", "light target")),
    "calibrate timing": ("measure/poses", ("spots", "poses", "motion")),
    "calibrate cell": ("calibrate/cell", ("spots", "kinematics", "arm")),
    "calibrate handeye": ("calibrate/handeye", ("boards", "hand-eye")),
    "calibrate arm": ("kinematics", ("kinematics", "arm")),
    "kinematics fk": ("kinematics", ("kinematics",)),
}
"""Command -> the folder whose kernels it needs, and what compiles them (app.compilation)."""


def compile_for(commands: Collection[str], progress: Progress) -> None:
    """Compile what the commands need where nothing of it is kept on this machine; at once where it is.

    Raises Cancelled. What fails to compile here is tried again, and told, by the first job that needs it.
    """
    missing: dict[str, None] = {}
    for command in sorted(commands):
        folder, groups = GROUPS.get(command, ("kinematics", ("kinematics",)))
        if not _kept(folder):
            missing.update(dict.fromkeys(groups))
    if missing:
        from armsight.app.compilation import compile_all

        compile_all(progress, tuple(missing))


def _kept(folder: str) -> bool:
    """Tell whether compiled kernels of a folder of the package are kept."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return any(Path(given).rglob("*.nbi"))
    return any((PACKAGE / folder).rglob("*.nbi"))
