"""Every English sentence of the console, in one place for translation."""

from __future__ import annotations

TITLE = "armsight"
PAGES = {
    "live": "Live",
    "calibrate": "Calibrate",
    "identify": "Identify",
    "teach": "Teach and play",
    "verify": "Verify",
    "settings": "Settings",
}
NAVIGATION = "Pages"

STOP = "STOP"
STOP_HELP = "Stop the robot now"
ENABLE = "Hold to enable"
ENABLE_HELP = "The robot moves only while this is held down"
NO_ROBOT = "No robot"

MEASURING = "Measuring"
LOST = "Target not seen"
POSITION_ONLY = "Position only"
STARTING = "Starting"
ENDED = "The frames have ended"
NO_CAMERAS = "No cameras are set up. Give rig, target and both cameras on the page Settings."
FAILED = "Not measuring"
RESTART = "Start anew"

LEFT, RIGHT = "Left camera", "Right camera"
SCENE = "Cameras and target"
POSE = "Where the target is"
CURVES = "The last minute"
AXES = ("x", "y", "z", "rx", "ry", "rz")
FPS, LATENCY, COUNTS = "Pictures measured a second", "From light to pose", "Lost since the start"
SPREAD = "± {value} {unit} (1 σ)"
NO_VALUE = "–"

ADVICE = {
    "good": "Good: the lights are bright and sharp.",
    "nothing_seen": "No light is seen: aim the camera at the target, or raise its exposure.",
    "room_too_bright": "The room outshines the lights: lower the exposure, or shade the lamps.",
    "clipped": "The lights are clipped: lower the exposure until this hint goes.",
    "faint": "The lights are faint: raise the exposure, or come nearer.",
    "blurred": "The lights are blurred: focus the lens.",
    "too_sharp": "The lights are smaller than a pixel: defocus the lens a little, or come nearer.",
}
ADVICE_FIGURES = "background {background:.0f}, brightest {brightest}, width {width} px"

SEARCH = "How lights are looked for"
THRESHOLD = "Threshold (grey level; empty: found by itself)"
INVERTED = "Dark spots on light"
MASK = "Mask with the pointer"
UNMASK = "Remove all masks"
MASK_HELP = "Drag a rectangle over lamps and windows: nothing is looked for inside."

RECORD = "Record"
END_RECORDING = "End recording"
RECORDING = "Recording {file}: {pairs} pairs"
RECORDED = "Recorded {file}"
DROPPED = "{n} dropped, the disk is too slow"
