"""Names of the files that commands write and read again: a command keeps what its run writes, by the same names."""

from pathlib import Path

RIG, TARGET, ARM, WORLD, HANDEYE = "rig.yaml", "target.yaml", "arm.yaml", "world.yaml", "handeye.yaml"
REPORT = "report.html"

POSES, POINTS, SPOTS, TUM, MEASURE = "poses.csv", "points.csv", "spots.csv", "poses.tum", "measure.json"
MEASURED = (POSES, POINTS, SPOTS, TUM, MEASURE, REPORT)
DEMO = "demo.json"

VERIFY, ERRORS, LIVE, MASTERING = "verify.json", "errors.csv", "live.mcap", "mastering.csv"
PLAN, PLAN_SUMMARY = "plan.csv", "plan.json"
VERIFIED = (VERIFY, ERRORS, REPORT, LIVE, MASTERING)

COMPARE = "compare.json"
COMPARED = (COMPARE, REPORT)

PLAY, PLAY_RECORDING = "play.json", "play.mcap"
PLAYED = (PLAY, PLAY_RECORDING)

SERVO, SERVO_RECORDING = "servo.json", "servo.mcap"
FOLLOWED = (SERVO, SERVO_RECORDING)

TEACH, PATH, TARGETS = "teach.json", "path.csv", "targets.csv"
TAUGHT = (TEACH, PATH, TARGETS, *FOLLOWED)

MOTION, MOTION_RECORDING, READINGS, FRAMES = "motion.json", "motion.mcap", "joints.csv", "frames.mcap"
MOVED = (MOTION, MOTION_RECORDING, READINGS, FRAMES)

CELL = "cell.json"
CELL_CALIBRATED = (RIG, WORLD, TARGET, ARM, CELL, REPORT)


def report_path(out: Path) -> Path:
    """Return where the report of a calibration file goes: rig.yaml -> rig.report.html."""
    return out.with_suffix(".report.html")
