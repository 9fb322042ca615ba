"""Boards to print in true size, as PDF or SVG of one page, with two rulers to measure the print by.

Lengths are mm from the paper's upper left corner, y down.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from math import cos, pi, sin, sqrt, tan
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np

from armsight.arrays import Array
from armsight.errors import UsageError
from armsight.fields import Doc
from armsight.records import Target, TargetKind
from armsight.records.output import Output, output
from armsight.records.views import symmetries
from armsight.shown import Shown
from armsight.store.atomic import write_text
from armsight.store.targets import board_text
from armsight.units import MM

PAPERS: Mapping[str, tuple[float, float]] = {
    **{
        f"a{n}": size
        for n, size in enumerate(((841, 1189), (594, 841), (420, 594), (297, 420), (210, 297), (148, 210)))
    },
    "letter": (215.9, 279.4),
    "legal": (215.9, 355.6),
    "tabloid": (279.4, 431.8),
}
"""Width and height, mm."""
OFFICE = PAPERS["a4"]
"""What every printer holds."""
LEAST_PAPER_MM, MOST_PAPER_MM = 50.0, 3000.0
EDGE_MM, TICK_MM, LINE_MM, TEXT_MM = 5.0, 4.0, 0.2, 3.0
"""Printers leave about so much blank at an edge; length and width of a ruler's ticks, height of letters."""
MARGIN_MM = 14.0
"""Between the paper's edge and the board: edge, ruler, and as much white again as detectors need around a board."""
RULER_STEP_MM, FINE_STEP_MM = 50.0, 10.0
"""Rulers are so many mm long, or as many of the finer ones, at which they have ticks."""
DOT_SHARE = 0.5
"""A dot's diameter over the distance to its nearest neighbour, where nothing is said."""
ARCS = 8
"""Pieces of a circle in a PDF, whose curves are cubic: its radius is then true to one part in a million."""
POINTS_PER_MM = 72.0 / 25.4
KALIBR_BORDER = 2
"""Cells of black round a tag's code, as Kalibr prints them."""


@output
class BoardPrint(Output):
    """armsight board."""

    board: Annotated[str, Doc("The board, as --board takes it.")]
    file: Annotated[str, Doc("The file written.")]
    paper_m: Annotated[tuple[float, float], Doc("Width and height of the page.")]
    size_m: Annotated[tuple[float, float], Doc("Width and height of what is printed of the board.")]
    rulers_m: Annotated[tuple[float, float], Doc("Lengths of the rulers, across and down.")]
    notes: Annotated[tuple[str, ...], Doc("What to know of this print.")]

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        (w, h), (across, down) = (np.array(pair) / MM for pair in (self.size_m, self.rulers_m))
        yield f"{self.board}, {w:.4g} x {h:.4g} mm: {self.file}"
        yield f"  print at 100 %, then measure the rulers: {across:g} mm across, {down:g} mm down"
        yield from (f"  {note}" for note in self.notes)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Printed:
    """What is black on a page: bars (n, 4) of x, y, width, height, dots (m, 3) of x, y, diameter; over width, height.

    texts: x, y, height, words.
    """

    bars: Array
    dots: Array
    width: float
    height: float
    texts: tuple[tuple[float, float, float, str], ...] = ()


def paper_of(text: str) -> tuple[float, float]:
    """Return the paper's width and height, mm, of a name of PAPERS or of WIDTHxHEIGHT in mm. Raises UsageError."""
    if text.lower() in PAPERS:
        return PAPERS[text.lower()]
    size = re.fullmatch(r"(\d{1,5}(?:\.\d+)?)[xX](\d{1,5}(?:\.\d+)?)", text)
    found = None if size is None else (float(size[1]), float(size[2]))
    if found is None or not all(LEAST_PAPER_MM <= side <= MOST_PAPER_MM for side in found):
        raise UsageError(
            f"{text[:40]!r} is no paper",
            consequence="Nothing is written",
            cure=f"Choose one of {', '.join(PAPERS)}, or give WIDTHxHEIGHT in mm such as 600x900, 50 to 3000 each",
        )
    return found


def print_board(
    board: Target, out: Path, *, paper: str, dot_m: float | None, bigger_first: bool, old_layout: bool
) -> BoardPrint:
    """Write a board as PDF or SVG of one page, by the name's ending, in the middle of a paper and turned as it fits.

    dot_m: diameter of the dots of a circle grid, else the board's own, else half their distance. bigger_first: the
    first dot is twice as wide. old_layout: of a ChArUco board, that before OpenCV 4.6. Raises UsageError where the
    board is larger than the paper, or cannot be printed; DeviceFailed.
    """
    texts = {".pdf": pdf_text, ".svg": svg_text}
    if out.suffix.lower() not in texts:
        raise UsageError(f"{out.name} ends in neither .pdf nor .svg", cure="Choose one of them")
    black = black_of(board, dot_m=dot_m, bigger_first=bigger_first, old_layout=old_layout)
    said, size = board_text(board), paper_of(paper)
    page = _page(black, size, f"{said}{' old layout' if old_layout else ''}")
    if page is None:
        raise _too_large(board, black, size)
    write_text(out, texts[out.suffix.lower()](page))
    sizes = ((one.width * MM, one.height * MM) for one in (page, black))
    rulers = (_ruler_mm(page.width) * MM, _ruler_mm(page.height) * MM)
    notes = tuple(_notes(board, size, bigger_first))
    return BoardPrint(board=said, file=str(out), paper_m=next(sizes), size_m=next(sizes), rulers_m=rulers, notes=notes)


def _page(black: Printed, paper: tuple[float, float], what: str) -> Printed | None:
    """Return the board in the middle of the paper, upright where it fits so, with rulers; None where it does not."""
    fits = [size for size in (paper, paper[::-1]) if _free(black, size) >= 1.0]
    if not fits:
        return None
    width, height = fits[0]
    x, y = 0.5 * (width - black.width), 0.5 * (height - black.height)
    across, down = _ruler_mm(width), _ruler_mm(height)
    below = _moved(_ruler(across), 0.5 * (width - across), height - EDGE_MM - TICK_MM)
    beside = _moved(_ruler(down), 0.5 * (height - down), EDGE_MM)[:, [1, 0, 3, 2]]
    title = f"{what} - print at 100 %, then measure the rulers: {across:g} mm across, {down:g} mm down"
    letters = min(TEXT_MM, (width - 2.0 * MARGIN_MM) / (0.5 * len(title)))
    return Printed(
        bars=np.concatenate([_moved(black.bars, x, y), below, beside]),
        dots=_moved(black.dots, x, y),
        width=width,
        height=height,
        texts=((MARGIN_MM, EDGE_MM + TEXT_MM, letters, title),),
    )


def _moved(shapes: Array, x: float, y: float) -> Array:
    """Return shapes (n, k), which begin with a place, moved by x, y."""
    return np.concatenate([shapes[:, :2] + np.array([x, y]), shapes[:, 2:]], axis=1)


def _free(black: Printed, paper: tuple[float, float]) -> float:
    """Return by how much the board could be larger on a paper, below one where it does not fit."""
    return min((paper[0] - 2.0 * MARGIN_MM) / black.width, (paper[1] - 2.0 * MARGIN_MM) / black.height)


def _too_large(board: Target, black: Printed, paper: tuple[float, float]) -> UsageError:
    larger = [name for name in PAPERS if name.startswith("a") and max(_free(black, s) for s in _both(name)) >= 1.0]
    share = max(_free(black, paper), _free(black, paper[::-1]))
    most = np.floor(1e4 * share * (board.marker_m if board.kind is TargetKind.APRILGRID else board.pitch_m)) / 1e4
    return UsageError(
        f"the board is {black.width:.1f} x {black.height:.1f} mm, and paper of {paper[0]:g} x {paper[1]:g} mm holds "
        f"{paper[0] - 2.0 * MARGIN_MM:g} x {paper[1] - 2.0 * MARGIN_MM:g} mm beside the rulers",
        consequence="It would be cut off",
        cure=f"Choose --paper {larger[-1] if larger else 'WIDTHxHEIGHT in mm'}, or a board of {most:g} m in place of "
        "the length given, or of fewer columns and rows",
    )


def _both(paper: str) -> tuple[tuple[float, float], tuple[float, float]]:
    return PAPERS[paper], PAPERS[paper][::-1]


def _notes(board: Target, paper: tuple[float, float], bigger_first: bool) -> Iterator[str]:
    """Yield what to know before the board is printed and used."""
    if max(paper) > max(OFFICE):
        yield (
            "the paper is larger than A4: an office printer shrinks the page to its own, and every length with it; "
            "have it printed at 100 % on a plotter"
        )
    if len(symmetries(board)) > 1 and not bigger_first:
        yield (
            "turned about, this board looks the same, so that its first point is not known; where poses count, take "
            + ("--bigger-first" if board.kind is TargetKind.CIRCLES else "one count odd, the other even")
        )


def _ruler_mm(side: float) -> float:
    """Return the length of the ruler along a side of the paper: whole 50 mm, of a small paper whole 10 mm."""
    free = side - 2.0 * (EDGE_MM + TICK_MM)
    step = RULER_STEP_MM if free >= RULER_STEP_MM else FINE_STEP_MM
    return float(step * (free // step))


def _ruler(length: float) -> Array:
    """Return the bars (n, 4) of a ruler along x from 0; ticks are as wide to both sides of what they mark."""
    at = np.arange(0.0, length + 1.0, FINE_STEP_MM)
    short = np.where((at % RULER_STEP_MM == 0.0) | (at == length), 0.0, 0.5 * TICK_MM)
    ticks = np.stack([at - 0.5 * LINE_MM, short, np.full(len(at), LINE_MM), TICK_MM - short], axis=1)
    return np.concatenate([[[0.0, TICK_MM - 0.5 * LINE_MM, length, LINE_MM]], ticks])


# What is black of each kind of board.


def black_of(board: Target, *, dot_m: float | None, bigger_first: bool, old_layout: bool) -> Printed:
    """Return the board alone, from its upper left corner, mm."""
    round_, charuco = board.kind in (TargetKind.CIRCLES, TargetKind.ACIRCLES), board.kind is TargetKind.CHARUCO
    if (dot_m is not None or bigger_first) and not round_:
        raise UsageError(
            f"a board of kind {board.kind.value} has no dots",
            cure="Leave --dot and --bigger-first away, or give circles",
        )
    if old_layout and not charuco:
        raise UsageError(
            f"a board of kind {board.kind.value} has one layout",
            cure="Leave --old-layout away, or give a ChArUco board",
        )
    if round_:
        return _dots(board, dot_m, bigger_first)
    if board.kind is TargetKind.APRILGRID:
        return _tags(board)
    pitch, columns, rows = board.pitch_m / MM, board.columns, board.rows
    if not charuco:
        columns, rows = columns + 1, rows + 1
    r, c = np.mgrid[0:rows, 0:columns].reshape(2, -1)
    # OpenCV's ChArUco boards of even rows began with a white square before 4.6
    dark = (r + c) % 2 == (1 if old_layout and rows % 2 == 0 else 0)
    squares = _squares(c[dark] * pitch, r[dark] * pitch, pitch)
    if charuco:
        squares = np.concatenate([squares, _markers(board, c[~dark], r[~dark])])
    return Printed(bars=squares, dots=np.zeros((0, 3)), width=columns * pitch, height=rows * pitch)


def _squares(x: Array, y: Array, side: float) -> Array:
    return np.stack([x, y, np.full(len(x), side), np.full(len(x), side)], axis=1)


def _dots(board: Target, dot_m: float | None, bigger_first: bool) -> Printed:
    near_m = board.pitch_m * (sqrt(2.0) if board.kind is TargetKind.ACIRCLES else 1.0)
    diameter_m = dot_m or board.diameter_m or DOT_SHARE * near_m
    first_m = 2.0 * diameter_m if bigger_first else diameter_m
    if not 0.5 * (diameter_m + first_m) < near_m:
        raise UsageError(
            f"dots of {diameter_m / MM:g} mm{', the first twice as wide,' if bigger_first else ''} that are "
            f"{near_m / MM:.4g} mm apart touch",
            consequence="No dot stands alone",
            cure=f"Give --dot of {DOT_SHARE * near_m:.4g} m or less",
        )
    dots = np.concatenate([board.xyz_m[:, :2], np.full((len(board.xyz_m), 1), diameter_m)], axis=1) / MM
    dots[0, 2] = first_m / MM
    dots[:, :2] -= (dots[:, :2] - 0.5 * dots[:, 2:]).min(axis=0)
    width, height = (dots[:, :2] + 0.5 * dots[:, 2:]).max(axis=0)
    return Printed(bars=np.zeros((0, 4)), dots=dots, width=float(width), height=float(height))


def _markers(board: Target, c: Array, r: Array) -> Array:
    """Return the black cells of a ChArUco board's markers, in the middle of squares in columns c and rows r (n,)."""
    code = getattr(cv2.aruco, board.dictionary, None)
    if code is None:
        known = ", ".join(name for name in sorted(dir(cv2.aruco)) if name.startswith("DICT_"))
        raise UsageError(f"no marker dictionary is called {board.dictionary!r}", cure=f"Choose one of {known}")
    shift = 0.5 * (board.pitch_m - board.marker_m) / MM
    at = np.stack([c, r], axis=1) * board.pitch_m / MM + shift
    return np.concatenate(
        [_cells(cells, x, y, board.marker_m / MM) for cells, (x, y) in zip(_codes(code, len(at), 1), at, strict=True)]
    )


def _codes(dictionary: int, count: int, border: int) -> list[Array]:
    """Return the cells (k, k), 1 for white, of a dictionary's first markers. Raises UsageError where it has fewer."""
    known: Any = cv2.aruco.getPredefinedDictionary(dictionary)
    if count > len(known.bytesList):
        raise UsageError(
            f"the board needs {count} markers, and the dictionary has {len(known.bytesList)}",
            consequence="Two markers would be the same",
            cure="Choose a larger dictionary, or fewer columns and rows",
        )
    side = known.markerSize + 2 * border
    drawn = [cv2.aruco.generateImageMarker(known, k, side, borderBits=border) for k in range(count)]
    return [np.asarray(one / 255.0) for one in drawn]


def _cells(white: Array, x: float, y: float, side: float) -> Array:
    """Return the black cells of a marker with its upper left corner at x, y; neighbours in a row are one bar."""
    k, bars = len(white), []
    for row, line in enumerate(white):
        ends = np.flatnonzero(np.diff(np.concatenate([[0], 1 - line.astype(int), [0]])))
        bars += [(x + a * side / k, y + row * side / k, (b - a) * side / k, side / k) for a, b in ends.reshape(-1, 2)]
    return np.array(bars)


def _tags(board: Target) -> Printed:
    """Return an AprilGrid as kalibr_create_target_pdf draws it: tag 0 at the lower left, squares at tags' corners."""
    pitch, side = board.pitch_m / MM, board.marker_m / MM
    gap = pitch - side
    codes = _codes(cv2.aruco.DICT_APRILTAG_36h11, board.columns * board.rows, KALIBR_BORDER)
    parts = []
    for tag, cells in enumerate(codes):
        row, column = divmod(tag, board.columns)
        # OpenCV draws the family's codes half a turn from how the family and Kalibr do
        parts.append(_cells(cells[::-1, ::-1], gap + column * pitch, gap + (board.rows - 1 - row) * pitch, side))
    r, c = np.mgrid[0 : board.rows + 1, 0 : board.columns + 1].reshape(2, -1)
    parts.append(_squares(c * pitch, r * pitch, gap))
    size = board.columns * pitch + gap, board.rows * pitch + gap
    return Printed(bars=np.concatenate(parts), dots=np.zeros((0, 3)), width=size[0], height=size[1])


# One page, as text.


def svg_text(page: Printed) -> str:
    """Return the page as SVG in mm. All squares are one path, so that no hairlines of white show between them."""
    width, height = page.width, page.height
    bars = " ".join(f"M{_numbers(x, y)}h{_numbers(w)}v{_numbers(h)}h{_numbers(-w)}z" for x, y, w, h in page.bars)
    dots = "\n".join(f'<circle cx="{_numbers(x)}" cy="{_numbers(y)}" r="{_numbers(d / 2)}"/>' for x, y, d in page.dots)
    texts = "\n".join(
        f'<text x="{_numbers(x)}" y="{_numbers(y)}" font-size="{_numbers(size)}" '
        f'font-family="Helvetica, Arial, sans-serif">{escape(text)}</text>'
        for x, y, size, text in page.texts
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}">\n<rect width="{width:g}" height="{height:g}" fill="white"/>\n'
        f'<path d="{bars}"/>\n{dots}\n{texts}\n</svg>\n'
    )


def pdf_text(page: Printed) -> str:
    """Return the page as PDF 1.4, whose viewers are asked not to scale it (PDF Reference 1.7, 8.1)."""
    width, height = (side * POINTS_PER_MM for side in (page.width, page.height))
    parts = [f"{POINTS_PER_MM:.10f} 0 0 {-POINTS_PER_MM:.10f} 0 {height:.6f} cm"]
    parts += [f"{_numbers(*square)} re" for square in page.bars]
    parts += [_circle(x, y, 0.5 * d) for x, y, d in page.dots]
    parts.append("f")
    for x, y, size, text in page.texts:
        shown = re.sub(r"([\\()])", r"\\\1", text)
        parts.append(f"BT /F1 {_numbers(size)} Tf 1 0 0 -1 {_numbers(x, y)} Tm ({shown}) Tj ET")
    drawn = "\n".join(parts)
    return _document(
        [
            "<</Type/Catalog/Pages 2 0 R/ViewerPreferences<</PrintScaling/None>>>>",
            "<</Type/Pages/Kids[3 0 R]/Count 1>>",
            f"<</Type/Page/Parent 2 0 R/MediaBox[0 0 {width:.6f} {height:.6f}]/Contents 4 0 R"
            "/Resources<</Font<</F1 5 0 R>>>>>>",
            f"<</Length {len(drawn)}>>\nstream\n{drawn}\nendstream",
            "<</Type/Font/Subtype/Type1/BaseFont/Helvetica>>",
        ]
    )


def _document(objects: Sequence[str]) -> str:
    """Return a PDF of objects, the first its catalogue, with the table of where each begins; all of it is ASCII."""
    text, begins = "%PDF-1.4\n", []
    for number, content in enumerate(objects, start=1):
        begins.append(len(text))
        text += f"{number} 0 obj\n{content}\nendobj\n"
    table = "".join(f"{at:010d} 00000 n \n" for at in begins)
    size = len(objects) + 1
    return (
        f"{text}xref\n0 {size}\n0000000000 65535 f \n{table}trailer\n<</Size {size}/Root 1 0 R>>\n"
        f"startxref\n{len(text)}\n%%EOF\n"
    )


def _circle(x: float, y: float, radius: float) -> str:
    """Return a circle of cubic curves, each touching it at both ends."""
    turn = 2.0 * pi / ARCS
    reach = 4.0 / 3.0 * tan(0.25 * turn)
    out = [f"{_numbers(x + radius, y)} m"]
    for k in range(ARCS):
        (c0, s0), (c1, s1) = ((cos(k * turn), sin(k * turn)), (cos((k + 1) * turn), sin((k + 1) * turn)))
        ends = (c0 - reach * s0, s0 + reach * c0, c1 + reach * s1, s1 - reach * c1, c1, s1)
        out.append(_numbers(*(at + radius * end for at, end in zip((x, y) * 3, ends, strict=True))) + " c")
    return " ".join(out)


def _numbers(*values: float) -> str:
    return " ".join(f"{value:.6f}".rstrip("0").rstrip(".") for value in values)
