"""The page: one file, no network, light or dark, printable. All text that comes from outside is escaped here."""

from __future__ import annotations

import base64
import functools
import gzip
import html
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from importlib import resources
from types import MappingProxyType

from armsight._version import __version__
from armsight.records.result_parts import Verdict
from armsight.report.figures import Figure, Plot, fitted_scene, json_text

Given = Mapping[str, object]
"""What an action was called with."""
NOTHING: Given = MappingProxyType({})
FILES_SHOWN = 20
"""Files of what went in that a page lists; the result's own file has all, with their hashes."""
PANEL_PX = 300
"""Width of a panel beside others from which on its numbers stand clear of each other."""

SENTENCE = 20
"""Letters from which on a cell of the last column is a text that wants width."""

STYLE = """
:root{--ink:#1c2733;--soft:#5b6b7b;--line:#dfe5eb;--back:#f4f6f8;--blue:#1f5fa8;--good:#2e7d4f;--warn:#b86a00;
--bad:#b3302f;--card:#fff}
@media screen and (prefers-color-scheme:dark){:root{--ink:#e3e9ef;--soft:#9fb0c0;--line:#2c3947;--back:#10161c;
--blue:#7db3f0;--good:#6cc394;--warn:#e8a74e;--bad:#ef8079;--card:#18212a;color-scheme:dark}}
*{box-sizing:border-box}
body{margin:0;background:var(--back);color:var(--ink);
font:15px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif}
main{max-width:1120px;margin:0 auto;padding:28px 24px 48px}
header h1{font-size:26px;line-height:1.2;margin:0 0 2px}
header p{margin:0;color:var(--soft)}
h2{font-size:18px;margin:0 0 4px}
section,.verdict,.cards div{background:var(--card);border:1px solid var(--line);border-radius:8px}
section{padding:18px 20px;margin:16px 0}
section>p{margin:0 0 10px;color:var(--soft);max-width:85ch}
.verdict{margin:18px 0;padding:14px 18px;border-left:6px solid var(--good);font-size:17px}
.verdict.care{border-left-color:var(--warn)}.verdict.bad{border-left-color:var(--bad)}
.verdict strong{display:block;font-size:13px;letter-spacing:.06em;text-transform:uppercase;color:var(--good)}
.verdict p{margin:8px 0 0}.verdict b{color:var(--blue);margin-right:4px}
.verdict.care strong{color:var(--warn)}.verdict.bad strong{color:var(--bad)}
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(150px,1fr));gap:12px}
.cards div{padding:12px 14px}
.cards b{display:block;font-size:22px;line-height:1.25;font-variant-numeric:tabular-nums}
.cards span{color:var(--soft);font-size:13px}
.cards small{display:block;color:var(--soft);font-size:12px}
.scroll{overflow-x:auto}
.more{box-shadow:inset -14px 0 12px -14px var(--soft)}
.more::before{content:"scroll sideways \\2192";display:block;position:sticky;left:0;text-align:right;font-size:12px;
color:var(--blue)}
table{border-collapse:collapse;width:100%;font-size:14px;font-variant-numeric:tabular-nums}
th,td{padding:6px 10px;border-bottom:1px solid var(--line);text-align:left;vertical-align:top;overflow-wrap:break-word}
th{color:var(--soft);font-weight:600;font-size:13px;overflow-wrap:normal}
td.n,th.n{text-align:right}td.n{white-space:nowrap}
td.n~td.t{min-width:24ch}
tr:last-child td{border-bottom:0}
.plot{width:100%}
.pair{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(420px,100%),1fr));gap:14px 28px;margin:8px 0 14px}
.pair>*{min-width:0}
.modebar{opacity:0;transition:opacity .2s}.plot:hover .modebar{opacity:1}
figure{margin:0}figure>svg{width:100%;height:auto;display:block;background:#000;border-radius:4px}
figcaption{font-size:13px;color:var(--soft);margin-top:4px;overflow-wrap:anywhere}
.zooms{display:flex;flex-wrap:wrap;gap:6px;margin-top:6px}.zooms svg{width:82px;height:82px;border-radius:3px}
.boards{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(220px,45%),1fr));gap:12px}
.boards>*{min-width:0}
ul{margin:6px 0 0;padding-left:20px}
footer{color:var(--soft);font-size:13px;margin-top:18px}
@media (max-width:600px){main{padding:16px 10px 32px}section{padding:14px 12px}header h1{font-size:22px;
overflow-wrap:anywhere}.cards b{font-size:18px}.verdict,ul{overflow-wrap:anywhere}.plot{min-width:var(--least,0)}
td.t{min-width:20ch}th:first-child,td:first-child{min-width:11ch}}
.still{position:absolute;inset:0;width:100%;height:100%}
@page{size:A4;margin:14mm 12mm}
@media print{body{background:#fff}main{max-width:none;padding:0}.verdict,figure,.plot,.cards div{break-inside:avoid}
h2,section>p{break-after:avoid}
table{font-size:11px}th{font-size:11px}th,td{padding:3px 5px}
td.n~td.t{min-width:12ch}
.scroll{overflow:visible;box-shadow:none}.more::before{display:none}tr{break-inside:avoid}
section{border:0;border-top:1px solid var(--line);border-radius:0;padding:12px 0}.modebar{display:none!important}}
"""

POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:"
)
"""What the page may load: nothing from anywhere. plotly.js compiles its 3-D shaders' glue, hence eval."""

SCRIPT = """
const dark=matchMedia('(prefers-color-scheme: dark)');
const DARK={'#1c2733':'#e3e9ef','#ffffff':'#18212a','#e8edf2':'#2c3947','#c9d3dc':'#46566a','#1f5fa8':'#7db3f0',
'#2e7d4f':'#6cc394','#c23b3b':'#ef8079','#7b1fa2':'#c58be0','#5c6bc0':'#9fa8e8','#a0522d':'#d39069',
'rgba(31,95,168,0.22)':'rgba(125,179,240,0.28)'};
const unpack=id=>{const bytes=Uint8Array.from(atob(document.getElementById(id).textContent),c=>c.charCodeAt(0));
return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'))).text()};
Promise.all([unpack('figures'),unpack('plotly')]).then(([source,code])=>{
const dressed=()=>JSON.parse(dark.matches?source.replace(/#[0-9a-f]{6}|rgba\\([^)]*\\)/g,c=>DARK[c]||c):source);
const away=f=>{const s=f.layout.scene,p=document.getElementById(f.id);if(!s)return;
p.style.height=Math.min(p.clientHeight,Math.max(p.clientWidth,300))+'px';
const r=s.aspectratio;if(r)for(const n of 'xyz')(s[n+'axis']||={}).nticks=Math.max(2,Math.round(
(p.clientWidth<600?5:9)*r[n]/Math.max(r.x,r.y,r.z)));
const k=Math.max(1,(s.wide+0.35)*p.clientHeight/p.clientWidth),c=s.camera;if(!s.wide)return;
for(const n of 'xyz')c.eye[n]=c.center[n]+k*(c.eye[n]-c.center[n])};
const draw=()=>{for(const f of dressed()){away(f);
Plotly.react(f.id,f.data,f.layout,{responsive:true,displaylogo:false,displayModeBar:'hover'});
if(f.layout.scene){const p=document.getElementById(f.id);p.removeAllListeners('plotly_restyle');
p.on('plotly_restyle',()=>Plotly.relayout(p,{'scene.aspectmode':'data','scene.xaxis.autorange':true,
'scene.yaxis.autorange':true,'scene.zaxis.autorange':true}))}}};
const cue=()=>{for(const s of document.querySelectorAll('.scroll'))s.classList.toggle('more',
s.scrollWidth>s.clientWidth+1)};
const still=f=>{const s=document.getElementById(f.id)._fullLayout.scene?._scene;if(!s||s.glplot.stopped)return;
s.glplot.redraw();const gl=s.glplot.canvas,c=document.createElement('canvas');c.width=gl.width;c.height=gl.height;
c.getContext('2d').drawImage(gl,0,0);c.className='still';gl.after(c)};
const fit=()=>{for(const f of dressed()){Plotly.Plots.resize(f.id);still(f)}};
const go=()=>{for(const c of document.querySelectorAll('.still'))c.remove();for(const f of dressed())
Plotly.Plots.resize(f.id)};
(0,eval)(code);draw();cue();addEventListener('resize',cue);dark.addEventListener('change',draw);
addEventListener('beforeprint',fit);addEventListener('afterprint',go);document.documentElement.dataset.drawn='yes'});
"""


@functools.lru_cache(maxsize=1)
def packed_plotly() -> str:
    """Return plotly.js (scatter plots, flat and in space) compressed, as text; browsers since 2023 unpack it."""
    return _base64(resources.files("armsight.report").joinpath("plotlyjs", "plotly-gl3d.min.js.gz").read_bytes())


def _base64(packed: bytes) -> str:
    return base64.b64encode(packed).decode("ascii")


def text(value: object) -> str:
    """Return value as HTML text, safe in elements and in quoted attributes, with the sign that a page has for +-."""
    return html.escape(re.sub(r"\+- ?(?=\d)", "± ", str(value)), quote=True)


@dataclass(frozen=True, slots=True)
class Card:
    """One key figure: its name, its value with unit, a remark."""

    name: str
    value: str
    note: str = ""


@dataclass(slots=True, kw_only=True)
class Page:
    """A page under construction: sections are added in order. style: rules of its own, after the common ones."""

    title: str
    subtitle: str
    verdict: Verdict
    cards: Sequence[Card]
    style: str = ""
    _sections: list[str] = field(default_factory=list)
    _figures: list[dict[str, object]] = field(default_factory=list)

    def add(self, heading: str, explanation: str, *parts: str) -> None:
        """Add a section: heading and explanation are plain text, parts are HTML."""
        lead = f"<p>{text(explanation)}</p>" if explanation else ""
        self._sections.append(f"<section><h2>{text(heading)}</h2>{lead}{''.join(parts)}</section>")

    def add_notes(self, notes: Sequence[str], heading: str = "What to know") -> None:
        """Add what to know of the result, where there is something."""
        if notes:
            self.add(heading, "", bullets(notes))

    def add_inputs(self, inputs: Sequence[tuple[str, str]]) -> None:
        """Add (what, which) of each thing that went in, where there is one."""
        if inputs:
            self.add("What went in", "", table(["", ""], inputs))

    def plot(self, figure: Figure) -> str:
        """Take a figure; return its place in the page."""
        name = f"figure{len(self._figures) + 1}"
        shape = dict(figure.layout)
        if "scene" in shape:
            shape["margin"] = {"l": 0, "r": 0, "t": 28, "b": 0}  # its axes stand inside
        if shape.get("scene", {}).get("aspectmode") == "data":
            shape["scene"] = fitted_scene(shape["scene"], figure.data)
        self._figures.append({"id": name, "data": figure.data, "layout": shape})
        style = f"height:{figure.height_px}px;--least:{_least_px(figure.layout)}px"
        return f'<div class="scroll"><div class="plot" id="{name}" style="{style}"></div></div>'

    def html(self, *, created: datetime | None = None) -> str:
        """Return the whole page. created: now where it is not given."""
        cards = "".join(
            f"<div><span>{text(card.name)}</span><b>{text(card.value)}</b><small>{text(card.note)}</small></div>"
            for card in self.cards
        )
        verdict = (
            f'<div class="verdict {text(self.verdict.level)}"><strong>{text(self.verdict.headline)}</strong>'
            f"{text(' '.join(self.verdict.reasons))}<p><b>What to do</b> {text(' '.join(self.verdict.next))}</p></div>"
        )
        figures = _base64(gzip.compress(json_text(self._figures).encode(), 9, mtime=0))
        when = (created or datetime.now()).strftime("%Y-%m-%d %H:%M")
        return (
            '<!doctype html><html lang="en"><head><meta charset="utf-8">'
            f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
            '<meta name="viewport" content="width=device-width,initial-scale=1">'
            f"<title>{text(self.title)}</title><style>{STYLE}{self.style}</style></head><body><main>"
            f"<header><h1>{text(self.title)}</h1><p>{text(self.subtitle)}</p></header>"
            f'{verdict}<div class="cards">{cards}</div>{"".join(self._sections)}'
            f"<footer>armsight {text(__version__)}, {text(when)}. This file is complete in itself and "
            "loads nothing from the network.</footer></main>"
            f'<script type="text/plain" id="figures">{figures}</script>'
            f'<script type="text/plain" id="plotly">{packed_plotly()}</script>'
            f"<script>{SCRIPT}</script></body></html>\n"
        )


def _least_px(shape: Plot) -> int:
    """Return how wide a plot must be on a telephone: its narrowest panel PANEL_PX; 0 of panels all across."""
    parts = [axis.get("domain", (0.0, 1.0)) for name, axis in shape.items() if name.startswith("xaxis")]
    share = min((high - low for low, high in parts), default=1.0)
    return 0 if share > 0.9 else round(PANEL_PX / share)


def table(header: Sequence[str], rows: Sequence[Sequence[object]], *, numbers: Sequence[int] = ()) -> str:
    """Return a table of plain text; the columns in numbers are set to the right. A column without name and
    text is left out, and so is a header without names."""
    kept = [i for i, name in enumerate(header) if name or any(row[i] != "" for row in rows)]
    header, rows = [header[i] for i in kept], [[row[i] for i in kept] for row in rows]
    mark = ['class="n"' if i in numbers else "" for i in kept]
    if mark and not mark[-1] and any(len(str(row[-1])) > SENTENCE for row in rows):
        mark[-1] = 'class="t"'
    head = "".join(f"<th {m}>{text(name)}</th>" for m, name in zip(mark, header, strict=True))
    body = "".join(
        "<tr>" + "".join(f"<td {m}>{text(cell)}</td>" for m, cell in zip(mark, row, strict=True)) + "</tr>"
        for row in rows
    )
    head = f"<thead><tr>{head}</tr></thead>" if any(header) else ""
    return f'<div class="scroll"><table>{head}<tbody>{body}</tbody></table></div>'


def bullets(items: Sequence[str]) -> str:
    """Return a list of plain text."""
    return "<ul>" + "".join(f"<li>{text(item)}</li>" for item in items) + "</ul>"


def add_recordings(page: Page, files: Sequence[str]) -> None:
    """Tell how to look through recordings, picture by picture, on this machine."""
    ways = [(f"{file}: rerun {shlex.quote(file)}", "or drop it on Foxglove's window (Ctrl-O there)") for file in files]
    if ways:
        page.add(
            "Look through the recording",
            "Pictures, spots and poses on one time line, to go through back and forth. Both programs read the file as "
            "it is, where they are installed; nothing leaves this machine.",
            bullets([", ".join(way) for way in ways]),
        )


def in_degrees(sentence: str) -> str:
    """Return a sentence of the command line with the signs that a page has everywhere."""
    return re.sub(r"(?<=\d) deg(rees)?\b", "°", sentence)


def page_unit(unit: str) -> str:
    """Return the unit as pages write it: with the degree sign."""
    return "°" if unit == "deg" else unit
