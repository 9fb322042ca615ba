"""Cures of batches, the history, joined tables, plans and verifications."""

import contextlib
import math
import random
import sqlite3
from pathlib import Path

from armsight_lab.batch.jobs import check_inputs, check_names
from armsight_lab.batch.request import BatchJob
from armsight_lab.batch.run import _require_free
from armsight_lab.cli.batch import _listed
from armsight_lab.cli.batch_commands import checked_job
from armsight_lab.cli.batch_jobs import jobs_of_file, jobs_of_pattern
from armsight_lab.history.database import VERSION_TABLE, writing
from armsight_lab.history.place import place_of

HEAD = "q1,q2,q3,q4,q5,q6\n"


def row(values):
    return ",".join(f"{value:.6f}" for value in values) + "\n"


def by_chance(seed, count):
    draw = random.Random(seed)
    return HEAD + "".join(row(draw.uniform(-1.0, 1.0) for _ in range(6)) for _ in range(count))


def over_time(rest_s=0.0):
    """Return 6 s of joints that never repeat, which rest for some of it after 3 s."""
    lines = ["t_s," + HEAD]
    for step in range(150):
        t = 0.04 * step
        moved = min(t, 3.0) + max(0.0, t - 3.0 - rest_s)
        slow = [
            0.3 * math.sin((0.7 + 0.31 * k) * moved + k) + 0.2 * math.sin(1.713 * moved * (k + 1)) for k in range(6)
        ]
        lines.append(row([t, *slow]))
    return "".join(lines)


FILES = {
    "j.csv": by_chance(1, 30),
    "moving.csv": over_time(),
    "resting.csv": over_time(2.0),
    "runs/a.csv": by_chance(2, 3),
    "runs/b.csv": by_chance(3, 3),
    "more/a.csv": by_chance(3, 3),
    "list.json": "[1]",
    "no.json": "{",
    "done/verify.json": "{}",
    "v1.yaml": "version: 1\njobs:\n- {name: a, command: kinematics fk, arm: ur10, joints: j.csv}\n",
    "v2.yaml": "version: 2\njobs:\n- {name: a, command: kinematics fk, arm: ur10, joints: j.csv}\n",
}

FK = ["kinematics", "fk", "--arm", "ur10", "--joints"]
SETTINGS = {"fps": None, "max_skew_s": None}
OUT = Path("batch")


def pattern(*words, name="{name}", files="runs/*.csv"):
    return lambda: jobs_of_pattern(files, name, [*FK, *words], SETTINGS)


def listed(*words, **more):
    return lambda: _listed(BatchJob(jobs=list(words), out=OUT, **more))


def checked(*words):
    return lambda: checked_job("a", "kinematics fk", [*FK[2:], *words], SETTINGS, "row 1")


def named(name):
    return lambda: check_names(pattern("{}", name=name, files="[rm]*/a.csv")())


def reads(out):
    """A job that reads what the job a of an earlier batch wrote, in a batch of a job a that writes to a folder."""
    return lambda: check_inputs(jobs_of_pattern("j.csv", "a", [*FK, "batch/a/poses.csv"], SETTINGS), Path(out))


def held(**more):
    def begin():
        OUT.mkdir(exist_ok=True)
        (OUT / "batch.json").write_text("{}")
        _require_free(more.pop("out", OUT), **{"resume": False, "overwrite": False, **more})

    return begin


POSES = "kinematics fk --arm irb120 --joints {} -o measured.csv && "
MOVING, RESTING = (POSES.replace("{}", name) for name in ("moving.csv", "resting.csv"))
IN_TIME = "join --offset 0 --measured measured.csv --arm irb120 -o x.csv --joints"
JOIN = "join --measured poses.csv -o x.csv"
OF_ARM = "--arm irb120 --joints j.csv"
VERIFY = "verify --measured poses.csv -o v"
PLANNED = "verify --plan --arm irb120 --side 0.25 -o p"
DESIGN = "design --target target.yaml --volume=-0.1:0.1,-0.1:0.1,0.5:0.7 --cells 2 -o d"
BOARD = "--board checkerboard:9x6:0.025 --views 20"
CAMERAS = "--size 1280x720 --focal-mm 4 --pixel-um 3 --baseline 0.2"
TREND = "history trend -o t --cell"
FIND = f"join --measured poses.csv {OF_ARM} -o x.csv && calibrate robot-world --arm irb120 --points x.csv -o w.yaml"

MEASURE = "measure --rig rig.yaml --target target.yaml --left left --right right -o"


def empty_history():
    with writing(place_of("empty.db")):
        pass


def foreign():
    """Write a database of another program."""
    with contextlib.closing(sqlite3.connect("foreign.db")) as other:
        other.execute("CREATE TABLE songs (name TEXT)")
        other.commit()


def newer():
    """Write a history of a schema to come."""
    empty_history()
    with contextlib.closing(sqlite3.connect("empty.db")) as history:
        history.execute(f"UPDATE {VERSION_TABLE} SET version_num = 'later'")
        history.commit()
    Path("empty.db").rename("newer.db")


def spoil():
    Path("m2/measure.json").write_text('{"made_with": 3}')


TRIED = {
    ("ops/join.py", "Leave --still away"): (f"{MOVING}{IN_TIME} moving.csv --still", f"{MOVING}{IN_TIME} moving.csv"),
    ("ops/join.py", "Give --as with"): (f"{JOIN} {OF_ARM} --as nothing", f"{JOIN} {OF_ARM} --as observed"),
    ("ops/join.py", "Give --joints with --arm, or"): (JOIN, f"{JOIN} {OF_ARM}"),
    ("ops/join.py", "or --as pairs"): (
        f"{JOIN} --robot-stream poses.csv --setup eye-to-hand --offset 0",
        "{} --as pairs",
    ),
    ("ops/verification/run.py", "Give --arm with --joints joints.csv, --commanded"): (VERIFY, f"{{}} {OF_ARM}"),
    ("ops/verification/run.py", "and verify twice for both"): (
        f"{VERIFY} {OF_ARM} --commanded places.csv",
        f"{VERIFY} {OF_ARM} && {VERIFY}2 --commanded places.csv",
    ),
    ("ops/verification/run.py", "Give --arm with the arm they are of"): (f"{VERIFY} --joints j.csv", "{} --arm irb120"),
    ("ops/verification/run.py", "Give --joints joints.csv: t_s"): (f"{VERIFY} --arm irb120", "{} --joints j.csv"),
    ("ops/verification/run.py", "earlier `armsight verify -o`"): (
        f"{VERIFY} {OF_ARM} --compare done",
        f"{VERIFY}0 {OF_ARM} && {VERIFY} {OF_ARM} --compare v0",
    ),
    ("cli/verify.py", "Give --arm with its file"): ("verify --plan -o p", PLANNED),
    ("cli/verify.py", "Give --measured FILE, or"): ("verify -o p", PLANNED),
    ("ops/verification/run.py", "Give --arm FILE.urdf"): (
        f"{VERIFY} --commanded places.csv --tip tool0",
        "convert arm irb120 -o arm.urdf && verify --measured poses.csv -o v --joints j.csv --arm arm.urdf --tip tool",
    ),
    ("cli/verify.py", "Add --plan, or leave it out"): (f"{VERIFY} {OF_ARM} --side 0.2", f"{VERIFY} {OF_ARM}"),
    ("cli/verify.py", "Plan with --plan"): (f"{PLANNED} --measured poses.csv", PLANNED),
    ("store/atomic.py", "or --overwrite"): (
        f"{VERIFY} {OF_ARM} && {VERIFY} {OF_ARM}",
        f"{VERIFY} {OF_ARM} --overwrite",
    ),
    ("ops/verification/mastering.py", "Give --joints with q1"): (
        "verify --mastering --measured poses.csv --arm irb120 -o m",
        "{} --joints j.csv",
    ),
    ("armsight_lab/design/plan.py", "Write metres, or the unit: 600mm"): (
        f"{DESIGN} {CAMERAS} {BOARD} --volume=-40m:40m,-40m:40m,50m:70m",
        f"{DESIGN} {CAMERAS} {BOARD} --volume=-40mm:40mm,-40mm:40mm,500mm:700mm",
    ),
    ("armsight_lab/design/plan.py", "Give --board and --views"): (
        f"{DESIGN} --rig rig.yaml --baseline 0.2",
        f"{{}} {BOARD}",
    ),
    ("armsight_lab/design/plan.py", "Give --rig rig.yaml, or"): (f"{DESIGN} {BOARD}", f"{{}} {CAMERAS}"),
    ("armsight_lab/design/plan.py", "Give both, or --focal-px"): (
        f"{DESIGN} {BOARD} --size 1280x720 --focal-mm 4 --baseline 0.2",
        "{} --pixel-um 3",
    ),
    ("armsight_lab/design/plan.py", "Give --focal-px with --size"): (
        f"{DESIGN} --rig rig.yaml {BOARD} --size 1280x720",
        "{} --focal-px 900",
    ),
    ("armsight_lab/design/plan.py", "or the unit: 120mm"): (
        f"{DESIGN} {BOARD} --size 1280x720 --focal-mm 4 --pixel-um 3 --baseline 20m",
        f"{DESIGN} {BOARD} --size 1280x720 --focal-mm 4 --pixel-um 3 --baseline 200mm",
    ),
    ("armsight_lab/design/plan.py", "--focal-mm is in millimetres"): (
        f"{DESIGN} {BOARD} --size 1280x720 --focal-mm 0.004 --pixel-um 3 --baseline 0.2",
        f"{DESIGN} {BOARD} {CAMERAS}",
    ),
    ("armsight_lab/design/plan.py", "Give --world world.yaml"): (
        f"{DESIGN} {BOARD} {CAMERAS} --arm ur10",
        f"design --target cell/target.yaml --volume=-1:-0.8,-0.3:0.1,0.1:0.4 --cells 2 -o d {BOARD} --rig cell/rig.yaml"
        " --arm ur10 --world cell/world.yaml --poses 6",
    ),
    ("armsight_lab/design/plan.py", "Give --board checkerboard"): (f"{DESIGN} {CAMERAS}", f"{{}} {BOARD}"),
    ("armsight_lab/design/plan.py", "Give --arm with it"): (
        f"{DESIGN} {BOARD} {CAMERAS} --mount=0,0,0.1",
        f"design --target cell/target.yaml --volume=-1:-0.8,-0.3:0.1,0.1:0.4 --cells 2 -o d {BOARD} --rig cell/rig.yaml"
        " --arm ur10 --world cell/world.yaml --poses 6 --mount=0,0,0.1",
    ),
    ("armsight_lab/design/request.py", "Write for instance --volume="): (
        f"{DESIGN} {BOARD} {CAMERAS} --volume=1:2",
        f"{DESIGN} {BOARD} {CAMERAS} --volume=-0.2:0.2,-0.1:0.1,0.6:1.0",
    ),
    ("armsight_lab/history/adding.py", "Give --cell NAME"): (
        f"{FIND} && history add w.yaml",
        "history add w.yaml --cell a",
    ),
    ("cli/command.py", "Add --cell NAME"): (f"{FIND} --history b.db", f"{FIND} --history b.db --cell NAME"),
    ("armsight_lab/history/database.py", "File a run with --cell NAME"): (
        "history list --history none.db",
        f"{FIND} --cell NAME --history none.db && history list --history none.db",
    ),
    ("armsight_lab/history/entry.py", "Give a name such as"): (f"{FIND} --cell ' a'", f"{FIND} --cell weld-3"),
    ("armsight_lab/history/entry.py", "Give what --json printed, a"): (
        "history add no.json --cell a",
        f"{VERIFY} {OF_ARM} && history add v/verify.json --cell a",
    ),
    ("armsight_lab/history/entry.py", "Give what --json printed"): (
        "history add list.json --cell a",
        f"{VERIFY} {OF_ARM} && history add v/verify.json --cell a",
    ),
    ("armsight_lab/history/looking.py", "armsight history list shows"): (
        "history show 99",
        "history list && history show 1",
    ),
    ("armsight_lab/history/looking.py", "Ask for more: armsight"): (
        "history export -o x.csv --since 2030-01-01",
        "history list && history export -o x.csv",
    ),
    ("armsight_lab/history/trend.py", "Ask for more with --since"): (f"{TREND} a --since 2030-01-01", f"{TREND} a"),
    ("armsight_lab/history/trend.py", "Name other figures with --figure"): (
        f"{TREND} untold",
        "{} --figure baseline_m",
    ),
    ("armsight_lab/history/trend.py", "name the other figures with"): (
        f"{TREND} wide",
        f"{TREND} untold --figure baseline_m",
    ),
    ("armsight_lab/history/looking.py", "File one with --cell NAME"): (
        (empty_history, "history list --cell a --history empty.db"),
        f"{FIND} --cell a --history empty.db && history list --cell a --history empty.db",
    ),
    ("armsight_lab/history/database.py", "Give another file with --history"): (
        (foreign, "history list --history foreign.db"),
        "history list --history history.db",
    ),
    ("armsight_lab/history/database.py", "Update armsight, or give another"): (
        (newer, "history list --history newer.db"),
        "history list --history history.db",
    ),
    ("armsight_lab/history/database.py", "bring a copy back"): (
        "history list --history list.json",
        "history list --history history.db",
    ),
    ("ops/compare/runs.py", "Give the folder that `armsight measure -o`"): (
        (f"{MEASURE} m1 && {MEASURE} m2", spoil, "compare m1 m2 -o c"),
        f"{MEASURE} m2 --overwrite && compare m1 m2 -o c",
    ),
    ("ops/compare/calibrations.py", "Give two calibrations of one arm"): (
        "convert arm ur10 -o a.yaml && convert arm panda -o b.yaml && compare a.yaml b.yaml -o c",
        "compare a.yaml a.yaml -o c",
    ),
    ("armsight_lab/batch/jobs.py", "with --each by --name"): (named("{name}"), named("{parent}-{name}")),
    ("armsight_lab/batch/jobs.py", "with another folder (-o)"): (reads("batch"), reads("second")),
    ("armsight_lab/batch/run.py", "--resume to do what is missing"): (held(), held(resume=True)),
    ("armsight_lab/cli/batch.py", "Give one jobs.csv or jobs.yaml"): (listed(), listed("v1.yaml")),
    ("armsight_lab/cli/batch.py", "Write it after --:"): (
        listed(each="runs/*.csv"),
        listed(*FK, "{}", each="runs/*.csv"),
    ),
    ("armsight_lab/cli/batch_commands.py", "lists the flags"): (
        checked("j.csv", "--jonts", "x"),
        "kinematics fk --help",
    ),
    ("armsight_lab/cli/batch_commands.py", "Leave --help away"): (checked("j.csv", "--help"), checked("j.csv")),
    ("armsight_lab/cli/batch_jobs.py", "Write {} where"): (pattern("j.csv"), pattern("{}")),
    ("armsight_lab/batch/job_files.py", "This armsight knows 1"): (
        lambda: jobs_of_file(Path("v2.yaml"), SETTINGS),
        lambda: jobs_of_file(Path("v1.yaml"), SETTINGS),
    ),
}
