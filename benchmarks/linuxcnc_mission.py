"""A Puma behind the real LinuxCNC, from nothing known to a played seam, by the commands a user types.

python benchmarks/linuxcnc_mission.py [identify] [verify] [seam] [--seeds 1 2 3 4 5 6] [--runs 10] [--keep FOLDER]

LinuxCNC holds its own Puma 560 (genserkins); simulated cameras follow its joints in real time. identify: the arm from
one light, each seed another noise; every entry of the table is held against genserkins'. verify: while LinuxCNC's own
jogs move the arm, a length is altered in genserkins or a joint is homed beside its place, and `verify --live` is given
the arm as LinuxCNC then holds it; printed is the cause that `verify` names, and of a length what `calibrate arm`
corrects. seam: shown before the cameras, taught, played by the arm's own file; the light's true distance from what was
shown is worked out here from LinuxCNC's joints. It has to be installed, none may run, and the machine is to be idle.
"""

from __future__ import annotations

import argparse
import csv
import json
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.clock import SystemClock
from armsight_sim.twins.base import HOME
from armsight_sim.twins.linuxcnc import LinuxcncTwin
from linuxcnc import MODES, Recorded

Array = NDArray[np.float64]
INCH = 0.0254
A = INCH * np.array([0.0, 0.0, 17.0, 0.0, 0.0, 0.0])
ALPHA = np.deg2rad([0.0, -90.0, 0.0, -90.0, 90.0, -90.0])
D = INCH * np.array([26.45, 0.0, -5.5, 17.05, 0.0, 2.2])
"""LinuxCNC's own Puma 560, in Craig's convention."""
ENDS = np.deg2rad([(-160, 160), (-225, 45), (-215, 35), (-110, 170), (-100, 100), (-266, 266)])
REACH = np.deg2rad([14.0, 12.0, 14.0, 25.0, 22.0, 60.0])
"""How far each joint may be swept to either side of HOME."""
LIGHT = {"A": [-0.04, 0.0, 0.0]}
OPENED_S = 20.0
"""By then `verify --live` has its link and its cameras."""
SETTINGS = ("--robot-set", "max_speed_rad_s=0.5", "--robot-set", "switch_on=true")


def arm_file(path: Path, a: Array = A, d: Array = D) -> Path:
    """Write the arm as LinuxCNC holds it."""
    joints = [
        {"name": f"j{j + 1}", "a_m": float(a[j]), "alpha_rad": float(ALPHA[j]), "d_m": float(d[j])}
        | {"lower": float(ENDS[j, 0]), "upper": float(ENDS[j, 1])}
        for j in range(6)
    ]
    path.write_text(
        yaml.safe_dump(
            {"format": "armsight/arm", "version": 1, "name": "puma", "convention": "craig", "joints": joints}
        )
    )
    return path


def armsight(*words: Any, into: Path) -> tuple[int, Any]:
    """Run the command as a user would; returns its exit code and its JSON object, empty where it gave none."""
    done = subprocess.run(
        [sys.executable, "-m", "armsight", *map(str, words)], capture_output=True, text=True, cwd=into
    )
    try:
        return done.returncode, json.loads(done.stdout)
    except ValueError:
        if done.returncode:
            print(f"  {words[0]}: exit {done.returncode}: {(done.stderr or done.stdout).strip()[-900:]}", flush=True)
        return done.returncode, {}


def edited(scenario: Path, out: Path, **keys: Any) -> Path:
    mapping = yaml.safe_load(scenario.read_text())
    out.write_text(yaml.safe_dump(mapping | keys, sort_keys=False))
    return out


def cell(folder: Path, *more: Any) -> Path:
    """Make the cameras' cell before the Puma; returns its folder."""
    arm = arm_file(folder / "puma.yaml")
    words = ("webcam-cell", "--arm", arm, "--room", "dark", "--overwrite", "-o", "cell", *(more or ("--frames", 1)))
    subprocess.run([sys.executable, "-m", "armsight", "simulate", *map(str, words)], cwd=folder, check=True)
    return folder / "cell"


def cameras(made: Path, scenario: Path, target: Path) -> tuple[Any, ...]:
    return ("--follow", scenario, "--rig", made / "rig.yaml", "--target", target, "--world", made / "world.yaml")


def one_light(made: Path, seed: int) -> tuple[Path, Path]:
    """Return scenario and target of one light where the cell's first one is."""
    mapping = yaml.safe_load((made / "scenario.yaml").read_text())
    lights = mapping["target"] | {"spots_m": LIGHT, "diameter_m": 0.012}
    scenario = edited(made / "scenario.yaml", made / f"light{seed}.yaml", target=lights, seed=seed)
    target = made / "light_target.yaml"
    if not target.exists():
        words = ("simulate", scenario, "--frames", 1, "-o", made / "light")
        subprocess.run([sys.executable, "-m", "armsight", *map(str, words)], check=True, capture_output=True)
        target.write_text((made / "light/target.yaml").read_text())
    return scenario, target


def true_table() -> dict[str, Array]:
    """Return genserkins' parameters as the standard table has them: a and alpha stand one joint earlier there."""
    return {"a_m": np.append(A[1:], 0.0), "alpha_rad": np.append(ALPHA[1:], 0.0), "d_m": D, "theta_rad": np.zeros(6)}


def judged(found: Any) -> list[float]:
    """Return by how many of its standard deviations each measured entry is off, and print a2 and d4."""
    truth, z = true_table(), {}
    for j, joint in enumerate(found["joints"]):
        for name, std in joint["std"].items():
            if std is not None:
                z[j, name] = (joint[name] - (truth[name][j] if name in truth else 0.0)) / std
    for j, name in ((1, "a_m"), (3, "d_m")):
        value, std = found["joints"][j][name], found["joints"][j]["std"][name]
        print(f"  {name[0]}{j + 1}: {1e3 * value:.3f} +- {1e3 * std:.3f} mm, genserkins {1e3 * truth[name][j]:.3f}")
    worst = max(z, key=lambda key: abs(z[key]))
    print(f"  worst: {worst[1]} of joint {worst[0] + 1}, {z[worst]:+.2f} deviations", flush=True)
    return list(z.values())


def run_identify(folder: Path, seeds: list[int]) -> None:
    """Print every entry of the table beside genserkins' own, in standard deviations."""
    made = cell(folder)
    lower, upper = np.maximum(HOME - REACH, ENDS[:, 0] + 0.02), np.minimum(HOME + REACH, ENDS[:, 1] - 0.02)
    limits = ",".join(f"{low:g}:{high:g}" for low, high in zip(lower, upper, strict=True))
    deviations: list[float] = []
    for seed in seeds:
        scenario, target = one_light(made, seed)
        with LinuxcncTwin(arm=yaml.safe_load((folder / "puma.yaml").read_text()), clock=SystemClock()) as twin:
            begun_s = time.monotonic()
            words = (
                "identify",
                "--live",
                twin.address,
                *cameras(made, scenario, target),
                f"--limits={limits}",
                "--speed",
                0.25,
            )
            _, found = armsight(*words, *SETTINGS, "--yes", "--json", "-o", f"arm{seed}.yaml", into=folder)
        (folder / f"arm{seed}.json").write_text(json.dumps(found))
        print(f"seed {seed}: {time.monotonic() - begun_s:.0f} s", flush=True)
        if "joints" in found:
            deviations += judged(found)
    if deviations:
        z = np.abs(deviations)
        print(f"{len(z)} entries: worst {z.max():.2f} deviations, {np.mean(z < 1.96):.1%} within the 95 % they claim")


def jogs(twin: LinuxcncTwin, rng: np.random.Generator, on: threading.Event) -> None:
    """Let LinuxCNC jog its joints from posture to posture, as its operator would, until told to end."""
    twin.begin("/usr/bin/python3", "-c", MODES, "MANUAL", "joint").wait()  # homing leaves it in teleop mode
    time.sleep(OPENED_S)  # a link that may drive opens only where the arm rests
    twin.hal("setp", "halui.joint.jog-speed", "900")  # degrees a minute
    reach = np.minimum(0.9 * REACH, np.deg2rad(15.0))
    while on.is_set():
        goal = np.degrees(np.clip(HOME + reach * rng.uniform(-1.0, 1.0, 6), ENDS[:, 0], ENDS[:, 1]))
        for joint, by in enumerate(goal - twin.joints_deg()):
            way = "plus" if by > 0.0 else "minus"
            twin.hal("setp", f"halui.joint.{joint}.increment", f"{abs(by):.6f}")
            twin.hal("setp", f"halui.joint.{joint}.increment-{way}", "1")
            time.sleep(0.05)  # task looks ten times in that
            twin.hal("setp", f"halui.joint.{joint}.increment-{way}", "0")
        time.sleep(2.5)


def altered_length(twin: LinuxcncTwin, name: str, by_m: float) -> None:
    """Change a length in genserkins."""
    held = float(twin.hal("getp", f"genserkins.{name}"))
    twin.hal("setp", f"genserkins.{name}", f"{held + 1e3 * by_m:.6f}")


def homed_beside(twin: LinuxcncTwin, joint: int, by_deg: float) -> None:
    """Home a joint where it does not belong: its motor stays, its value changes."""
    held = float(twin.hal("getp", f"ini.{joint}.home_offset"))
    twin.hal("setp", f"ini.{joint}.home_offset", f"{held + by_deg:.6f}")
    for what in ("unhome", "home"):
        twin.hal("setp", f"halui.joint.{joint}.{what}", "1")
        time.sleep(1.0)
        twin.hal("setp", f"halui.joint.{joint}.{what}", "0")


def held_arm(twin: LinuxcncTwin, made: Path, out: Path) -> Path:
    """Write the arm as LinuxCNC holds it now, with the target as its tool."""
    a, d = (np.array([1e-3 * float(twin.hal("getp", f"genserkins.{k}-{j}")) for j in range(6)]) for k in "AD")
    arm_file(out, a, d)
    tool = {"T_flange_tool": yaml.safe_load((made / "arm.yaml").read_text())["T_flange_tool"]}
    out.write_text(out.read_text() + yaml.safe_dump(tool))
    return out


def offsets_deg(twin: LinuxcncTwin) -> Array:
    """Return what each joint reads beyond what its motor stands at."""
    pairs = [[float(twin.hal("getp", f"joint.{j}.{pin}")) for pin in ("pos-fb", "motor-pos-fb")] for j in range(6)]
    return np.array([told - stands for told, stands in pairs])


FAULTS: tuple[tuple[str, int | str, float], ...] = (
    ("zero", 1, 0.3), ("length", "A-2", 0.002), ("zero", 2, -0.3), ("length", "D-3", -0.002), ("zero", 3, 0.5),
    ("length", "A-2", -0.002), ("zero", 4, -0.5), ("length", "D-3", 0.002), ("zero", 1, -0.4), ("zero", 2, 0.4),
)  # fmt: skip
"""What is altered: the joint from 0 and degrees, or genserkins' parameter and m."""


def run_verify(folder: Path, runs: int) -> None:
    """Print what verify says of a joint that was homed beside its place, or of a length altered in genserkins."""
    made = cell(folder)
    for k, (kind, where, by) in enumerate(FAULTS[:runs]):
        with LinuxcncTwin(arm=yaml.safe_load((folder / "puma.yaml").read_text()), clock=SystemClock()) as twin:
            before = offsets_deg(twin)
            if kind == "zero":
                homed_beside(twin, int(where), by)
            else:
                altered_length(twin, str(where), by)
            off = offsets_deg(twin) - before
            model = held_arm(twin, made, folder / f"held{k}.yaml")
            keys = yaml.safe_load((made / "scenario.yaml").read_text())
            for joint, deg in zip(keys["arm"]["joints"], off, strict=True):
                joint["theta_deg"] = float(joint["theta_deg"] - deg)
            scenario = edited(made / "scenario.yaml", made / f"fault{k}.yaml", arm=keys["arm"], seed=k + 1)
            on = threading.Event()
            on.set()
            mover = threading.Thread(target=jogs, args=(twin, np.random.default_rng(k), on))
            mover.start()
            watched = cameras(made, scenario, made / "target.yaml")
            words = ("verify", "--live", "--robot", twin.address, *watched, "--arm", model, "--seconds", 75)
            levels = ("--warn-mm", 100, "--stop-mm", 500, "--overwrite", "--json", "-o", f"live{k}")
            code, live = armsight(*words, *levels, into=folder)
            on.clear()
            mover.join()
        verified = offline(folder, k, model, made)
        if code:
            print(f"  verify --live: exit {code}: {live.get('error')}")
        print(f"{kind} {where} altered by {by:g}: {verified.get('cause')}; {told(verified)}", flush=True)
        if kind == "length":
            print(f"  calibrate arm: {corrected(folder, k, model)}", flush=True)


def offline(folder: Path, k: int, model: Path, made: Path) -> Any:
    """Return what verify says of the recording."""
    shutil.rmtree(folder / f"run{k}", ignore_errors=True)
    armsight("convert", "recording", f"live{k}/live.mcap", "-o", f"run{k}", into=folder)
    rows = ("--measured", f"run{k}/poses.csv", "--joints", f"run{k}/joints.csv", "--world", made / "world.yaml")
    return armsight("verify", *rows, "--arm", model, "--overwrite", "--json", "-o", f"verified{k}", into=folder)[1]


def told(verified: Any) -> str:
    values = verified.get("parameters", {})
    return ", ".join(f"{name} {one['value']:.5f} +- {one['std']:.5f}" for name, one in values.items())


def corrected(folder: Path, k: int, model: Path) -> str:
    """Return the corrections that calibrate arm finds, the surest first."""
    words = ("--measured", f"run{k}/poses.csv", "--joints", f"run{k}/joints.csv", "--arm", model)
    armsight("join", *words, "--json", "-o", f"rows{k}.csv", into=folder)
    _, found = armsight("calibrate", "arm", "--model", model, "--points", f"rows{k}.csv", "--json", "-o",
                        f"calibrated{k}.yaml", into=folder)  # fmt: skip
    stds = {name: one for name, one in found.get("std", {}).items() if one}
    changes = [(name, value, stds[name]) for name, value in found.get("corrections", {}).items() if name in stds]
    surest = sorted(changes, key=lambda one: -abs(one[1]) / one[2])[:3]
    return ", ".join(f"{name} {value:+.5f} +- {std:.5f}" for name, value, std in surest)


def target_m(joints: Array, made: Path) -> Array:
    """Return the target's origin (n, 3) in the base's axes at joints (n, 6) in rad, by the textbook's four factors."""
    mount = yaml.safe_load((made / "scenario.yaml").read_text())["target"]["T_flange_target"]["xyz_m"]
    out = np.tile(np.eye(4), (len(joints), 1, 1))
    for j in range(6):
        turn = np.tile(np.eye(4), (len(joints), 1, 1))
        turn[:, :3, :3] = (
            Rotation.from_euler("x", ALPHA[j]) * Rotation.from_rotvec(np.outer(joints[:, j], [0.0, 0.0, 1.0]))
        ).as_matrix()
        turn[:, :3, 3] = [A[j], 0.0, 0.0] + D[j] * turn[:, :3, 2]
        out = out @ turn
    return np.asarray(out[:, :3, 3] + out[:, :3, :3] @ np.asarray(mount))


def columns_m(path: Path) -> Array:
    with path.open() as file:
        return np.array([[float(row[k]) for k in ("x_m", "y_m", "z_m")] for row in csv.DictReader(file)])


def away_m(points: Array, line: Array) -> Array:
    """Return the distance (n,) of points from the polyline."""
    a, way = line[:-1], np.diff(line, axis=0)
    along = np.einsum("nmi,mi->nm", points[:, None] - a, way) / np.maximum(np.einsum("mi,mi->m", way, way), 1e-18)
    foot = a + np.clip(along, 0.0, 1.0)[..., None] * way
    return np.asarray(np.linalg.norm(points[:, None] - foot, axis=2).min(axis=1))


def run_seam(folder: Path) -> None:
    """Print how far the light was truly from the seam that was shown, as taught and as played."""
    made = cell(folder, "--frames", 150, "--home=0.1,-0.4,0.4,-0.8,0.9,0.4")  # off the end of joint 3
    rig = ("--rig", made / "rig.yaml", "--target", made / "target.yaml", "--world", made / "world.yaml")
    shown = columns_m(made / "truth_world.csv")
    armsight("teach", "--left", made / "left", "--right", made / "right", *rig, "--every", 2, "--mean", "--overwrite",
             "--json", "-o", "taught", into=folder)  # fmt: skip
    armsight("path", "smooth", "taught/path.csv", "--bound-m", 0.0005, "--json", "-o", "smooth.csv", into=folder)
    armsight("path", "resample", "smooth.csv", "--step-m", 0.002, "--json", "-o", "even.csv", into=folder)
    taught = 1e3 * away_m(shown, columns_m(folder / "even.csv"))
    arm = yaml.safe_load((folder / "puma.yaml").read_text())
    with Recorded(arm=arm, clock=SystemClock()) as twin, twin.record() as found:
        words = ("play", "--robot", twin.address, "--arm", made / "arm.yaml", "--path", "even.csv")
        speeds = ("--path-speed", 0.03, "--approach-speed", 0.05, "--yes", "--overwrite", "--json", "-o", "played")
        code, done = armsight(*words, *speeds, *SETTINGS, into=folder)
    played = 1e3 * away_m(shown, target_m(np.radians(found[1][::4]), made))
    print(f"seam of {1e3 * np.linalg.norm(np.diff(shown, axis=0), axis=1).sum():.0f} mm: from what was shown, RMS and "
          f"largest: taught {np.sqrt(np.mean(taught**2)):.4f}, {taught.max():.4f} mm; played "
          f"{np.sqrt(np.mean(played**2)):.4f}, {played.max():.4f} mm (exit {code})", flush=True)  # fmt: skip
    print(f"  {json.dumps(done)[:500]}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", default=list(PARTS))
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4, 5, 6])
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--keep", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        folder = args.keep or Path(made)
        folder.mkdir(exist_ok=True)
        if "identify" in args.parts:
            run_identify(folder, args.seeds)
        if "verify" in args.parts:
            run_verify(folder, args.runs)
        if "seam" in args.parts:
            run_seam(folder)


PARTS = ("identify", "verify", "seam")

if __name__ == "__main__":
    main()
