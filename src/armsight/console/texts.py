"""Every English sentence of the console, in one place for translation; those of the page Cell are in texts_cell."""

from __future__ import annotations

TITLE = "armsight"
PAGES = {
    "live": "Live",
    "calibrate": "Calibrate",
    "cell": "Cell",
    "identify": "Identify",
    "teach": "Teach and play",
    "verify": "Verify",
    "settings": "Settings",
}
NAVIGATION = "Pages"

STOP = "STOP"
STOP_HELP = "Stop the robot now; the Escape key does the same"
ENABLE = "Hold to enable"
ENABLE_HELP = "Hold to enable: the robot moves only while this is held down"
RESET = "Release the stop"
OVERRIDE = "Speed"
WATCHING = "Your token may watch: see the page Live. The stop works for you as well."
PAGE_FAILED = "This page could not be built. What went wrong is in the log of the console."
GONE = "No connection to the console. The robot is held."
LOG_OUT = "Log out"
SHARED = "The port for stops cannot be reached: a stop shares the way of this page."
STALE = "The console was started anew. Load this page again."
ROBOT = {
    "ready": "Robot stands",
    "moving": "Robot moves",
    "stopped": "Robot is stopped",
    "lost": "Robot is not reached",
    "closed": "Robot is not open",
}
HOLDING = "Robot is held: {why}"
STOPPED_WHY = "Robot is stopped: {why}"
DRIVES = "{who} drives; you can watch, and stop"

JOG = "Move the robot by hand"
JOG_HELP = "Hold a key to move; it is its own enable. Speed is set above."
JOG_FRAMES = {"joints": "Joints", "base": "Tool along the base's axes", "tool": "Tool along its own axes"}
JOG_AXES = ("x", "y", "z", "turn x", "turn y", "turn z")
JOG_JOINT, JOG_KEY = "Joint {n}", "{axis} {sense}"
JOG_SENSES = {1: "plus", -1: "minus"}
JOINT_NOW, SLIDE_NOW = "{value:.1f} deg", "{value:.1f} mm"

MEASURING, LOST = "Measuring", "Target not seen"
POSITION_ONLY, DOUBTFUL = "Position only", "Pose is doubtful"
STARTING, ENDED = "Starting", "The frames have ended"
WITHOUT = "Measuring without {names}"
NO_CAMERAS = "No cameras are set up. Give rig, target and the cameras on the page Settings."
FAILED = "Not measuring"
SILENT = "No new picture for {seconds:.0f} s"
RESTART = "Start anew"
CAMERA_LOST = "The cameras give no pictures any more. Look at their plugs and their power, then start anew. ({why})"

PICTURES = {
    "left": "Left camera",
    "right": "Right camera",
    "complex": "Camera with mirrors: both views in one picture",
}
PICTURE = "Camera {name}"
SEES, FINDS = "Sees {n} of {of} lights.", "{n} bright spots."
GONE_CAMERA = "Lost: {why}. The others go on. Look at its plug, then start anew."
LEFT_OUT = "Left out: {why}"
COMPLEX_HELP = (
    "Left view (L): rings, blue lines. Right view (R): diamonds, pink lines. Squares: bright spots of neither."
)
VIEW_MARKS = {"left": "L", "right": "R"}
OPENING = {
    "load": "The program is being loaded. After an update this takes a minute once.",
    "robot": "The robot {robot} is being opened.",
    "measure": "The cameras are being opened, and measuring begins.",
}
"""What is done before there are pages."""
SCENE = "Cameras and target"
SCENE_HELP = "Drag to turn the scene, wheel to come nearer."
ELLIPSOID = "Ellipsoid: 1 σ of the position, drawn {scale:,.0f} times as large."
TRACK = "Track: blue where known best (± {least:.3f} mm), orange where worst (± {most:.3f} mm)."
ROBOT_TRACK = "Black, dashed: where the arm's tool was."
PATHS_SCENE = "Taught, measured, and where the robot was"
PATHS_LEGEND = {
    "taught": "Taught path: violet line with balls",
    "measured": "Measured target, its tip where one is calibrated: dots, blue where known best, orange where worst",
    "tool": "The arm's tool by the robot's own joints: black, dashed",
}
LOOK_AT_PATHS, LOOK_AT_CELL = "Look at the paths", "Look at the cell"
NO_PATHS = "There is nothing to look at yet: teach a path, or move the target before the cameras."
POSE = "Where the target is"
CURVES = "The last minute"
AXES = ("x", "y", "z", "rx", "ry", "rz")
FPS, LATENCY, COUNTS = "Pictures measured a second", "From light to pose", "Lost since the start"
POSITION_COUNT = "Position only since the start"
SEEING, SEEING_VALUE, SIGHTS = "Cameras that see it", "{n} of {of}", "{n} of {of} sights"
RESIDUAL, RESIDUAL_VALUE = "Residual, RMS", "{value:.3f} px"
COUNT, OF_ALL = "{n} ({share:.1%})", "of {total} pictures"
SPREAD = "± {value} {unit} (1 σ)"
NO_VALUE = "–"
FIELD_EMPTY = "The field “{field}” is empty"
FIELD_NO_NUMBER = "The field “{field}” holds “{value}”, which is no number"
FIELD_BEYOND = "The field “{field}” holds {value:g}; it takes {low:g} to {high:g}"
FIELD_NOT_WHOLE = "The field “{field}” holds {value:g}, which is no whole number"
FIELD_NO_TEXT = "The field “{field}” holds what is no line of text"
FIELD_OUTSIDE = "The field “{field}” names “{value}”, which is not in the cell's folder"
FIELD_CONSEQUENCE = "Nothing is done, and nothing moves"
FIELD_CURE = "Type it anew; a figure in the unit beside its name"

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
ADVICE_CLIPPED, ADVICE_EXPOSURE = ", {n} saturated", ", exposure {ms:.2f} ms"

SEARCH = "How lights are looked for"
THRESHOLD = "Threshold (grey level; empty: found by itself)"
INVERTED = "Dark spots on light"
MASK = "Mask with the pointer"
MASKS_FULL = "There are {n} masks on this picture already"
UNMASK = "Remove all masks"
MASK_HELP = "Drag a rectangle over lamps and windows: nothing is looked for inside."

RECORD = "Record"
END_RECORDING = "End recording"
RECORDING = "Recording {file}: {n} of each camera"
RECORDED = "Recorded {file}"
DROPPED = "{n} dropped, the disk is too slow"

STEP = "What to calibrate"
STEPS = {
    "camera-left": "Left camera's lens",
    "camera-right": "Right camera's lens",
    "stereo": "Both cameras",
    "cameras": "All cameras",
    "mirrors": "Mirrors before one camera",
    "timing": "Timing of free-running cameras",
    "tooltip": "Tool tip",
    "handeye": "Hand-eye",
    "arm": "Arm",
}
ONE_CAMERA = "The camera's lens"
LENS_OF = "Lens of {name}"
WHOLE_CELL = "All of it at once, from one recording"
NEXT = {
    "board_twice": "Hold the board still, whole in both views of the picture, the two beside each other; accept it.",
    "show_lights": "Hold the lit target still, all lights in both views of the picture, and accept it.",
    "needs_lens": "The lit target does not tell the lens: calibrate it first, with the mirrors taken off.",
    "needs_baseline": "The lit target does not tell the scale: give the baseline as designed, below.",
    "needs_target": "Choose the target on the page Settings (target.yaml).",
    "turn_lights": "Turn the target to another side, nearer or further, left or right, and accept it.",
    "show_board": "Hold the board still before the cameras, whole in the picture, and accept it.",
    "join": "Show the board to the {side} camera and to another one at the same time, and accept it.",
    "to_cell": "Bring the board into the {place} of the {side} picture.",
    "tilt": "Tilt the board by 30 degrees, to one side or the other, up or down.",
    "nearer": "Come nearer with the board.",
    "turn_target": "Turn the target about another axis, with its tip resting on the point.",
    "move_robot": "Move the robot to another place and turn its hand, then accept.",
    "turn_hand": "Turn the hand about its own {axis}, both ways, and accept a pose at each end: {share:.0%} of what is "
    "needed is there. The lights must stay in the pictures.",
    "record": "Press accept, wave the target through all pictures for 20 seconds, and press accept again.",
    "record_cell": "Press Record, then move the arm: all joints, through the whole of all pictures.",
    "lights_back": "Bring all lights back into the {side} picture.",
    "move_joint": "Move joint {axis} more: {share:.0%} of what is needed is there.",
    "to_place": "Bring the lights into the {place} of the {side} picture.",
    "go_on": "Go on: nearer to the cameras and farther from them, other turns of the wrist, a rest now and then.",
    "end_recording": "There is enough: end the recording, or go on to two minutes.",
    "bring_log": "Bring the controller's log of this motion, name it below, then calibrate.",
    "more": "Good. Accept some more, each at another place and tilt.",
    "run": "There is enough: calibrate.",
    "not_possible": "{why}",
}
PLACES = (
    ("upper left", "upper middle", "upper right"),
    ("left", "middle", "right"),
    ("lower left", "lower middle", "lower right"),
)
SIDES = {"left": "left", "right": "right", "complex": "camera's"}
ROW_NAMES = {
    "baseline": "Baseline",
    "± baseline": "± baseline",
    "left focal length": "Left focal length",
    "right focal length": "Right focal length",
    "focal length": "Focal length",
    "± left focal length": "± left focal length",
    "± right focal length": "± right focal length",
    "± focal length": "± focal length",
    "principal point": "Principal point",
    "± principal point": "± principal point",
    "k1": "Distortion k1",
    "± k1": "± distortion k1",
    "RMS": "Residual, RMS",
    "residual, RMS": "Residual, RMS",
    "RMS of boards left out": "Residual of boards left out, RMS",
    "picture covered": "Picture covered",
    "axes turn towards each other": "Axes turn towards each other",
    "right view lower": "Right view lower",
    "right view turned": "Right view turned",
    "± convergence": "± turn towards each other",
    "glass plate": "Glass plate",
    "images used": "Images used",
    "one lens explains both views": "One lens explains both views",
}
"""Names of rows and plots as the guided steps give them, in words; a name that is not here is shown as it is."""
WHAT_NEXT = "What to do next"
COVERED = "{side} picture, {place}: {n} boards"
SO_FAR = "How sure it is so far (1 σ)"
SO_FAR_PLOT = "Against the number of samples"
NO_PLOT_YET = "Nothing to plot yet: accept some more."
SAMPLES = "Accepted"
DROP = "Drop"
ACCEPT = "Accept"
CALIBRATE = "Calibrate"
RUNNING = "Calibrating …"
VERDICT = "Verdict"
NOT_CALIBRATED = "Not calibrated"
SAVED = "Saved as {file}"
REPORT = "Report"
USE_IT = "Measure with it"
USE_LENS = "Take it as the cell's lens"

MIRRORS_BUILT = "How the mirrors were built"
MIRRORS_BUILT_HELP = (
    "The board needs none of these for the calibration. The lit target, and turning the mirrors until the axes are "
    "parallel, need the baseline as designed, and the lens: calibrate it with the mirrors taken off. Keeping other "
    "figures begins the step anew."
)
MIRRORS_SHOWN = {"board": "A board is shown", "target": "The lit target is shown"}
MIRRORS_FIELDS = {
    "baseline_m": ("Baseline as designed, mm", 1.0),
    "near_m": ("Lens to plate, mm", 1.0),
    "gap_m": ("Plate to mirror 3, mm", 1.0),
    "plate_m": ("Plate, mm (empty: found)", 0.1),
    "index": ("Plate's refractive index", 0.01),
}
MIRRORS_KEEP = "Keep these"
MIRRORS_WRONG = "These figures cannot be: lengths are above zero, the refractive index is from 1 to 3."
ALIGNMENT = "The mirrors' alignment, live"
ALIGNMENT_WATCH = "Look once a second, at the board whole in both views; the answer is of the last four looks"
ALIGNMENT_UNSURE = (
    "Too little is told: the angles are known to ± {std:.2f} mrad only. Bring the board nearer, or a larger one."
)
ALIGNMENT_STARTING = "No look yet"
ALIGNMENT_NEEDS = (
    "Which way to turn is told once the lens (page Settings) and the baseline (below) are given, or a rig."
)
ALIGNMENT_UNSEEN = "The board is not seen in both views: {why}"
HELD_RIG = "Held against the rig as it was calibrated: what has moved since is told."
HELD_PARALLEL = "Held against parallel axes, as the rig was designed: turn the mirrors until nothing is left to turn."
AGAINST = (("Hold against the calibrated rig", "against-rig"), ("Hold against parallel axes", "against-parallel"))
ALIGNED_RIG = "The mirrors stand as they were calibrated"
ALIGNED_PARALLEL = "The axes are parallel, as far as a hand can turn a screw"
TURN_NEXT = "Turn next"
MIRROR_TURN = "Mirror {mirror}: {turns}"
TURN_CLOCKWISE = "turn {angle:.2f} mrad clockwise, seen from above"
TURN_ANTICLOCKWISE = "turn {angle:.2f} mrad anticlockwise, seen from above"
TILT_BACK = "tilt its upper edge {angle:.2f} mrad back, to the camera's side"
TILT_FORWARD = "tilt its upper edge {angle:.2f} mrad forward, away from the camera"
OTHER_MIRRORS = "It may have been mirror {mirrors} instead: the views do not tell them apart."
SEVERAL_MIRRORS = "More than one mirror has moved: begin with this one."
ALIGNMENT_ANGLES = {
    "convergence_rad": "Axes turn towards each other",
    "vertical_rad": "Right view points lower",
    "roll_rad": "Right view is turned",
}
ANGLE, ANGLE_STD = "{value:+.2f} mrad", "± {std:.2g} mrad (1 σ)"
ALIGNMENT_LEGEND = ("towards each other", "lower", "turned")
ALIGNMENT_PLOT = "The last looks (mrad)"

FILES = "Files of the cell, in {folder}"
CAMERAS = "Cameras"
FIELDS = {
    "left": "Left or only camera, or its files",
    "right": "Right camera; empty: one with mirrors",
    "cameras": "Further cameras, or all, by name: NAME=SOURCE; NAME=SOURCE",
    "board": "Board, such as checkerboard:9x6:0.025",
    "rig": "Rig (rig.yaml)",
    "target": "Target (target.yaml)",
    "world": "Place of the rig (world.yaml)",
    "arm": "Arm (arm.yaml)",
    "handeye": "Hand-eye (handeye.yaml)",
    "tip": "Tool tip (tip.yaml)",
    "limits": "Limits of motion (limits.yaml)",
    "camera": "Lens of a mirror rig (camera.yaml)",
}
PLAY_AGAIN = "Files begin anew at their end"
APPLY = "Use these"
APPLIED = "In use, and saved in cell.yaml."
UPLOAD = "Bring a file into the folder (at most {mb} MB)"
UPLOADED = "{name} is in the folder."
TOO_BIG = "The file is larger than {mb} MB and was not taken."
NOT_A_NAME = "{name} is no file name of this cell: YAML, CSV and URDF files are taken."
EMPTY_FILE = "{name} is empty and was not taken. Look whether it was copied whole."
NOT_SENT = "The file was not sent: the console does not answer. Look at the network, then choose the file again."
EXISTS = "{name} is there already. Remove it first, or give the file another name."

VERIFY = "Measured poses against the arm's own joints"
VERIFY_FIELDS = {
    "measured": "Measured poses or points (poses.csv, points.csv)",
    "joints": "Joint readings (joints.csv); empty where repeats alone are judged",
}
VERIFY_RUN = "Verify"
RUNNING_VERIFY = "Verifying …"
ROWS, CAUSE = "Rows compared", "Cause of the errors"
SUPERVISION = "Supervision: where the arm is, beside where it says it is"
SUPERVISION_HELP = (
    "The target as the cameras see it, held against the joints while the arm moves. Beyond the second level, "
    "measurement noise aside, the robot is stopped."
)
SUPERVISION_WARN, SUPERVISION_STOP = "Warn beyond, mm", "Stop beyond, mm (0: never)"
SUPERVISE, SUPERVISE_END = "Supervise", "End, and write the report"
SUPERVISION_PLOT = "Distance from where it should be (mm)"
SUPERVISION_LEVELS = {"good": "Good", "warn": "Warning", "stop": "Stopped"}
SUPERVISION_AT = "{mm:.2f} ± {std:.2f} mm and {deg:.2f} deg off."
SUPERVISION_BLIND = "Nothing is compared now: {why}"
ISO = "ISO 9283: accuracy and repeatability of the arm"
ISO_HELP = (
    "Jog the target to the middle of all pictures. The arm then visits five poses of a test cube about that place, "
    "again and again, and the cameras look at each visit."
)
ISO_SIDE = "Side of the cube, mm (empty: the largest)"
ISO_CYCLES = "Visits of each pose"
ISO_SPEED = "Speed, mm/s"
ISO_PLAN, ISO_RUN = "Plan", "Run"
ISO_PLANNED = "A cube of {side:.0f} mm fits: the arm reaches all five poses, and the cameras see the target at each."
ISO_DONE = "{done} of {wanted} cycles are judged."
ISO_HEAD = ("Figure", "mm", "± (1 σ)", "Rests on")
REPORTS = "Reports"
NO_REPORTS = "No report yet."

JOINT_RANGES = "How far each joint may go"
JOINT_RANGES_HELP = (
    "The light {light} is followed; it must stay in the pictures of two cameras. Every joint that is ticked is "
    "moved alone, within its range; the last ones may be left out, and are held."
)
SWEEP_JOINT = "Joint {joint} ({name})"
JOINT, LOWER, UPPER = "Joint", "From", "To"
READINGS = "Readings per joint"
EXPECT = "Expected accuracy"
EXPECTED = "What these ranges will tell (1 σ)"
IDENTIFY_RUN = "Identify"
PLANNED = "{n} sweeps, {readings} readings"
FOUND = "What was found"
FOUND_HEAD = ("Joint", "Entry", "Found", "± (1 σ)", "From the model")
FITS = "Fits: arcs and lines are the identified arm, with its axes; the dots are what was seen"
FITS_HEAD = ("Joint", "Fit of its sweep", "Readings used", "Off the fit, RMS", "Off the whole arm, RMS")
FIT_ARC, FIT_LINE, FIT_OPEN = "arc, radius {radius:.1f} mm", "line", "not decided: move it further"
FIT_JOINT = "joint {joint}"
HOLD_TO_MOVE = "Now hold the enable: the robot moves while it is held, and waits while it is not."
WORKING = "{note} {done:.0f} of {total:.0f}"
UNDER_WAY = "Under way: {note}"
YES, NO = "Yes, move", "No"
END_WORK = "End it"
ENDED_WORK = "Ended: {why}"
SAVED_ARM = "The arm is kept in {file}, with its sweeps and report beside it."

TEACH = "Record the path"
TEACH_HELP = "Lead the target along, by hand or with the keys below. Record takes all the way, Point one place at rest."
TEACH_RECORD, TEACH_PAUSE, TEACH_POINT, TEACH_UNDO = "Record", "Pause recording", "Point", "Undo"
TEACH_TAG = "Tag (one word)"
TEACH_MARK = "Mark this place"
TEACH_SAVE = "Use this path"
TEACH_STATE = "{n} poses in {stretches} stretches; {lost} frames without a whole pose were left out"
TEACH_RECORDING = "Recording. "
PATH = "The path"
NO_PATH = "No path yet."
PATH_TOLD = "{n} places over {length:.1f} mm"
PATH_HEAD = ("", "Place", "x mm", "y mm", "z mm", "Speed mm/s", "Tag")
PATH_MORE = "{n} more are not listed."
PATH_PICK = "Choose place {n}"
PATH_DELETE = "Delete the chosen"
PATH_BACK = "Take the last change back"
PATH_TOOLS = {
    "resample": "Places this far apart",
    "smooth": "Smooth by at most",
    "offset": "Move along the tool by",
    "angle": "Tilt ahead by",
    "reverse": "Turn round",
}
PATH_TOOL, PATH_FIGURE, PATH_USE = "Change", "Figure (mm or deg)", "Change it"
PATH_CHECK = "Check for the arm"
PATH_OK = "The arm can run this path: {n} places, {length:.1f} mm, {time:.1f} s."
PATH_NOT_OK = "The arm cannot run this path: {why}"
PLAY_CARD = "Play"
PLAY, PAUSE, RESUME = "Play", "Pause", "Go on"
NOT_RECORDED = "Nothing is recorded any more: {why}"
PLAY_SPEED = "Speed along the path, mm/s"
PLAY_KEEP = "Keep the tool's attitude as it is at the start"
PLAY_AT = "{stage}: {s:.1f} of {length:.1f} mm at {speed:.1f} mm/s"
PLAY_STAGES = {"approach": "On the way to the start", "path": "On the path", "finished": "Done"}
PLAY_DONE = "Played: {share:.0%} of {length:.1f} mm in {time:.1f} s. Ended by: {why}."
PLAY_END = "the path's end"
PLAY_SEEN = "The cameras saw the tip {rms:.2f} mm (RMS) off, {largest:.2f} mm at most, in {n} frames."
PLAY_UNSEEN = "No camera watched it."
PLAY_KEPT = "All of it is kept in {folder}."
