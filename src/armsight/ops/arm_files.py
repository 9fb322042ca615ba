"""Arms by file, URDF or the name of a known one, and between these."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from armsight._files import source_parts
from armsight.errors import UsageError
from armsight.fields import Doc
from armsight.kinematics import (
    PRESETS,
    Arm,
    in_convention,
    preset,
)
from armsight.kinematics.axes import links_told
from armsight.kinematics.rigid import as_rigid
from armsight.records.output import Output, output
from armsight.shown import Shown
from armsight.store.arm_file import read_arm, write_arm
from armsight.store.mjcf import mjcf_lacks, write_mjcf
from armsight.store.urdf import read_urdf, write_urdf

URDF_SUFFIXES = (".urdf", ".xml")
MJCF_SUFFIX = ".mjcf"


YAML_SUFFIXES = (".yaml", ".yml")


NOTES = Doc("Which links of a URDF base and tool are, and what of it was taken otherwise than it is written.")


@output
class ConvertArmOutput(Output):
    """armsight convert arm."""

    arm: Annotated[str, Doc("The arm's name.")]
    file: Annotated[str, Doc("The file written.")]
    joints: Annotated[int, Doc("How many joints.")]
    convention: Annotated[str, Doc("standard or craig.")]
    notes: Annotated[tuple[str, ...], NOTES]

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        yield f"{self.arm}, {self.joints} joints: {self.file}"
        yield from (f"  {note}" for note in self.notes)


def arm_notes(arm: Arm) -> tuple[str, ...]:
    """Return what to know of an arm of a URDF; nothing of another."""
    told = links_told(arm)
    return (*told, arm.source) if told and arm.source.startswith("URDF") else told


def given_arm(arm: Path | str | None) -> Arm | None:
    """Return the arm of load_arm, None where none is given."""
    return None if arm is None else load_arm(str(arm))


def load_arm(text: str) -> Arm:
    """Return the arm of an arm.yaml, a .urdf or a preset's name.

    A URDF that holds more than the arm's chain is given as FILE#TIP, or FILE#BASE:TIP, with the names of the chain's
    links (arm_source makes it). Raises UsageError, BadFile.
    """
    file, base, tip = source_parts(text)
    suffix = Path(file).suffix.lower()
    if suffix in URDF_SUFFIXES:
        return read_urdf(Path(file), tip=tip, base=base)
    if base is not None or tip is not None:
        raise UsageError(
            f"the chain {text.rpartition('#')[2]!r} is named, but {file!r} is no URDF",
            consequence="It is one chain as it is, and no part of it can be chosen",
            cure="Leave --tip and --base away",
        )
    if file in PRESETS:
        refuse_file_called(file, "a known arm")
        return preset(file)
    if suffix in YAML_SUFFIXES or Path(file).exists():
        return read_arm(Path(file))
    raise UsageError(
        f"{file!r} is neither a file nor an arm known by name",
        cure=f"Give an arm.yaml, a .urdf, or one of {', '.join(PRESETS)}",
    )


def refuse_file_called(name: str, what: str) -> None:
    """Raise UsageError where a file of the current folder has the name of what is known by it: either may be meant.

    A folder is not refused: it is none of the files that could be meant, and results are often kept under such a name.
    """
    if Path(name).is_file():
        raise UsageError(
            f"{name!r} is the name of {what}, and of a file here",
            consequence="Which of them is meant is not known, and nothing was done",
            cure=f"Rename the file, to {name}.yaml for instance: with its ending it is taken as a file",
        )


def arm_file(text: str) -> Path | None:
    """Return the file of what load_arm takes; None for a preset's name."""
    file, _, _ = source_parts(text)
    return None if file in PRESETS or not Path(file).exists() else Path(file)


def convert_arm(source: str, out: Path, *, convention: str | None = None, only_rigid: bool = False) -> ConvertArmOutput:
    """Write the arm as arm.yaml, URDF or MJCF, by the name's ending; convention: standard or craig (arm.yaml only).

    only_rigid: the nearest rigid arm in an arm.yaml too; the others hold no other.
    """
    model = load_arm(source)
    suffix = out.suffix.lower()
    if convention is not None:
        if convention not in ("standard", "craig"):
            raise UsageError(f"the convention {convention!r} is not known", cure="Use standard or craig")
        model = in_convention(model, convention)
    if suffix not in (*YAML_SUFFIXES, *URDF_SUFFIXES, MJCF_SUFFIX):
        raise UsageError(f"{out.name} ends in neither .yaml nor .urdf nor .mjcf", cure="Choose one of them")
    lost: tuple[str, ...] = ()
    if only_rigid or suffix not in YAML_SUFFIXES:
        rigid = as_rigid(model)
        model, lost = rigid.arm, (rigid.lost,) if rigid.lost else ()
    if suffix in URDF_SUFFIXES:
        write_urdf(out, model)
    elif suffix == MJCF_SUFFIX:
        write_mjcf(out, model)
        lost += tuple(mjcf_lacks(model))
    else:
        file = arm_file(source)
        write_arm(out, model, inputs=[] if file is None else [file])
    return ConvertArmOutput(
        arm=model.name,
        file=str(out),
        joints=model.n,
        convention=model.convention.value,
        notes=(*arm_notes(model), *lost),
    )
