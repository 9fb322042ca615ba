"""One or two examples for each command's --help, and the panel of the overview that it stands in."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import typer

PANELS: Mapping[str, str] = {
    "demo": "Begin",
    "doctor": "Begin",
    "design": "Begin",
    "console": "Begin",
    "simulate": "Begin",
    "record": "Measure",
    "measure": "Measure",
    "verify": "Measure",
    "compare": "Measure",
    "history": "Measure",
    "batch": "Measure",
    "calibrate": "Calibrate and identify",
    "identify": "Calibrate and identify",
    "reproduce": "Calibrate and identify",
    "kinematics": "Arms and files",
    "convert": "Arms and files",
    "join": "Arms and files",
    "report": "Measure",
}
"""Command -> panel; what is not named moves a robot or talks to one."""
ROBOTS = "Robots"

RIG = "--rig rig.yaml --target target.yaml"
EXAMPLES: Mapping[str, tuple[str, ...]] = {
    "console": (
        "armsight console --robot sim:webcam-cell",
        "armsight console --folder work",
        f"armsight console --folder work --left camera:0 --right camera:1 {RIG}",
    ),
    "demo": ("armsight demo", "armsight demo --room workshop -o demo"),
    "simulate": (
        "armsight simulate webcam-cell -o cell",
        "armsight simulate webcam-cell --room workshop -o cell",
        "armsight simulate handeye -o photos",
    ),
    "doctor": ("armsight doctor", "armsight doctor --rig rig.yaml --depth 1.5"),
    "design": (
        "armsight design --size 1280x720 --focal-mm 4 --pixel-um 3 --baseline 120mm --target target.yaml "
        "--volume=-0.2:0.2,-0.15:0.15,0.6:1 --board checkerboard:9x6:0.025 --views 20 --wanted-mm 0.5 -o design",
        "armsight design --rig rig.yaml --target target.yaml --volume=-0.2:0.2,-0.15:0.15,0.6:1 -o design",
    ),
    "record": (
        "armsight record --left camera:0 --right camera:1 --seconds 60 -o recording.mcap",
        "armsight record --repair recording.mcap -o mended.mcap",
    ),
    "verify": (
        "armsight verify --arm arm.yaml --measured poses.csv --joints joints.csv -o verified",
        f"armsight verify --live --robot rtde:192.168.1.10 --left camera:0 --right camera:1 {RIG} "
        "--arm arm.yaml --world world.yaml -o live",
    ),
    "report": ("armsight report measured --pdf", "armsight report rig.report.html --pdf -o rig.pdf"),
    "compare": (
        "armsight compare measured-monday measured-friday -o compared",
        "armsight compare rig-before.yaml rig-after.yaml --distance 1.2",
    ),
    "batch": (
        "armsight batch --each 'recordings/*.mcap' -o results -- measure --left {} --rig rig.yaml --target target.yaml",
        "armsight batch jobs.csv -o results --resume",
    ),
    "measure": (
        f"armsight measure --left frames/left --right frames/right {RIG} -o measured",
        f"armsight measure --left camera:0 --right camera:1 {RIG} -o measured",
    ),
    "identify": (
        "armsight identify --sweep sweep.csv -o identified.yaml",
        "armsight identify --live sim:kapucu2005-rrp --left camera:sim:kapucu2005-rrp:left "
        f"--right camera:sim:kapucu2005-rrp:right {RIG} --limits=-0.5:5.2,-0.4:1.9,0.3:1.1 -o identified.yaml",
    ),
    "reproduce": ("armsight reproduce kapucu2005 -o kapucu",),
    "join": ("armsight join --measured poses.csv --joints joints.csv --arm arm.yaml --as points -o points.csv",),
    "serve": (
        "armsight serve --robot sim:webcam-cell",
        "armsight serve --robot sim:webcam-cell --console work",
        "armsight serve --robot rsi:49152 --arm arm.yaml --bind 0.0.0.0 --tokens tokens.yaml --tls-cert cert.pem "
        "--tls-key key.pem",
    ),
    "twin": ("armsight twin rtde --port 30004", "armsight twin rsi --connect 127.0.0.1:49152"),
    "servo": (
        f"armsight servo --robot sim:pachidis2005-static {RIG} --handeye handeye.yaml --hand circle -o servo",
        f"armsight servo --robot rsi:49152 --arm arm.yaml --left camera:0 --right camera:1 {RIG} "
        "--handeye handeye.yaml --distance 0.6 -o servo",
    ),
    "teach": (
        f"armsight teach --robot sim:pachidis2005-circle {RIG} --handeye handeye.yaml -o taught",
        f"armsight teach --left camera:0 --right camera:1 {RIG} --world world.yaml --tip tip.yaml -o taught",
        "armsight teach --from measured/poses.csv --tip tip.yaml -o taught",
    ),
    "play": (
        "armsight play --robot sim:webcam-cell --path taught/path.csv -o played",
        "armsight play --robot rsi:49152 --arm arm.yaml --tip tip.yaml --path taught/path.csv --weave sine:0.002:0.008 "
        "-o played",
    ),
    "calibrate camera": ("armsight calibrate camera images/ --board checkerboard:9x6:0.025 -o camera.yaml",),
    "calibrate stereo": (
        "armsight calibrate stereo --left images/left --right images/right --board checkerboard:9x6:0.025 -o rig.yaml",
    ),
    "calibrate zoom-rig": (
        "armsight calibrate zoom-rig --rig rig.yaml --left left-zoom.yaml --zoom-left 35 --zoom-right 35 "
        "-o zoomed.yaml",
    ),
    "calibrate handeye": (
        "armsight calibrate handeye --pairs pairs.csv -o handeye.yaml",
        "armsight calibrate handeye --images images/ --camera camera.yaml --board checkerboard:9x6:0.025 "
        "--robot robot_poses.csv -o handeye.yaml",
    ),
    "calibrate tooltip": ("armsight calibrate tooltip --poses poses.csv -o tip.yaml",),
    "calibrate pivot": (f"armsight calibrate pivot --left camera:0 --right camera:1 {RIG} -o tip.yaml",),
    "calibrate arm": (
        "armsight calibrate arm --model ur10e --points points.csv -o calibrated.yaml",
        "armsight calibrate arm --propose 20 --model arm.yaml --points points.csv -o calibrated.yaml",
        "armsight calibrate arm --model two_arms.urdf --tip left_tool0 --points points.csv -o left.yaml",
    ),
    "calibrate cell-plan": (
        f"armsight calibrate cell-plan --model arm.yaml {RIG} --world world.yaml "
        "--volume=-0.95:-0.75,-0.3:0.05,0.1:0.4 --start=0,-1.07,1.63,-0.57,1.73,0.16 --facing-deg 60 -o motion.csv",
        "armsight calibrate cell-plan --model arm.yaml --start=0,-1.07,1.63,-0.57,1.73,0.16 -o motion.csv",
    ),
    "calibrate robot-world": ("armsight calibrate robot-world --arm arm.yaml --points observed.csv -o world.yaml",),
    "calibrate mirrors": (
        "armsight calibrate mirrors --image board/ --board circles:7x11:0.02 -o rig.yaml",
        "armsight calibrate mirrors --check --image board/ --rig rig.yaml --board circles:7x11:0.02 -o checked.yaml",
    ),
    "calibrate target": (
        "armsight calibrate target --rig rig.yaml --left frames/left --right frames/right --lights 3 -o target.yaml",
    ),
    "calibrate timing": (f"armsight calibrate timing --left camera:0 --right camera:1 {RIG} -o rig-timed.yaml",),
    "calibrate cell": (
        "armsight calibrate cell --robot-log joints.csv --left left.mp4 --right right.mp4 --target target.yaml "
        "--model ur10e --tip 0,0,0.12 -o cell",
        "armsight calibrate cell --robot-log joints.csv --left-spots left.csv --right-spots right.csv --size 1280x720 "
        "--target target.yaml --model arm.yaml -o cell",
    ),
    "convert recording": (
        "armsight convert recording recording.mcap -o frames",
        "armsight convert recording recording.mcap --to rosbag2 -o bag",
    ),
    "convert camera": (
        "armsight convert camera camchain.yaml -o camera.yaml",
        "armsight convert camera camera.yaml --to ros -o camera_info.yaml",
    ),
    "convert rig": (
        "armsight convert rig stereo.yml -o rig.yaml",
        "armsight convert rig rig.yaml --to opencv -o r.yml",
    ),
    "convert poses": ("armsight convert poses poses.csv -o poses.tum",),
    "convert table": ("armsight convert table log.txt --robot-format kuka --as robot_poses -o robot_poses.csv",),
    "convert handeye": ("armsight convert handeye handeye.yaml --to easy_handeye -o handeye_easy.yaml",),
    "convert arm": ("armsight convert arm robot.urdf --tip tool0 -o arm.yaml",),
    "kinematics fk": ("armsight kinematics fk --arm arm.yaml --joints joints.csv -o poses.csv",),
    "kinematics ik": ("armsight kinematics ik --arm ur10e --poses poses.csv -o joints.csv",),
    "kinematics jacobian": ("armsight kinematics jacobian --arm arm.yaml --joints joints.csv -o jacobians.csv",),
    "kinematics path": ("armsight kinematics path --arm arm.yaml --poses poses.csv -o joints.csv",),
    "kinematics formulas": ("armsight kinematics formulas --arm arm.yaml -o formulas.tex",),
    "kinematics show": ("armsight kinematics show --arm ur10e -o arm.html",),
    "history add": ("armsight history add handeye.yaml --cell weld-3",),
    "history list": ("armsight history list --cell weld-3 --command calibrate",),
    "history show": ("armsight history show 1",),
    "history compare": ("armsight history compare 1 2",),
    "history trend": (
        "armsight history trend --cell weld-3 -o drift",
        "armsight history trend --cell weld-3 --figure joint-zeros --figure residual_rms_m --since 2026-01-01 -o drift",
    ),
    "history export": ("armsight history export --cell weld-3 -o weld-3.csv",),
    "path smooth": ("armsight path smooth path.csv --bound-m 0.0005 -o smooth.csv",),
    "path resample": ("armsight path resample path.csv --step-m 0.001 -o even.csv",),
    "path fillet": ("armsight path fillet path.csv --radius-m 0.005 -o rounded.csv",),
    "path offset": ("armsight path offset path.csv --by-m -0.01 -o above.csv",),
    "path angle": ("armsight path angle path.csv --travel-deg 15 -o tilted.csv",),
    "path reverse": ("armsight path reverse path.csv -o back.csv",),
    "path join": ("armsight path join first.csv second.csv -o both.csv",),
    "path check": ("armsight path check path.csv --arm arm.yaml --limits limits.yaml -o check.html",),
    "path export": (
        "armsight path export path.csv --to urscript --arm arm.yaml -o seam.script",
        "armsight path export path.csv --to krl --arm arm.yaml --tool 1 -o seam.src",
    ),
    "path from-picks": (
        "armsight path from-picks --left left.png --right right.png --rig rig.yaml --picks picks.csv "
        "--world world.yaml -o path.csv",
    ),
    "robot test": ("armsight robot test --robot rsi:49152 --for 60",),
    "robot jog": (
        "armsight robot jog --robot sim:webcam-cell --joint 1 --by 0.02",
        "armsight robot jog --robot rsi:49152 --arm arm.yaml --with gamepad --frame tool",
    ),
    "robot run": (
        "armsight robot run --robot sim:webcam-cell --motion motion.csv -o moved",
        "armsight robot run --robot rtde:192.168.0.10 --arm ur5e --motion motion.csv --left camera:0 --right camera:2 "
        "-o moved",
    ),
}
"""Command -> what to type; the help lists the commands of a panel in this order."""


def add_examples(app: typer.Typer) -> None:
    """Put the examples below each command's help, and the commands into panels, all in the order of EXAMPLES."""
    order, panels = list(EXAMPLES), [*dict.fromkeys(PANELS.values()), ROBOTS]
    for name, info in every_command(app):
        info.epilog = "\n\n".join(("Examples:", *EXAMPLES[name]))
        if " " not in name:
            info.rich_help_panel = PANELS.get(name, ROBOTS)
    app.registered_commands.sort(key=lambda info: (panels.index(str(info.rich_help_panel)), order.index(_name(info))))
    for group in app.registered_groups:
        group.rich_help_panel = PANELS.get(group.name or "", ROBOTS)
        if group.typer_instance is not None:
            names = [name.removeprefix(f"{group.name} ") for name in EXAMPLES if name.startswith(f"{group.name} ")]
            group.typer_instance.registered_commands.sort(key=lambda info: names.index(_name(info)))


def every_command(app: typer.Typer) -> Iterator[tuple[str, typer.models.CommandInfo]]:
    """Yield each command with its full name."""
    for command in app.registered_commands:
        yield _name(command), command
    for group in app.registered_groups:
        if group.typer_instance is not None:
            for command in group.typer_instance.registered_commands:
                yield f"{group.name} {_name(command)}", command


def _name(command: typer.models.CommandInfo) -> str:
    return str(command.name or getattr(command.callback, "__name__", "")).replace("_", "-")
