"""Pages of actions' results, named at the actions: of the result, the files that went in, and what it was called with.

Each page's module is loaded when it is made: together they load all that armsight can calibrate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from armsight._files import arm_source

if TYPE_CHECKING:
    from armsight.calibrate.arm import ArmResult
    from armsight.calibrate.cell import CellResult
    from armsight.calibrate.handeye import HandEyeResult
    from armsight.calibrate.identify import Identification
    from armsight.verify.live import VerifyLiveOutput
    from armsight.verify.results import MasteringOutput, VerifyResult

FILES_SHOWN = 20
"""Files of what went in that a page lists; the result's own file has all, with their hashes."""
Given = Mapping[str, object]


def hand_eye(result: HandEyeResult, files: Sequence[Path], given: Given) -> str:
    """Return the page of a hand-eye calibration."""
    from armsight.report.handeye_report import handeye_report

    return handeye_report(result, inputs=[("file", item.name) for item in files[:FILES_SHOWN]])


def identified(result: Identification, files: Sequence[Path], given: Given) -> str:
    """Return the page of an identified arm."""
    from armsight.report.identify_report import identify_report

    made = [] if result.plan is None else [Path(str(given["out"])).with_suffix(".sweep.csv")]
    return identify_report(result, inputs=[("file", item.name) for item in (*made, *files)])


def cell(result: CellResult, files: Sequence[Path], given: Given) -> str:
    """Return the page of a calibrated cell."""
    from armsight.report.cell_report import cell_report

    named = (
        ("arm", "model"),
        ("target", "target"),
        ("robot's log", "robot_log"),
        *((f"{side} camera", name) for side in ("left", "right") for name in (side, f"{side}_spots")),
    )
    told = [(what, given.get(name)) for what, name in named]
    return cell_report(result, inputs=[(what, str(one)) for what, one in told if isinstance(one, str | PathLike)])


def arm(result: ArmResult, files: Sequence[Path], given: Given) -> str:
    """Return the page of a calibrated arm."""
    from armsight.report.arm_report import arm_report

    texts = {name: str(value) for name, value in given.items() if isinstance(value, str | PathLike)}
    inputs = [("measurements", Path(texts[name]).name) for name in ("q", "touch", "holdout") if name in texts]
    if "nominal" in texts:
        inputs = [("model", arm_source(texts["nominal"], tip=texts.get("tip"), base=texts.get("base"))), *inputs]
    return arm_report(result, inputs=inputs)


def verification(result: VerifyResult, files: Sequence[Path], given: Given) -> str:
    """Return the page of a verification."""
    from armsight.report.verify_pages import repeats_report
    from armsight.report.verify_report import verify_report

    if result.verification is None:
        return repeats_report(result)
    arm = given.get("arm")
    if isinstance(arm, str | PathLike):
        links = {name: str(given[name]) for name in ("tip", "base") if given.get(name) is not None}
        given = {**given, "arm": arm_source(str(arm), **links)}
    return verify_report(result, inputs=_named(given, ("measured", "arm", "joints", "commanded", "world"), ("arm",)))


def live(result: VerifyLiveOutput, files: Sequence[Path], given: Given) -> str:
    """Return the page of a supervision."""
    from armsight.report.verify_pages import live_report

    cameras = given.get("cameras")
    given = {**given, **(cameras if isinstance(cameras, Mapping) else {})}
    names = ("left", "right", *(cameras if isinstance(cameras, Mapping) else ()))
    devices = ("robot", *dict.fromkeys(names), "arm")
    return live_report(result, inputs=_named(given, (*devices, "rig", "target", "world"), devices))


def mastering(result: MasteringOutput, files: Sequence[Path], given: Given) -> str:
    """Return the page of zeros after a crash."""
    from armsight.report.verify_pages import mastering_report

    return mastering_report(result)


def _named(given: Given, names: Sequence[str], in_full: Sequence[str]) -> list[tuple[str, str]]:
    """Return what went in by name where it was said in words: files by their names alone but for those in full."""
    told = [(name, given.get(name)) for name in names]
    texts = [(name, str(value)) for name, value in told if isinstance(value, str | PathLike)]
    return [(name, text if name in in_full else Path(text).name) for name, text in texts]
