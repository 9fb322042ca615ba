"""The oracle of a change that must change nothing: what every command writes, kept, and two keepings compared.

    python tools/outputs.py keep BEFORE --source OTHER_CHECKOUT    # runs the commands of that checkout's src
    python tools/outputs.py keep AFTER
    python tools/outputs.py compare BEFORE AFTER                   # exits 1 and says where they differ

Each step of STEPS is one command line on simulated sets, run by itself in one folder, in order; what it wrote, what it
printed on stdout and stderr and its exit code are kept. Compared is every byte of every file, but for what two runs of
one and the same program tell differently: moments, durations, the folder's place and the hashes that hold those
(VARIES). `--only NAME` keeps the steps whose name holds NAME, and those that make their input.
"""

from __future__ import annotations

import argparse
import difflib
import os
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LIMIT_S = 300.0

SETS = """
webcam: simulate webcam-cell --frames 8 --seed 3 -o webcam
hand: simulate hand-cell --frames 4 --seed 2 -o hand
mirror-cell: simulate pachidis2005-static --frames 2 -o mirror-cell
rrp: simulate kapucu2005-rrp -o rrp
boards: simulate board-cell --frames 12 -o boards
points: simulate arm-points -o points
handeye-set: simulate handeye -o handeye-set
pivot-set: simulate pivot -o pivot-set
mirrors-set: simulate mirrors -o mirrors-set
circle: simulate korayem2018-circle -o circle
cell: simulate cell --frames 700 -o cell
zoomed: simulate board-cell --frames 8 --zoom 200 -o zoomed
workshop: simulate webcam-cell --frames 3 --room workshop -o workshop
"""
"""What makes the input of the steps; kept and compared like them."""

STEPS = """
measure: measure --rig webcam/rig.yaml --target webcam/target.yaml --left webcam/left --right webcam/right -o measured
measure-mirror: measure --rig mirror-cell/rig.yaml --target mirror-cell/target.yaml --image mirror-cell/image \
 -o measured-mirror
measure-text: measure --rig webcam/rig.yaml --target webcam/target.yaml --left webcam/left --right webcam/right \
 -o measured-text
record: record --cell hand-cell --frames 6 -o run.mcap
recording: convert recording run.mcap -o recording
rosbag: convert recording run.mcap --to rosbag2 -o bag
camera: calibrate camera boards/left --board checkerboard:9x6:0.025 -o camera.yaml
stereo: calibrate stereo --left boards/left --right boards/right --board checkerboard:9x6:0.025 -o stereo.yaml
xcorner: calibrate camera boards/left --board checkerboard:9x6:0.025 --detector xcorner -o xcorner.yaml
handeye: calibrate handeye --pairs handeye-set/pairs.csv -o handeye.yaml
handeye-images: calibrate handeye --images handeye-set/photos --camera handeye-set/camera.yaml \
 --board checkerboard:9x6:0.02 \
 --robot handeye-set/robot_poses.csv -o handeye-images.yaml
handeye-streams: calibrate handeye --robot-stream handeye-set/robot.csv --camera-stream handeye-set/poses.csv \
 -o streams.yaml
handeye-ros: convert handeye handeye.yaml --to easy_handeye2 --base base_link --flange tool0 -o handeye.calib
tooltip: calibrate tooltip --poses pivot-set/flange.csv -o tool.yaml
pivot: calibrate pivot --rig pivot-set/rig.yaml --target pivot-set/target.yaml --left pivot-set/left \
 --right pivot-set/right \
 -o pivot.yaml
mirrors: calibrate mirrors --image mirrors-set/complex --board checkerboard:7x5:0.015 -o mirrors.yaml
mirrors-check: calibrate mirrors --check --rig mirrors.yaml --image mirrors-set/complex --board checkerboard:7x5:0.015
arm: calibrate arm --model points/arm.yaml --points points/points.csv --holdout points/holdout.csv -o arm.yaml
propose: calibrate arm --model points/arm.yaml --points points/points.csv --propose 6 -o proposing.yaml
robot-world: calibrate robot-world --arm arm.yaml --points points/observed.csv -o world.yaml
identify: identify --rig rrp/rig.yaml --target rrp/target.yaml --left rrp/left --right rrp/right \
 --joints rrp/sweep_joints.csv \
 --world rrp/world.yaml -o identified.yaml
identify-sweep: identify --sweep identified.sweep.csv --rig rrp/rig.yaml -o again.yaml
arm-ur10: convert arm ur10 -o ur10.urdf
arm-craig: convert arm ur10.urdf -o ur10.yaml --convention craig
fk: kinematics fk --arm korayem6r --joints circle/joints.csv -o fk.csv
ik: kinematics ik --arm korayem6r --poses fk.csv --near circle/joints.csv -o ik.csv
jacobian: kinematics jacobian --arm korayem6r --joints circle/joints.csv -o jacobian.csv
path: kinematics path --arm korayem6r --poses fk.csv -o joints.csv
formulas: kinematics formulas --arm ur10 -o ur10.tex
formulas-python: kinematics formulas --arm ur10 -o ur10.py
show: kinematics show --arm ur10 --joints 0.3,-1.2,1.4,-0.5,1.2,0.4 -o show.html
join: join --joints circle/joints.csv --arm korayem6r --measured circle/truth_world.csv -o joined.csv
join-observed: join --joints circle/joints.csv --arm korayem6r --measured circle/truth.csv --as observed \
 -o observed.csv
verify: verify --measured circle/truth_world.csv --arm korayem6r --joints circle/joints.csv -o verified
verify-plan: verify --plan --arm ur10 -o plan
compare: compare camera.yaml xcorner.yaml -o compared
poses-tum: convert poses measured/poses.csv -o poses.tum
rig-opencv: convert rig webcam/rig.yaml --to opencv -o rig.yml
rig-kalibr: convert rig stereo.yaml --to kalibr -o camchain.yaml
camera-ros: convert camera camera.yaml --to ros -o camera_info.yaml
picks: path from-picks --left webcam/left/000000.png --right webcam/right/000000.png --rig webcam/rig.yaml \
 --picks picks.csv \
 --skip -o picked.csv
smooth: path smooth path.csv -o smooth.csv --bound-m 0.0005
resample: path resample smooth.csv -o even.csv --step-m 0.005
fillet: path fillet even.csv -o round.csv --radius-m 0.002
reverse: path reverse even.csv -o back.csv
check-path: path check even.csv --arm irb120 --speed-m-s 0.01 -o check.html
export-ur: path export even.csv -o seam.script --arm irb120 --speed-m-s 0.01 --blend-m 0.001
export-kuka: path export even.csv -o seam.src --arm irb120 --speed-m-s 0.01 --tool 1 --weld-output 7
export-abb: path export even.csv -o seam.mod --arm irb120 --speed-m-s 0.01 --tool torch
reproduce: reproduce kapucu2005 -o kapucu
offset: path offset even.csv --by-m -0.01 -o above.csv
angle: path angle even.csv --travel-deg 15 -o tilted.csv
joined-paths: path join even.csv back.csv -o both.csv
measure-workshop: measure --rig workshop/rig.yaml --target workshop/target.yaml --left workshop/left \
 --right workshop/right -o measured-workshop
measure-recording: measure --rig hand/rig.yaml --target hand/target.yaml --left hand/left --right hand/right \
 -o measured-hand
verify-run: verify --measured measured --arm webcam/arm.yaml --joints webcam/joints.csv --world webcam/world.yaml \
 -o verified-run
verify-text: verify --measured circle/truth_world.csv --arm korayem6r --joints circle/joints.csv -o verified-text
verify-check: verify --measured measured --arm ur10e --joints webcam/joints.csv --world webcam/world.yaml --check \
 -o verified-other
cell: calibrate cell --robot-log cell/joints.csv --left-spots cell/left.csv --right-spots cell/right.csv \
 --size 1280x720 --target cell/target.yaml --model cell/arm.yaml -o calibrated-cell
cell-plan: calibrate cell-plan --model webcam/arm.yaml --start=0,-1.07,1.63,-0.57,1.73,0.16 --duration 30 -o motion.csv
target: calibrate target --rig webcam/rig.yaml --left webcam/left --right webcam/right --lights 3 -o target.yaml
zoom-camera: calibrate camera zoomed/left --board checkerboard:9x6:0.025 --zoom 200 -o zoom200.yaml
fisheye: calibrate camera boards/left --board checkerboard:9x6:0.025 --lens fisheye -o fisheye.yaml
wrong-board: calibrate camera boards/left --board checkerboard:8x6:0.025 -o never.yaml
camera-text: calibrate camera boards/left --board checkerboard:9x6:0.025 -o camera-text.yaml
compare-distance: compare stereo.yaml webcam/rig.yaml --distance 1.2
compare-runs: compare measured measured-text -o compared-runs
report: report measured --overwrite
doctor-rig: doctor --rig webcam/rig.yaml --depth 1.5
design: design --rig webcam/rig.yaml --target webcam/target.yaml --volume=-0.2:0.2,-0.15:0.15,0.6:1 -o design
batch: batch jobs.csv -o batch
history-add: history add handeye.yaml verified --cell weld-3 --history runs.sqlite
history-list: history list --cell weld-3 --history runs.sqlite
history-show: history show 1 --history runs.sqlite
history-export: history export --cell weld-3 --history runs.sqlite -o weld-3.csv
teach: teach --from measured/poses.csv --tip tool.yaml -o taught
table-kuka: convert table log.txt --robot-format kuka --as robot_poses -o log.csv
table-twice: convert table log.txt --as robot_poses -o log-guessed.csv
recording-repaired: record --repair run.mcap -o mended.mcap
reader-empty: kinematics fk --arm ur10 --joints empty.csv -o never.csv
reader-header: kinematics fk --arm ur10 --joints header.csv -o never.csv
reader-twice: kinematics fk --arm ur10 --joints twice.csv -o never.csv
reader-cut: kinematics fk --arm ur10 --joints cut.csv -o never.csv
reader-degrees: kinematics fk --arm ur10 --joints degrees.csv -o never.csv
reader-missing: kinematics fk --arm ur10 --joints nothing.csv -o never.csv
reader-poses: kinematics ik --arm ur10 --poses header.csv -o never.csv
reader-points: calibrate arm --model ur10 --points header.csv -o never.yaml
reader-pairs: calibrate handeye --pairs header.csv -o never.yaml
reader-path: path smooth header.csv --bound-m 0.0005 -o never.csv
reader-yaml: measure --rig header.csv --target webcam/target.yaml --left webcam/left --right webcam/right -o never
reader-arm: convert arm webcam/rig.yaml -o never.urdf
reader-urdf: convert arm cut.urdf -o never.yaml
reader-recording: convert recording header.csv -o never
refused-board: calibrate camera boards/left --board checkerboard:9x6 -o never.yaml
refused-images: calibrate camera rrp --board checkerboard:9x6:0.025 -o never.yaml
refused-out: calibrate tooltip --poses pivot-set/flange.csv -o pivot-set/flange.csv
refused-overwrite: verify --measured circle/truth_world.csv --arm korayem6r --joints circle/joints.csv -o measured
refused-tip: calibrate tooltip --poses circle/truth_world.csv -o never.yaml
refused-hand: calibrate handeye --pairs short.csv -o never.yaml
refused-sweep: identify --sweep header.csv --rig rrp/rig.yaml -o never.yaml
refused-check: path check path.csv --arm irb120 --speed-m-s 100 -o never.html --check
refused-export: path export even.csv -o seam.xyz --arm irb120
refused-weld: path export even.csv -o never.src --arm irb120 --speed-m-s 0.01
refused-design: design --rig webcam/rig.yaml --target webcam/target.yaml --volume=0:0,0:0,1:1 -o never
refused-batch: batch header.csv -o never
refused-history: history show 99 --history runs.sqlite
refused-compare: compare camera.yaml measured
refused-room: simulate webcam-cell --room nowhere -o never
refused-scenario: simulate no-such-cell -o never
refused-robot: robot jog --robot nothing:1 --joint 1 --by 0.02
refused-world: calibrate robot-world --arm ur10 --points header.csv -o never.yaml
refused-size: calibrate cell --robot-log cell/joints.csv --left-spots cell/left.csv --right-spots cell/right.csv \
 --size 640 --target cell/target.yaml --model cell/arm.yaml -o never
refused-units: kinematics ik --arm ur10 --poses fk.csv --units furlong -o never.csv
refused-depth: doctor --rig webcam/rig.yaml --depth=-1
refused-arm: calibrate arm --model ur10 --points points/points.csv -o never.yaml
refused-flag: measure --rig webcam/rig.yaml --target webcam/target.yaml --left webcam/left -o never
refused-file: kinematics fk --arm rrp/rig.yaml --joints circle/joints.csv -o never.csv
refused-text: kinematics fk --arm ur10 --joints circle/joints.csv -o never.csv
"""
"""A name and what follows `armsight`, `--json` beside; a step's input is what the sets and the steps before it made."""

VARIES: tuple[tuple[re.Pattern[str], str], ...] = (
    (re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|[+-]\d\d:?\d\d)?"), "<moment>"),
    (re.compile(r"\d{4}-\d\d-\d\d"), "<day>"),
    (
        re.compile(r"(\"?\w*(?:took|per_frame|per_pose|compute|duration|elapsed)\w*_m?s\"?\s*[:=]\s*)[-+.\de]+"),
        r"\1<time>",
    ),
    (re.compile(r"\b\d+(\.\d+)? (ms|s|min)\b"), "<time>"),
    (re.compile(r",? ?\b\d+(\.\d+)? a second"), ""),
    (re.compile(r"(\"(?:ms_per_frame|seconds_s)\": )(\{[^}]*\}|[-+.\de]+)"), r"\1<time>"),
    (re.compile(r"(ms per pair, [^│]*│ *)[.\d]+"), r"\1<time>"),
    (re.compile(r"\b[0-9a-f]{64}\b"), "<hash>"),
)
"""What two runs of one program write differently, and what stands for it."""

FILES = {
    "picks.csv": "u_px,v_px\n600,300\n640,320\n680,340\n",
    "jobs.csv": "name,command,arm,joints\na,kinematics fk,ur10,good.csv\nb,kinematics fk,ur10,header.csv\n",
    "good.csv": "q1,q2,q3,q4,q5,q6\n0.1,-1.2,1.3,0.2,0.5,0.1\n0.2,-1.1,1.2,0.3,0.4,0.2\n",
    "empty.csv": "",
    "header.csv": "q1,q2,q3,q4,q5,q6\n",
    "twice.csv": "q1,q1,q3,q4,q5,q6\n0,0,0,0,0,0\n",
    "cut.csv": "q1,q2,q3,q4,q5,q6\n0.1,0.2,0.3,0.4,0.5,0.6\n0.1,0.2,0.",
    "degrees.csv": "q1,q2,q3,q4,q5,q6\n10,-95,80,20,35,170\n12,-90,85,25,30,175\n",
    "cut.urdf": '<robot name="a"><link name="base"/><joint name="j1" type="revolute">',
    "short.csv": "bf_x_m\n1\n",
    "log.txt": "X,Y,Z,A,B,C\n" + "500.0,20.0,300.0,10.0,20.0,170.0\n510.0,20.0,300.0,12.0,25.0,160.0\n" * 2,
}
"""Small inputs of the steps, some of them wrong."""

PATH_ROWS = [f"{i},,{0.42 + 0.002 * i:.4f},{0.05 * (i % 20) / 20:.4f},0.35,0,1,0,0,," for i in range(40)]


def steps(only: str | None) -> Iterator[tuple[str, list[str]]]:
    """Return name and arguments of each step, the sets first; with `only`, the sets and what has it in its name."""
    for text, always in ((SETS, True), (STEPS, False)):
        for line in text.replace("\\\n", "").strip().splitlines():
            name, _, command = line.partition(": ")
            if always or only is None or only in name:
                yield name, [*shlex.split(command), *([] if name.endswith("-text") else ["--json"])]


def keep(folder: Path, source: Path, only: str | None) -> None:
    """Run every step in `folder`/work and keep what it printed in `folder`/printed."""
    work, printed = folder / "work", folder / "printed"
    work.mkdir(parents=True)
    printed.mkdir()
    for name, text in FILES.items():
        (work / name).write_text(text, encoding="utf-8")
    header = "index,t_s,x_m,y_m,z_m,qx,qy,qz,qw,speed_m_s,tag"
    (work / "path.csv").write_text("\n".join([header, *PATH_ROWS]) + "\n", encoding="utf-8")
    sources = os.pathsep.join(str(source / part) for part in ("src", "sim/src", "plant/src", "lab/src"))
    environment = {**os.environ, "PYTHONPATH": sources, "COLUMNS": "100", "TERM": "dumb", "NO_COLOR": "1"}
    for name, arguments in steps(only):
        begun = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-m", "armsight", *arguments],
            cwd=work,
            env=environment,
            capture_output=True,
            stdin=subprocess.DEVNULL,
            timeout=LIMIT_S,
            check=False,
        )
        (printed / f"{name}.stdout").write_bytes(done.stdout)
        (printed / f"{name}.stderr").write_bytes(done.stderr)
        (printed / f"{name}.exit").write_text(f"{done.returncode}\n", encoding="utf-8")
        print(f"{name:18s} exit {done.returncode}  {time.perf_counter() - begun:5.1f} s", flush=True)


def comparable(path: Path, folder: Path) -> bytes:
    """Return a file's content without what varies from run to run; other than text, as it is."""
    content = path.read_bytes()
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError:
        return content
    text = text.replace(str(folder.resolve()), "<folder>")
    for pattern, instead in VARIES:
        text = pattern.sub(instead, text)
    return text.encode()


def differences(before: Path, after: Path) -> Iterator[str]:
    """Say each file that is in one alone or that differs, with the first lines that do."""
    names = {path.relative_to(folder) for folder in (before, after) for path in folder.rglob("*") if path.is_file()}
    for name in sorted(names):
        one, other = before / name, after / name
        if not (one.exists() and other.exists()):
            yield f"{name}: only in {before if one.exists() else after}"
            continue
        left, right = comparable(one, before), comparable(other, after)
        if left == right:
            continue
        lines = difflib.unified_diff(
            left.decode("utf-8", "replace").splitlines(),
            right.decode("utf-8", "replace").splitlines(),
            lineterm="",
            n=0,
        )
        shown = [line[:300] for line in lines if line[:1] in "+-" and line[:3] not in ("+++", "---")][:6]
        yield "\n    ".join([f"{name}: differs", *shown])


def main() -> int:
    """Keep or compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    keeping = commands.add_parser("keep")
    keeping.add_argument("folder", type=Path)
    keeping.add_argument("--source", type=Path, default=ROOT, help="another checkout, whose program is run")
    keeping.add_argument("--only", metavar="NAME")
    comparing = commands.add_parser("compare")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    given = parser.parse_args()
    if given.command == "keep":
        keep(given.folder, given.source.resolve(), given.only)
        return 0
    found = list(differences(given.before, given.after))
    print("\n".join(found) or "all equal")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
