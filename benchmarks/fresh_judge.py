"""Planted faults: the form of a case, how the product is run on it, and what its answer is worth."""

from __future__ import annotations

import csv
import json
import re
import tempfile
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from typer.testing import CliRunner

from armsight.cli.commands import app
from fresh_world import Array, pose

RIGHT, TOLD, OTHERWISE, WRONG = "right", "refused or told", "told otherwise", "WRONG CALLED GOOD"
REFUSED = "HEALTHY REFUSED"
VERDICTS = (RIGHT, TOLD, OTHERWISE, WRONG, REFUSED)
BEYOND = 1.5
"""Claimed 95 % regions beyond which a number is wrong; by chance 5 in 10,000 are of three coordinates."""

KINDS = {
    2: "one word for two frames",
    3: "lost frames",
    4: "clocks",
    5: "errors that are not independent",
    6: "what does not fit",
    7: "valid input",
    8: "causes and cures",
    9: "joints of a healthy arm",
    10: "two functions, one question",
}
"""Old machine code after an update is no fault that a user's data can have."""


@dataclass(frozen=True)
class Try:
    """What is run, and miss(): how far off the answer is, 1 at the edge of what is claimed, None without one."""

    words: Sequence[object]
    miss: Callable[[], float | None]
    flag: str = "--check"


@dataclass(frozen=True)
class Case:
    """One planted fault, or a healthy control. true: the words that name its true cause."""

    kind: int
    name: str
    make: Callable[[Path, np.random.Generator], Try]
    true: str
    healthy: bool


@dataclass(frozen=True)
class Found:
    """What a case came to."""

    case: Case
    verdict: str
    miss: float | None
    exit_code: int
    text: str
    seconds: float


CASES: list[Case] = []
Make = Callable[[Path, np.random.Generator], Try]


def fault(kind: int, true: str = "nothing will do") -> Callable[[Make], Make]:
    """Add a case. true: a regular expression of words of its cause; a right answer needs none."""
    return lambda make: _added(Case(kind, make.__name__.strip("_").replace("_", " "), make, true, healthy=False))


def healthy(kind: int) -> Callable[[Make], Make]:
    """Add a control: right, and good."""
    return lambda make: _added(Case(kind, make.__name__.strip("_").replace("_", " "), make, "", healthy=True))


def _added(case: Case) -> Make:
    if any(case.name == other.name for other in CASES):
        raise ValueError(f"two cases are called {case.name}")
    CASES.append(case)
    return case.make


def run(words: Sequence[object]) -> tuple[int, str]:
    """Run the command and return its exit code and all that it prints, in one line."""
    done = CliRunner().invoke(app, [str(word) for word in words], env={"COLUMNS": "400", "TERM": "dumb"})
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        return 70, f"TRACEBACK {type(done.exception).__name__}: {done.exception}"
    return done.exit_code, " ".join(done.output.split())


def judged(case: Case) -> Found:
    """Make the case's files, run the product, and judge."""
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        asked = case.make(Path(folder), np.random.default_rng(zlib.crc32(case.name.encode())))
        code, text = run([*asked.words, asked.flag] if asked.flag else asked.words)
        miss = asked.miss() if code in {0, 3} else None
        good = code == 0 or (miss is not None and sure(asked.words))
        text = text.replace(folder, "")
    right = miss is not None and miss < BEYOND
    if case.healthy:
        verdict = RIGHT if right and code == 0 else WRONG if good else REFUSED
    elif right:
        verdict = RIGHT
    elif code != 70 and re.search(case.true, text, re.IGNORECASE):
        verdict = TOLD
    else:
        verdict = WRONG if good else OTHERWISE
    return Found(case, verdict, miss, code, text, time.perf_counter() - start)


def sure(words: Sequence[object]) -> bool:
    """Return whether `verify` blames a joint or nothing: an exit code of 3 is of the arm then, no doubt of its own."""
    if words[0] != "verify":
        return False
    cause = json.loads((Path(str(words[-1])) / "verify.json").read_text())["cause"]
    return cause in {"measurement", "none"} or cause.startswith("joint ")


# What was answered, against the truth.


def document(path: Path) -> dict | None:
    return yaml.safe_load(path.read_text()) if path.is_file() else None


def beyond(error: Array, covariance: Array) -> float:
    """Return how many times the claimed 95 % region an error (k,) is off."""
    return float(np.sqrt(error @ np.linalg.pinv(covariance) @ error / chi2.ppf(0.95, len(error))))


def block(found: dict, names: Sequence[str]) -> Array:
    """Return the covariance of these names, from a file of results."""
    at = [found["covariance"]["names"].index(name) for name in names]
    return np.array(found["covariance"]["matrix"], float)[np.ix_(at, at)]


def placed(found: dict, key: str) -> Array:
    return pose(found[key]["xyz_m"], Rotation.from_quat(found[key]["quat_xyzw"]))


def posed(path: Path, key: str, true: Array, names: str) -> float | None:
    """Return how far a pose of a file is off, in claims of its place and of its turn, the larger. names: before x_m."""
    found = document(path)
    if found is None or key not in found:
        return None
    T = placed(found, key)
    turn = Rotation.from_matrix(T[:3, :3] @ true[:3, :3].T).as_rotvec()
    place = beyond(T[:3, 3] - true[:3, 3], block(found, [f"{names}{a}_m" for a in "xyz"]))
    return max(place, beyond(turn, block(found, [f"{names}r{a}_rad" for a in "xyz"])))


def tipped(path: Path, true: Sequence[float]) -> float | None:
    found = document(path)
    if found is None:
        return None
    return beyond(np.array(found["tip_m"]) - np.array(true), block(found, [f"tip.{a}_m" for a in "xyz"]))


def blamed(folder: Path, cause: str, zero_deg: float | None = None) -> float | None:
    """Return 0 where verify names this cause (and its zero, within what it claims), else a large number."""
    path = folder / "verify.json"
    if not path.is_file():
        return None
    found = json.loads(path.read_text())
    if found["cause"] not in cause.split("|"):
        return 99.0
    zero = (found["parameters"] or {}).get("zero_rad")
    if zero_deg is None:
        return 0.0
    return 99.0 if zero is None else abs(zero["value"] - np.deg2rad(zero_deg)) / (1.96 * zero["std"])


def unblamed(folder: Path) -> float | None:
    """Return 0 where verify blames no joint, else how many claims the zero that it tells is off (99 without one)."""
    path = folder / "verify.json"
    if not path.is_file():
        return None
    found = json.loads(path.read_text())
    return 99.0 if "joint" in found["cause"] else 0.0


def read(path: Path) -> dict[str, Array] | None:
    """Return a table's columns; empty cells and words are NaN."""
    if not path.is_file():
        return None
    with path.open() as file:
        rows = list(csv.reader(file))

    def number(cell: str) -> float:
        try:
            return float(cell)
        except ValueError:
            return np.nan

    return {name: np.array([number(row[k]) for row in rows[1:]]) for k, name in enumerate(rows[0])}


def poses_of(path: Path) -> Array | None:
    """Return the poses (n, 4, 4) of a poses.csv."""
    found = read(path)
    if found is None:
        return None
    quat = np.stack([found[f"q{a}"] for a in "xyzw"], 1)
    turn = Rotation.from_quat(np.where(np.isfinite(quat), quat, 0.5))
    return pose(np.stack([found[f"{a}_m"] for a in "xyz"], 1), turn)


def same_poses(path: Path, true: Array, bound_m: float, bound_rad: float = 1e-6) -> float | None:
    """Return the largest distance from true poses (n, 4, 4) in bounds."""
    T = poses_of(path)
    if T is None or len(T) != len(true):
        return None
    turn = np.linalg.norm(Rotation.from_matrix(T[:, :3, :3] @ true[:, :3, :3].transpose(0, 2, 1)).as_rotvec(), axis=1)
    place = np.linalg.norm(T[:, :3, 3] - true[:, :3, 3], axis=1)
    return float(np.nan_to_num(max(np.max(place) / bound_m, np.max(turn) / bound_rad), nan=99.0))


def forward(arm: Path, q: Array, true: Array, bound_m: float, bound_rad: float = np.inf) -> float | None:
    """Return how far an arm's file is from true poses at readings q, by the product's own forward kinematics, RMS."""
    if not arm.is_file():
        return None
    log, out = arm.parent / "asked_q.csv", arm.parent / "asked_poses.csv"
    np.savetxt(log, q, "%.12g", ",", header=",".join(f"q{k + 1}" for k in range(q.shape[1])), comments="")
    code, _ = run(["kinematics", "fk", "--arm", arm, "--joints", log, "-o", out])
    T = poses_of(out) if code == 0 else None
    if T is None:
        return 99.0
    turn = np.linalg.norm(Rotation.from_matrix(T[:, :3, :3] @ true[:, :3, :3].transpose(0, 2, 1)).as_rotvec(), axis=1)
    place = np.linalg.norm(T[:, :3, 3] - true[:, :3, 3], axis=1)
    return float(max(np.sqrt(np.mean(place**2)) / bound_m, np.sqrt(np.mean(turn**2)) / bound_rad))
