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
from armsight.store.atomic import write_text
from armsight.store.factory_arms import FACTORY, is_factory_file, read_factory_arm
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
    zeros: Annotated[
        list[float] | None,
        Doc("For a controller: by how much more each axis has to show, rad or m; null where its table holds them."),
    ] = None
    lost_rms_m: Annotated[
        float | None, Doc("For a controller: how far its tool will be from the calibrated one's, RMS, m.")
    ] = None
    lost_most_m: Annotated[float | None, Doc("... at most over the joints' ranges, m.")] = None

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        yield f"{self.arm}, {self.joints} joints: {self.file}"
        yield from (f"  {note}" for note in self.notes)


def arm_notes(arm: Arm) -> tuple[str, ...]:
    """Return what to know of an arm of a URDF or of a factory calibration; nothing of another."""
    told = links_told(arm)
    if FACTORY in arm.source:
        return (arm.source,)
    return (*told, arm.source) if told and arm.source.startswith("URDF") else told


def load_arm(text: str, nominal: Arm | None = None) -> Arm:
    """Return the arm of an arm.yaml, a .urdf, a factory calibration or a preset's name.

    nominal: the arm as its maker draws it, which a factory calibration may be differences to.

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
    if Path(file).is_file() and is_factory_file(Path(file)):
        return read_factory_arm(Path(file), nominal)
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


def for_controller(model: Arm, nominal: Arm | None, to: str, out: Path) -> ConvertArmOutput:
    """Write what an arm becomes in its controller, as text. Raises UsageError, Inconsistent."""
    from armsight.ops.controllers import controller_sheet, loss

    refuse_model_suffix(out)
    content, found = controller_sheet(model, require_nominal(nominal, to), to)
    write_text(out, content)
    return ConvertArmOutput(
        arm=model.name,
        file=str(out),
        joints=model.n,
        convention=model.convention.value,
        notes=(loss(found),),
        zeros=found.zeros.tolist() if found.zeros.any() else None,
        lost_rms_m=found.rms_m,
        lost_most_m=found.most_m,
    )


def require_nominal(nominal: Arm | None, name: str) -> Arm:
    """Return the nominal arm. Raises UsageError where none is given."""
    if nominal is None:
        raise UsageError(
            f"--to {name} says by how much the arm differs from what its controller has, and that is not given",
            consequence="Nothing is written",
            cure="Give --nominal with the arm as its maker draws it: a known arm's name, an arm.yaml or .urdf",
        )
    return nominal


def refuse_model_suffix(out: Path) -> None:
    """Raise UsageError for an ending that an arm's model has: it would be read as one."""
    if out.suffix.lower() in (*YAML_SUFFIXES, *URDF_SUFFIXES, MJCF_SUFFIX):
        raise UsageError(
            f"{out.name} would be read as a model of an arm, and what a controller takes is none",
            cure="End the name in .txt",
        )


def convert_arm(
    source: str,
    out: Path,
    *,
    convention: str | None = None,
    only_rigid: bool = False,
    nominal: Arm | None = None,
    to: str | None = None,
) -> ConvertArmOutput:
    """Write the arm as arm.yaml, URDF or MJCF, by the name's ending, or as its controller takes it.

    convention: standard or craig (arm.yaml only). only_rigid: the nearest rigid arm in an arm.yaml too; the others hold
    no other. nominal: the arm as its maker draws it. to: a name of CONTROLLERS.
    """
    model = load_arm(source, nominal)
    if to is not None:
        return for_controller(model, nominal, to, out)
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
