"""Two results in: whether they agree, what moved by how much, and a report of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from armsight.errors import BadFile, Inconsistent, UsageError
from armsight.fields import Doc
from armsight.file_names import ARM, COMPARE, HANDEYE, POSES, REPORT, RIG, VERIFY
from armsight.ops.action import Given
from armsight.ops.compare.calibrations import (
    Compared,
    Effect,
    Judgement,
    compare_arms,
    compare_cameras,
    compare_handeyes,
    compare_rigs,
    judged,
    judged_singly,
)
from armsight.ops.compare.runs import TOO_FEW_INSIDE, Tracks, compare_tracks, compare_verifications
from armsight.ops.given import Given as Folder
from armsight.ops.given import path_of
from armsight.records.output import Output, figure, output
from armsight.records.result_parts import MEANING, Difference, Verdict
from armsight.report.compare_report import Course, compare_report
from armsight.report.html import page_unit
from armsight.shown import Shown, Table, digits
from armsight.store import write_text
from armsight.store.arm_file import ARM_YAML
from armsight.store.atomic import write_json
from armsight.store.foreign.storage import kind_of_mapping
from armsight.store.handeye_file import HANDEYE_YAML
from armsight.store.rigs import CAMERA_YAML, RIG_YAML
from armsight.store.yamls import read_yaml
from armsight.units import displayed

NOTHING = 1e-10
"""m, px or rad below which a difference is rounding."""

LEVELS = {
    True: ("good", "They agree", "Use either of them."),
    False: ("bad", "They differ", "Find out what moved or changed between them before you rely on either."),
    None: ("care", "Cannot be told", "Do not take them for alike: give results that hold their standard deviations."),
}
"""By whether they agree: level, word, and what to do."""

FORMATS: Mapping[str, str] = {
    CAMERA_YAML.format: "camera",
    RIG_YAML.format: "rig",
    HANDEYE_YAML.format: "handeye",
    ARM_YAML.format: "arm",
}
FOLDERS: Mapping[str, str] = {VERIFY: "verify", POSES: "measure"}
"""What a folder holds by the file that tells it."""
CALIBRATIONS = (RIG, "camera.yaml", HANDEYE, ARM)


@output
class CompareOutput(Output):
    """armsight compare."""

    kind: Annotated[str, Doc("camera, rig, handeye, arm, measure or verify.")]
    a: Annotated[str, Doc("The first result.")]
    b: Annotated[str, Doc("The second result.")]
    agree: Annotated[
        bool | None, Doc("Whether they agree within their uncertainty; null where too little is known of it.")
    ]
    verdict: Annotated[str, Doc("The same in a sentence.")]
    p: Annotated[
        float | None, Doc("How often chance alone would part two such results as far; null where it cannot be told.")
    ]
    parameters: Annotated[tuple[Difference, ...], Doc("Number by number.")]
    effects: Annotated[tuple[Effect, ...], Doc("What the differences come to.")]
    n: Annotated[int | None, Doc("Poses that stand in both; of measurements.")] = None
    same_rig: Annotated[bool | None, Doc("Whether both were measured with one rig; left out where not recorded.")] = (
        None
    )
    same_target: Annotated[
        bool | None, Doc("Whether both were measured with one target; left out where not recorded.")
    ] = None
    notes: Annotated[list[str], Doc("What to know.")]
    report: Annotated[str | None, Doc("The report; with -o.")] = None
    course: Course | None

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        level, headline, todo = LEVELS[self.agree]
        return Verdict(level=level, headline=headline, reasons=[self.verdict], next=[todo])

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        rows = []
        for one in self.parameters:
            unit, factor = displayed(one.unit)
            std = None if one.std is None else one.std / factor
            sigmas = "-" if one.sigmas is None else f"{one.sigmas:+.1f}"
            shown = (digits(one.a / factor, 6), digits(one.difference / factor), digits(std, 2))
            rows.append([_name(one), *shown, sigmas, unit])
        yield self.verdict
        yield Table(f"B less A, {self.kind}", ["", "A", "B less A", "+-", "sigma", "unit"], rows)
        for effect in self.effects:
            unit, factor = displayed(effect.unit)
            yield f"  {effect.name}: {digits(effect.value / factor)} {unit}".rstrip()
        for text in self.notes:
            yield f"Note: {text}"
        if self.report is not None:
            yield f"Results: {Path(self.report).parent}; open {self.report}"

    def write(self, folder: Path) -> None:
        """Write compare.json and report.html."""
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / COMPARE, self.to_dict())
        write_text(folder / REPORT, self._page())

    def _page(self) -> str:
        rows = []
        for one in self.parameters:
            unit, factor = displayed(one.unit)
            rows.append(replace(one, name=_name(one)).in_unit(page_unit(unit), factor))
        return compare_report(
            self.kind,
            (self.a, self.b),
            self.verdict_,
            rows,
            effects=[(one.name, _shown(one.value, one.unit)) for one in self.effects],
            notes=self.notes,
            course=self.course,
        )


def _name(one: Difference) -> str:
    """Return a number's name without its unit."""
    return one.name.replace("_rad", "").replace("_m_s", "").replace("_m", "")


@dataclass(frozen=True, slots=True)
class GivenResult:
    """A result's file or folder, and what it is called."""

    path: Path
    name: str


def given_result(name: str, value: Any, given: Given, undo: ExitStack) -> GivenResult:
    """Return a result's file or folder, and what it is called: its path, or the parameter."""
    path = path_of(value)
    if path is None:
        return GivenResult(undo.enter_context(Folder()).file(name, value), name)
    return GivenResult(path, str(path))


def compared(a: GivenResult, b: GivenResult, distance_m: float | None, out: Path | None) -> CompareOutput:
    """Compare two results of one kind.

    Raises UsageError for a path that holds no result, Inconsistent for two kinds or two things, DataRefused.
    """
    (kind, first), (other, second) = _result(a.path), _result(b.path)
    if kind != other:
        raise Inconsistent(
            f"{a.name} is a result of kind {kind} and {b.name} of kind {other}",
            consequence="Nothing was compared",
            cure="Give two results of one kind",
        )
    tracks = compare_tracks(first, second) if kind == "measure" else None
    found = tracks.compared if tracks is not None else _compared(kind, first, second, distance_m)
    judgement = _judgement(kind, found, tracks)
    return CompareOutput(
        kind=kind,
        a=a.name,
        b=b.name,
        agree=judgement.agree,
        verdict=_warned_verdict(found, judgement, tracks),
        p=judgement.p,
        parameters=tuple(found.differences),
        effects=tuple(found.effects),
        n=None if tracks is None else len(tracks.t_s),
        same_rig=None if tracks is None else tracks.shared.rig,
        same_target=None if tracks is None else tracks.shared.target,
        notes=list(found.notes),
        report=None if out is None else str(out / REPORT),
        course=None if tracks is None else Course(t_s=tracks.t_s, values=tracks.values, std=tracks.std),
    )


def _result(path: Path) -> tuple[str, Path]:
    """Return which kind of result a path is, and the file to read, or the folder of a verification."""
    if path.is_dir():
        for name, kind in FOLDERS.items():
            if (path / name).exists():
                return kind, path if kind == "verify" else path / name
        there = [path / name for name in CALIBRATIONS if (path / name).exists()]
        if len(there) == 1:
            return _result(there[0])
        held = f"several: {', '.join(file.name for file in there)}" if there else "none"
        raise UsageError(
            f"{path} holds no one result that can be compared ({held})",
            cure="Give a folder of measure or verify, or the file of a camera, rig, hand-eye or arm",
        )
    if path.suffix == ".csv":
        return "measure", path
    content = read_yaml(path)
    format_ = content.get("format")
    if not isinstance(format_, str) or format_ not in FORMATS:
        raise _not_compared(path, content)
    return FORMATS[format_], path


def _not_compared(path: Path, content: Mapping[str, Any]) -> BadFile:
    """Return why a YAML file is of none of the kinds that are compared."""
    format_, foreign = content.get("format"), kind_of_mapping(content)
    if foreign is not None and not foreign.startswith("armsight/"):
        said = f"is a file of {foreign}, not one of armsight's own"
        cure = "Convert it first: armsight convert camera FILE -o camera.yaml, or armsight convert rig"
    else:
        said = "has no line `format:` that says what it is of" if format_ is None else f"is of {str(format_)[:80]!r}"
        cure = f"Give two files of {', '.join(FORMATS)}, or two folders of measure or verify"
    return BadFile(f"{path}: {said}", consequence="Such files are not compared, and nothing was", cure=cure)


def _compared(kind: str, a: Path, b: Path, distance_m: float | None) -> Compared:
    comparers: Mapping[str, Callable[[Path, Path], Compared]] = {
        "camera": compare_cameras,
        "rig": lambda a, b: compare_rigs(a, b, distance_m),
        "handeye": compare_handeyes,
        "arm": compare_arms,
        "verify": compare_verifications,
    }
    return comparers[kind](a, b)


def _judgement(kind: str, found: Compared, tracks: Tracks | None) -> Judgement:
    if tracks is not None:
        return Judgement(agree=None if tracks.p is None else tracks.p >= TOO_FEW_INSIDE, p=tracks.p)
    return judged_singly(found.differences) if kind == "verify" else judged(found.differences, *found.covariances)


def _warned_verdict(found: Compared, judgement: Judgement, tracks: Tracks | None) -> str:
    warning = "" if tracks is None else tracks.shared.warning
    return f"{_verdict(found, judgement, tracks)} {warning}".strip()


def _verdict(found: Compared, judgement: Judgement, tracks: Tracks | None) -> str:
    effect = f" {_first_effect(found)}" if found.effects else ""
    if judgement.agree:
        return f"B agrees with A within their uncertainty.{effect}"
    if judgement.agree is None:
        silent = [one.name for one in found.differences if one.std is None and one.difference != 0.0]
        if judgement.p is None:
            return f"Neither result tells how sure it is: whether they agree cannot be told.{effect}"
        differ = f"{', '.join(silent[:3])} differ{'s' if len(silent) == 1 else ''}"
        return f"{differ}, and nothing tells how sure that is; what has an uncertainty agrees.{effect}"
    if tracks is not None:
        return f"B does not agree with A: too few differences lie inside their 95 % ellipsoid.{effect}"
    worst = max((one for one in found.differences if one.sigmas is not None), key=lambda one: abs(one.sigmas or 0.0))
    moved = _shown(worst.difference, worst.unit)
    return f"B does not agree with A: {worst.name} differs by {moved}, {abs(worst.sigmas or 0.0):.1f} sigma.{effect}"


def _first_effect(found: Compared) -> str:
    one = next((e for e in found.effects if e.unit == "m"), found.effects[0])
    return f"What it comes to: {one.name} {_shown(one.value, one.unit)}."


def _shown(value: float, unit: str) -> str:
    shown, factor = displayed(unit)
    text = f"{value / factor:.3g}" if abs(value) > NOTHING else "0"
    return f"{text} {shown}".strip()
