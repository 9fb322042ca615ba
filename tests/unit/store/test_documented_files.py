"""Every file shown in docs/file-formats.md is read by the reader it is written for."""

import re
from pathlib import Path

import pytest

import armsight.store
import armsight_lab
from armsight.columns import POSE6
from armsight.store.arm_file import arm_from_mapping
from armsight.store.cell_file import CellFile
from armsight.store.codec import validated
from armsight.store.covariances import POINT_COVARIANCE
from armsight.store.handeye_file import HandEyeModel, TipModel
from armsight.store.interpret.names import ROLES
from armsight.store.interpret.read import is_ours
from armsight.store.limits_file import limits_from_mapping
from armsight.store.path_file import PLAN_COLUMNS, parse_path
from armsight.store.rigs import WORLD_YAML, CameraModel, rig_from_mapping
from armsight.store.spots_csv import parse_picks, parse_spot_track
from armsight.store.tables import parse_table
from armsight.store.targets import target_from_mapping
from armsight.store.tokens import TokensModel
from armsight.store.tracks import POINT_COLUMNS, SPOT_COLUMNS, parse_joints, parse_poses, parse_times
from armsight.store.yamls import dump_yaml, parse_yaml
from armsight.store.zoom import is_zoom_camera, zoom_camera_from_mapping
from armsight.verify.live import ERROR_COLUMNS
from armsight_lab.batch.job_files import parse_jobs

PAGE = Path(__file__).resolve().parents[3] / "docs" / "file-formats.md"
BLOCKS = re.findall(r"^```(yaml|csv)\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def standard(data, role):
    assert is_ours(data, ROLES[role])  # taken as it is, without interpretation
    words = [name for name in ("file", "point") if name in ROLES[role].words]
    return parse_table(data, "x", sorted(ROLES[role].required), optional=ROLES[role].known, text=words, series="q")


READERS = {
    "armsight/rig": rig_from_mapping,
    "armsight/camera": lambda content: validated(CameraModel, content, "x").camera(),
    "zoom": lambda content: zoom_camera_from_mapping(content, "x"),
    "armsight/target": target_from_mapping,
    "armsight/arm": arm_from_mapping,
    "armsight/world": WORLD_YAML.parse,
    "armsight/handeye": lambda content: validated(HandEyeModel, content, "x"),
    "armsight/tip": lambda content: validated(TipModel, content, "x"),
    "armsight/limits": limits_from_mapping,
    "armsight/jobs": lambda content: parse_jobs(dump_yaml(content).encode(), "jobs.yaml"),
    "name,command": lambda data: parse_jobs(data, "jobs.csv"),
    "armsight/cell": lambda content: validated(CellFile, content, "x"),
    "armsight/tokens": lambda content: validated(TokensModel, content, "x").tokens,
    "t_s,x_m": lambda data: parse_poses(data, "x"),
    "t_s,spot": lambda data: parse_table(
        data, "x", (*POINT_COLUMNS, *POINT_COVARIANCE, "status"), text=("spot", "status")
    ),
    "t_s,camera": lambda data: parse_table(data, "x", SPOT_COLUMNS, text=("camera", "spot")),
    "t_s,u_px": lambda data: parse_spot_track(data, "x"),
    "joint,q1": lambda data: standard(data, "sweep"),
    "frame,joint": lambda data: standard(data, "sweep_joints"),
    "index,t_s": lambda data: parse_path(data, "x"),
    "u_px,v_px": lambda data: parse_picks(data, "x"),
    "index,x_m": lambda data: parse_table(data, "x", PLAN_COLUMNS, text=("tag", "pose"), series="q"),
    "row,t_s": lambda data: parse_table(data, "x", ("row", "t_s", *POSE6, "error_m", "error_rad"), series="dq"),
    "t_s,level": lambda data: parse_table(
        data,
        "x",
        ("t_s", "level", *ERROR_COLUMNS, "decision_ms", "lost"),
        text=("level", "lost"),
        blank=(*ERROR_COLUMNS, "decision_ms"),
    ),
    "q1,q2": lambda data: standard(data, "points"),
    "feature": lambda data: parse_table(
        data, "x", ("feature", "kind", "reading_m"), text=("feature", "kind"), blank=("reading_m",), series="q"
    ),
    "base_flange_x_m,base_flange_y_m": lambda data: standard(data, "pairs"),
    "file,x_m": lambda data: standard(data, "robot_poses"),
    "pose,q1": lambda data: parse_table(data, "x", ("pose", "decides"), text=("decides",), series="q"),
    "t_s,q1": lambda data: parse_joints(data, "x"),
    "t_s": lambda data: parse_times(data, "x"),
}


def reader_of(kind, text):
    if kind == "yaml":
        content = parse_yaml(text.encode(), "x")
        return READERS["zoom" if is_zoom_camera(content) else content["format"]], content
    columns = text.splitlines()[0].split(",")
    return READERS["feature" if "feature" in columns else ",".join(columns[:2])], text.encode()


def test_every_kind_is_shown():
    shown = {reader_of(kind, text)[0] for kind, text in BLOCKS}
    assert shown == set(READERS.values())


def test_every_format_of_the_store_is_shown():
    folders = (Path(armsight.store.__file__).parent, Path(armsight_lab.__file__).parent)
    paths = [path for folder in folders for path in folder.rglob("*.py")]
    formats = {name for path in paths for name in re.findall(r'"(armsight/[a-z]+)"', path.read_text())}
    shown = {parse_yaml(text.encode(), "x")["format"] for kind, text in BLOCKS if kind == "yaml"}
    assert formats - shown == {"armsight/recording"}, "the recording is no text file; all others are shown"


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_a_shown_file_is_read(number):
    reader, content = reader_of(*BLOCKS[number])
    assert reader(content) is not None
