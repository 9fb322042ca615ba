"""Every English sentence of the page Cell, in one place for translation."""

from __future__ import annotations

INTRO = (
    "One recording of the moving arm calibrates all of it: the lenses, where the cameras stand to each other and to "
    "the arm's base, their clocks, the lights on the flange, and the arm's zeros and lengths. No board, no stops."
)
NOT_THIS_CELL = (
    "This wants cameras that stand beside the robot; this cell has mirrors, or the robot carries its cameras. Nothing "
    "is recorded here. Take the steps of the page Calibrate instead, or give cameras that stand, on the page Settings."
)
STEPS = ("Mount", "Move", "Result")
STEPS_NAME = "The three steps"
STEP = "{n} {title}"
NOW = "{n} {title}: you are here"

CHECK = "Look yourself, before anything moves"
CHECKS = (
    "Four lights or more on the flange, not in one plane, 3 to 15 cm apart, none symmetric to the others. They do not "
    "move on the flange.",
    "Two cameras or more that look at the place of work from different sides, 20 to 60 degrees between them, fastened "
    "well; exposure and focus locked.",
    "Nothing that moves shines as bright as the lights. Lamps that stand may be in view.",
    "No rig is needed beforehand: without one the state above says that nothing is measured, which does no harm here.",
)
TOLD = "What the software sees"
LEVELS = {"good": "Ready", "warn": "Look", "bad": "Not ready", "idle": "Later"}
LAMP = "{sign} {name}: {level}"
LAMPS = {
    "cameras": "Cameras",
    "lights": "Lights",
    "joints": "The arm's readings",
    "target": "Target",
    "arm": "Arm",
}

PICTURES = "Pictures come, {fps:.0f} of each camera a second: {sizes} px."
SLOW = (
    "{fps:.0f} pictures of each camera a second are few: clocks and quick motion are told badly. Lower exposure or "
    "size, or move slower."
)
NO_CAMERAS = "No cameras are set up, so nothing can be recorded. Give them on the page Settings."
NOT_MEASURING = "No pictures come: {why}. Nothing can be recorded. Look at plugs and power; the page Live starts anew."
STARTING = "The cameras are being opened."
LIGHTS = "{counts} of {n} lights are seen."
FEWER = (
    "{counts} of {n} lights are seen. Pictures that miss lights tell less. Turn the target to the "
    "cameras, or raise the exposure."
)
MORE = (
    "{counts} bright spots are seen, the target has {n} lights. Those that stand are left out by "
    "themselves; dim what moves or shines into the target's way."
)
LIGHTS_UNKNOWN = "{counts} bright spots are seen; how many there should be the target's file will tell."
JOINTS = "The robot tells {n} joints; they are recorded beside the pictures."
JOINTS_OTHER = (
    "The robot tells {n} joints, the arm's model has {wanted}: the log would be refused. Choose the model of this arm "
    "on the page Settings."
)
JOINTS_LOST = "{why}"
NO_ROBOT = (
    "No robot is connected, so nothing is recorded of it here. Let its controller log its joints during the motion, "
    "or run a planned one as told below; bring the log afterwards."
)
NO_TARGET = (
    "The cell has no target, so the lights have no size. Write their places into target.yaml, bring it into the folder "
    "and choose it on the page Settings."
)
NO_ARM = (
    "The cell has no arm, so nothing can be calibrated. Make its file with armsight convert arm NAME -o arm.yaml, and "
    "choose it on the page Settings."
)
BOARD = "The target is a board; this wants lights on the flange. Choose a lit target on the page Settings."
FEW_LIGHTS = (
    "The target has {n} lights; four at least tell how it is turned. Add some, and write them into target.yaml."
)
FLAT = (
    "The target's lights lie in one plane, within {mm:.1f} mm: lens and distance are hard to tell apart. Bring one of "
    "them out of it by 10 mm and more."
)
TARGET = "{n} lights, over {mm:.0f} mm."
ARM = "{name}, {n} joints."

MOVE_HELP = (
    "All joints turn by 20 degrees and more, the last three by far more. The lights go through the whole of all "
    "pictures, nearer and farther too, fast enough for the clocks (0.2 to 1 m/s), not repeating themselves, for one to "
    "two minutes. Nothing is touched on the way."
)
RECORD, END = "Record", "End the recording"
RECORDING = "Recording: {seconds:.0f} s"
RECORDED = "Recorded"
NOTHING_RECORDED = "Nothing yet."
JOINTS_SILENT = "The robot's readings stopped coming: {why}"
JOINTS_GAP = "Between two readings lay {gap:.1f} s, in which the pictures count for nothing."
LOG_OF = "log of the joints"
DROPPED = (
    "Pictures of {n} moments were dropped: disk or processor is too slow. Lower the size or rate where it goes on."
)
PROGRESS = "So far, of what is wanted"
COVERED = "{side} picture, {place}: lights in {n} pictures"
COVERAGE = "Pictures in which moving lights were in each ninth of the {side} picture"
PLANNED = "A planned motion"
PLANNED_HELP = (
    "A motion that tells most is planned and run by commands, in a terminal; record here meanwhile. The guard keeps "
    "the arm's limits; stay at the emergency stop."
)
PLAN_COMMAND = (
    "armsight calibrate cell-plan --model {arm} --target {target} --start=Q1,Q2,...{limits} -o {folder}/motion.csv"
)
RUN_COMMAND = (
    "armsight robot run --robot DRIVER:DEVICE --arm {arm}{limits} --motion {folder}/motion.csv -o {folder}/moved"
)
RUN_LOG = "The readings are in moved/joints.csv then: name that file in step 3."
RUN_HERE = (
    "Here the console holds the robot: move it with the keys below, or by hand. A planned motion (armsight robot run) "
    "needs the robot for itself: start the console without --robot for it, and bring its joints.csv."
)

LOG_HELP = (
    "The controller's log of this motion: t_s,q1,... in s and rad. Clocks need not agree. Name it as it is in the "
    "cell's folder; a file larger than 2 MB is copied there by hand."
)
LOGS = "In the folder: {names}"
LOG = "Log of the joints (joints.csv)"
CALIBRATE = "Calibrate the cell"
CANCEL = "Stop calibrating"
WORKING = "{note}, {done:.0f} of {total:.0f}"
KEPT = "Where it is refused nothing of the cell is changed; the recording stays until it is dropped."
USE_HELP = (
    "Measure with it puts rig, place, target, arm and hand-eye of this recording into the cell at once. A robot that "
    "is connected takes the arm from the next start of the console on."
)
ROWS = {
    "recorded": "Recorded",
    "tip, as both cameras measure it": "The tip, as both cameras measure it",
    "tip, as the cameras measure it": "The tip, as the cameras measure it",
    "tip, as the arm's joints say": "The tip, as the arm's joints say",
    "added by the noise of one pair": "Added by the noise of one pair",
    "scale": "Scale",
    "baseline": "Baseline",
    "seen": "Seen",
}
