"""What is said to a robot's session by a driver, by a page and on the line for stops, and what each hears: as ever.

    python tests/unit/server/test_transcripts.py

writes the transcript that is compared with. Of refusals it has the class, not the words.
"""

import json
import pickle
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from armsight.console.robot_link import RobotLink
from armsight.control.session.operator_session import OperatorSession
from armsight.control.session.service import Service
from armsight.server.application import Connection
from armsight.server.auth import Caller, Identity
from armsight.server.messages import Session, event_message
from armsight.server.stop_line import StopLine

TRANSCRIPT = Path(__file__).parents[2] / "golden" / "data" / "session.json"
POSE = {"xyz_m": [0.1, 0.2, 0.3], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]}
DRIVE: list[dict[str, Any]] = [
    {"type": "joint_goal", "q": [0.1, 0.2]},
    {"type": "heartbeat", "enable": True, "number": 1},
    {"type": "joint_goal", "q": [0.1, 0.2]},
    {"type": "joint_velocity", "qd": [0.1, 0.0]},
    {"type": "joint_step", "step": [0.01, 0.0]},
    {"type": "joint_step", "step": [0.5, 0.0]},
    {"type": "joint_goal", "q": [0.1]},
    {"type": "joint_goal", "q": [9.0, 0.0]},
    {"type": "flange_pose", "T_base_flange": POSE},
    {"type": "tool_twist", "velocity_m_s": [0.01, 0.0, 0.0], "angular_rad_s": [0.0, 0.0, 0.1]},
    {"type": "hold"},
    {"type": "read"},
    {"type": "stop"},
    {"type": "joint_velocity", "qd": [0.1, 0.0]},
    {"type": "reset"},
    {"type": "heartbeat", "enable": False, "number": 2},
    {"type": "heartbeat", "enable": True, "number": 3},
    {"type": "joint_velocity", "qd": [0.0, 0.1]},
    {"type": "dance"},
]
KEY = {"frame": "joints", "axis": 0, "sense": "1"}
PAGE: list[dict[str, Any]] = [
    {"do": "beat", "enable": True, "push": KEY, "seen": 100.0},
    {"do": "override", "share": 0.25},
    {"do": "beat", "enable": True, "push": {**KEY, "axis": 1, "sense": "-1"}, "seen": 100.0, "number": 2},
    {"do": "beat", "enable": True, "push": {**KEY, "axis": 5}, "seen": 100.0},
    {"do": "beat", "enable": True, "push": {**KEY, "frame": "base"}, "seen": 100.0},
    {"do": "beat", "enable": True, "seen": 100.0},
    {"do": "stop"},
    {"do": "beat", "enable": True, "seen": 100.0},
    {"do": "reset"},
    {"do": "beat", "enable": True, "seen": 100.0},
    {"do": "beat", "enable": False, "seen": 100.0},
    {"do": "beat", "enable": True, "push": KEY, "seen": 100.0},
    {"do": "beat", "enable": True, "push": KEY, "seen": 98.0},
    {"do": "page", "page": "another"},
]
LINE: list[dict[str, Any]] = [
    {"type": "heartbeat", "enable": True, "number": 1, "key": "key"},
    {"type": "heartbeat", "enable": True, "number": 2, "key": "other"},
    {"type": "read"},
    {"type": "stop"},
    {"type": "stop"},
]
RANDOM = {"instance", "key", "session", "line", "words", "refused"}


def plain(value: Any) -> Any:
    """Return what was told as JSON has it."""
    if hasattr(value, "__slots__") and not isinstance(value, (str, bytes, int, float)):
        return [type(value).__name__, *(plain(getattr(value, name)) for name in value.__slots__)]
    if isinstance(value, np.ndarray):
        return np.round(value, 9).tolist()
    return [plain(part) for part in value] if isinstance(value, (list, tuple)) else value


def answer(said: Any) -> dict[str, Any]:
    """Return a message without what is of this run, or words."""
    told: dict[str, Any] = said.model_dump(mode="json")
    return {name: value for name, value in told.items() if name not in {"cause", "consequence", "cure", "instance"}}


def transcript(fakes: Any) -> dict[str, Any]:
    """Return all that is said and heard."""
    drive, page, line = fakes.FakeHost(), fakes.FakeHost(), fakes.FakeHost()
    log, known = fakes.KeptLog(), SimpleNamespace(knows=lambda _: True)
    service = Service(drive, log)
    driver = Connection(service, known, SimpleNamespace(), Caller(address="here"), role="drive")  # type: ignore[arg-type]
    driver._lease, session = service.authority.take("ann@here", "ann"), Session("drive")
    heard = []
    for k, said in enumerate(DRIVE):
        text = json.dumps({**said, "session": session.nonce, "seq": k + 1})
        drive.t_s, drive.cycle = drive.t_s + 0.01, drive.cycle + 1
        heard.append(answer(driver._answer(session, text, 0.01)))
    told = [answer(event_message(event)) for event in drive.happened]

    link = RobotLink(OperatorSession(Service(page, fakes.KeptLog())), SimpleNamespace(scope={}), {})  # type: ignore[arg-type]
    states = [link.state()]
    for said in PAGE:
        link.take(json.dumps(said))
        states.append(link.state())
    shown = [{**{k: v for k, v in state.items() if k not in RANDOM}, "no": bool(state["refused"])} for state in states]

    line.grant(7, "key", "ann")
    stops, of_line, who = StopLine(line.line, known), Session("stop"), Identity(who="ann", role="drive")  # type: ignore[arg-type]
    socket = SimpleNamespace(scope={})
    replies = [
        answer(stops._answer(socket, of_line, who, {"text": json.dumps({**said, "session": of_line.nonce, "seq": k})}))
        for k, said in enumerate(LINE, 1)
    ]
    orders = [
        [part for part in pickle.loads(data) if not isinstance(part, float)]
        for data in iter(line.line.orders.get, None)
    ]
    return {
        "drive": {"heard": heard, "told": plain(drive.told), "logged": plain(log.commands), "events": told},
        "page": {"shown": shown, "told": plain(page.told)},
        "line": {"heard": replies, "orders": plain(orders)},
    }


def test_a_session_says_and_does_what_it_always_did(fakes):
    assert json.loads(json.dumps(transcript(fakes))) == json.loads(TRANSCRIPT.read_text())


if __name__ == "__main__":
    import conftest

    made = transcript(SimpleNamespace(FakeHost=conftest.FakeHost, KeptLog=conftest.KeptLog))
    TRANSCRIPT.write_text(json.dumps(made) + "\n")
