"""The page's script of the robot, run by node without a browser: what it says on which socket."""

import json
import shutil
import subprocess
from importlib.resources import files

import pytest

NODE = shutil.which("node")

STAGE = """
let now = 0, tick = null; const later = [], hears = {}, sockets = [], posts = [];
class Element { constructor(dataset = {}) { this.dataset = dataset; this.textContent = ""; this.attributes = {}; }
  setAttribute(n, v) { this.attributes[n] = v; }
  toggleAttribute(n, on) { on ? this.attributes[n] = "" : delete this.attributes[n]; }
  hasAttribute(n) { return n in this.attributes; } focus() {} setPointerCapture() {}
  closest(which) { return which.includes(`testid=${this.dataset.testid}]`) ? this : null; } }
class WebSocket { static OPEN = 1;
  constructor(url) { this.url = url; this.readyState = 1; this.said = []; sockets.push(this); }
  send(text) { this.said.push(JSON.parse(text)); } tells(what) { this.onmessage({ data: JSON.stringify(what) }); }
  ends() { this.readyState = 3; this.onclose(); } }
class HTMLInputElement {}
const bar = new Element({ robot: "b", instance: "i", shared: "SHARED", gone: "GONE", stale: "STALE" });
const enable = new Element({ testid: "enable" }), stop = new Element({ testid: "stop" }), refused = new Element();
const hear = (kind, act) => (hears[kind] = hears[kind] || []).push(act);
const document = { querySelector: (q) => q === "[data-robot]" ? bar : q === "[data-testid=enable]" ? enable : null,
  getElementById: (id) => id === "robot-refused" ? refused : null, addEventListener: hear, hidden: false };
const window = { addEventListener: hear }, location = { protocol: "PROTOCOL", host: "robot:8080", hostname: "robot" };
const performance = { now: () => now }, setInterval = (act) => (tick = act), setTimeout = (act) => later.push(act);
const fetch = (...what) => (posts.push(what), Promise.resolve());
const happens = (kind, event) => hears[kind].forEach((act) => act({ preventDefault() {}, ...event }));
const usual = { t: 1, instance: "i", level: "good", words: "w", mine: true, drives: true };
const tells = (more) => sockets[0].tells({ ...usual, ...more });
"""


def played(script, protocol="http:"):
    """Return what a play on the stage says."""
    page = files("armsight").joinpath("console/static/robot.js").read_text(encoding="utf-8")
    program = f"{STAGE.replace('PROTOCOL', protocol)}\n{page}\n{script}"
    done = subprocess.run([NODE, "-e", program], capture_output=True, text=True, timeout=60, check=True)
    return json.loads(done.stdout)


pytestmark = pytest.mark.skipif(NODE is None, reason="no node on this machine")

LINE = 'tells({ line: 8081, key: "k" }); sockets[1].tells({ type: "line", version: 1, session: "s" });'


@pytest.mark.parametrize(("protocol", "scheme"), [("http:", "ws:"), ("https:", "wss:")])
def test_a_page_opens_the_line_that_it_is_told_of(protocol, scheme):
    assert played(f"{LINE} console.log(JSON.stringify(sockets.map((s) => s.url)))", protocol) == [
        f"{scheme}//robot:8080/console/robot",
        f"{scheme}//robot:8081/api/v1/stop",
    ]


def test_a_page_tells_its_name_on_the_connection_and_in_no_address():
    assert played("sockets[0].onopen(); console.log(JSON.stringify([sockets[0].said, sockets[0].url]))") == [
        [{"do": "page", "page": "b"}],
        "ws://robot:8080/console/robot",
    ]


@pytest.mark.parametrize("how", ['happens("click", { target: stop })', 'happens("keydown", { key: "Escape" })'])
def test_a_stop_goes_by_every_way(how):
    said = played(f"{LINE} {how}; console.log(JSON.stringify([...sockets.map((s) => s.said), posts.map((p) => p[0])]))")
    assert said == [[{"do": "stop"}], [{"type": "stop", "session": "s", "seq": 1}], ["/console/stop"]]


def test_an_enable_and_its_end_go_by_both_ways_with_one_number():
    main, line = played(
        f'{LINE} happens("pointerdown", {{ target: enable, button: 0 }}); tick();'
        'happens("pointerup", { target: enable });'
        "console.log(JSON.stringify(sockets.map((s) => s.said)))"
    )
    assert [(beat["enable"], beat["number"]) for beat in main] == [(True, 1), (True, 2), (False, 3)]
    assert [(beat["enable"], beat["number"], beat["key"], beat["seq"]) for beat in line] == [
        (True, 1, "k", 1), (True, 2, "k", 2), (False, 3, "k", 3),
    ]  # fmt: skip


def test_without_the_line_the_pages_own_way_does_and_who_drives_is_told():
    script = (
        'tells({ line: 8081, key: "k" }); sockets[1].ends(); now = 1400; tells({ line: 8081, key: "k" });'
        'happens("click", { target: stop }); const early = refused.textContent;'
        'now = 3100; tells({ line: 8081, key: "k" }); const driver = refused.textContent;'
        'tells({ line: 8081, key: "k", mine: false }); const watcher = refused.textContent;'
        'later.splice(0).forEach((act) => act()); sockets[2].tells({ type: "line", session: "t" });'
        'tells({ line: 8081, key: "k" });'
        "console.log(JSON.stringify([sockets[0].said, early, driver, watcher, refused.textContent, sockets[2].url]))"
    )
    assert played(script) == [[{"do": "stop"}], "", "SHARED", "", "", "ws://robot:8081/api/v1/stop"]


def test_a_line_closed_after_an_opening_begins_its_numbers_anew():
    script = (
        f'{LINE} happens("click", {{ target: stop }}); sockets[1].ends(); later.splice(0).forEach((act) => act());'
        'sockets[2].tells({ type: "line", session: "t" }); happens("click", { target: stop });'
        "console.log(JSON.stringify(sockets[2].said))"
    )
    assert played(script) == [{"type": "stop", "session": "t", "seq": 1}]


def test_a_server_without_a_line_is_stopped_all_the_same():
    script = (
        'tells({ line: null }); happens("click", { target: stop });'
        "console.log(JSON.stringify([sockets.length, sockets[0].said]))"
    )
    assert played(script) == [1, [{"do": "stop"}]]
