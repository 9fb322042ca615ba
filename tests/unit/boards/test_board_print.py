"""Boards as they are printed, read back from renderings of other programs by armsight, by OpenCV and by eye."""

import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from armsight import print_board
from armsight.errors import UsageError
from armsight.measure.boards import find_board
from armsight.store.targets import parse_board
from kalibr_grid import COLUMNS, ROWS, SPACING, TAG_M, ink

DPI = 150
MM_PX = 25.4 / DPI
CHROMIUM = Path("/usr/bin/chromium")
APRILGRID = f"aprilgrid:{COLUMNS}x{ROWS}:{TAG_M}:{SPACING}"
CHARUCO = "charuco:5x6:0.03:0.02:DICT_5X5_100"
needs_poppler = pytest.mark.skipif(shutil.which("pdftocairo") is None, reason="poppler-utils is not installed")


def rendered(folder: Path, board: str, *, dpi: int = DPI, **how: object):
    """Return what print_board says, and the page's picture: uint8 (h, w), centre of its first pixel (0, 0)."""
    said = print_board(board, folder / "board.pdf", **how)
    words = ["pdftocairo", "-r", dpi, "-gray", "-png", "-singlefile", folder / "board.pdf", folder / "page"]
    subprocess.run([str(word) for word in words], check=True)
    return said, cv2.imread(str(folder / "page.png"), cv2.IMREAD_GRAYSCALE)


def places(uv: np.ndarray) -> np.ndarray:
    """Return pixels as mm from the page's upper left corner."""
    return (uv + 0.5) * MM_PX


def expected(said, board) -> np.ndarray:
    """Return where the board's points are to be on the page, mm: its middle is the page's."""
    xy = board.xyz_m[:, :2] * 1e3 * ([1, -1] if board.kind == "aprilgrid" else [1, 1])
    return xy - 0.5 * (xy.min(axis=0) + xy.max(axis=0)) + 500.0 * np.array(said.paper_m)


def as_photographed(page: np.ndarray) -> np.ndarray:
    noise = np.random.default_rng(0).normal(0.0, 2.0, page.shape)
    return np.clip(cv2.GaussianBlur(page, (0, 0), 0.8) * 0.8 + 20.0 + noise, 0, 255).astype(np.uint8)


@needs_poppler
@pytest.mark.parametrize(
    ("text", "how"),
    [
        ("checkerboard:9x6:0.025", {}),
        ("circles:7x5:0.03", {}),
        ("acircles:4x11:0.02", {}),
        (CHARUCO, {}),
        (CHARUCO, {"old_layout": True}),
        (APRILGRID, {}),
        ("checkerboard:9x6:0.04", {"paper": "a2"}),
    ],
)
def test_the_points_of_a_print_are_where_they_are_to_be(tmp_path: Path, text, how) -> None:
    board = parse_board(text)
    said, page = rendered(tmp_path, text, **how)
    seen = find_board(as_photographed(page), board)
    assert len(seen) > 0.7 * len(board.names)
    assert places(seen.uv_px) == pytest.approx(expected(said, board)[seen.index], abs=0.01)


@needs_poppler
def test_a_bigger_first_dot_tells_where_x_begins(tmp_path: Path) -> None:
    """Its window holds more pixels than are looked at; upside down the board is numbered from that dot all the same."""
    text = "circles:7x5:0.03"
    _, page = rendered(tmp_path, text, bigger_first=True, dot_m=0.0105)
    photographed, board = as_photographed(page), parse_board(text)
    seen, turned = find_board(photographed, board), find_board(photographed[::-1, ::-1].copy(), board)
    ends = np.array(photographed.shape)[::-1] - 1.0
    off = places(seen.uv_px) - board.xyz_m[seen.index, :2] * 1e3
    assert off == pytest.approx(np.broadcast_to(np.median(off, axis=0), off.shape), abs=0.01)
    assert (ends - turned.uv_px)[np.argsort(turned.index)] == pytest.approx(
        seen.uv_px[np.argsort(seen.index)], abs=0.05
    )


@needs_poppler
@pytest.mark.parametrize("old_layout", [False, True])
def test_a_charuco_board_is_the_one_that_opencv_draws(tmp_path: Path, old_layout: bool) -> None:
    _, page = rendered(tmp_path, CHARUCO, old_layout=old_layout)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    board = cv2.aruco.CharucoBoard((5, 6), 0.03, 0.02, dictionary)
    board.setLegacyPattern(old_layout)
    theirs = board.generateImage((5 * 210, 6 * 210))  # markers of 140 px have cells of 20
    h, w = page.shape
    x, y = ((np.arange(n) + 0.5) / 7.0 for n in (5 * 210, 6 * 210))  # mm from the board's corner, 7 px each
    u, v = (w / 2 + (x - 75.0) / MM_PX - 0.5, h / 2 + (y - 90.0) / MM_PX - 0.5)
    ours = cv2.remap(page, *(at.astype(np.float32) for at in np.meshgrid(u, v)), cv2.INTER_NEAREST)
    assert np.mean((ours > 127) != (theirs > 127)) < 0.01  # one marker is 0.02, one cell of it a fiftieth


@needs_poppler
def test_an_aprilgrid_is_the_one_that_kalibr_draws(tmp_path: Path) -> None:
    said, page = rendered(tmp_path, APRILGRID)
    rows, columns = np.mgrid[0 : page.shape[0], 0 : page.shape[1]]
    x, y = (columns + 0.5) * MM_PX * 1e-3, (rows + 0.5) * MM_PX * 1e-3
    left, top = (np.array(said.paper_m) - said.size_m) / 2
    theirs = ink((x - left) / TAG_M - SPACING, (top + said.size_m[1] - y) / TAG_M - SPACING, border=2)
    inside = (x > left) & (x < left + said.size_m[0]) & (y > top) & (y < top + said.size_m[1])
    assert np.mean(((page > 127) != (theirs > 0.5))[inside]) < 0.01


@needs_poppler
def test_rulers_and_dots_have_their_lengths(tmp_path: Path) -> None:
    said, page = rendered(tmp_path, "circles:7x5:0.03", dpi=2 * DPI, dot_m=0.011)
    dark, px = 1.0 - page / 255.0, 0.5 * MM_PX
    assert said.rulers_m == (0.25, 0.15)
    for length, strip in ((250.0, dark[-int(8.5 / px)]), (150.0, dark[:, int(5.5 / px)])):  # through the long ticks
        at = np.flatnonzero(strip > 0.02)
        ends = [at[at < at[0] + 9], at[at > at[-1] - 9]]
        first, last = (float((strip[end] * end).sum() / strip[end].sum()) for end in ends)
        assert (last - first) * px == pytest.approx(length, abs=0.01)
    middle = dark[tuple(slice(n // 2 - 170, n // 2 + 170) for n in page.shape)]
    assert 2.0 * np.sqrt(middle.sum() / np.pi) * px == pytest.approx(11.0, abs=0.01)


@pytest.mark.skipif(not CHROMIUM.exists(), reason="chromium is not installed")
def test_a_browser_draws_the_same_from_svg(tmp_path: Path) -> None:
    board = parse_board(APRILGRID)
    said = print_board(board, tmp_path / "board.svg")
    assert (
        '<svg xmlns="http://www.w3.org/2000/svg" width="297mm" height="210mm"' in (tmp_path / "board.svg").read_text()
    )
    # a browser rounds 297 mm to whole pixels, so the picture is shown with five of them a millimetre
    (tmp_path / "page.html").write_text(
        '<body style="margin:0"><img src="board.svg" style="width:1485px;height:1050px">'
    )
    words = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}", "--hide-scrollbars"]
    words += ["--window-size=1500,1200", f"--screenshot={tmp_path}/page.png", f"file://{tmp_path}/page.html"]
    subprocess.run([str(CHROMIUM), *words], check=True, capture_output=True)
    seen = find_board(as_photographed(cv2.imread(str(tmp_path / "page.png"), cv2.IMREAD_GRAYSCALE)), board)
    assert (seen.uv_px + 0.5) / 5.0 == pytest.approx(expected(said, board)[seen.index], abs=0.01)


def test_what_cannot_be_printed_is_refused_with_what_can(tmp_path: Path) -> None:
    out = tmp_path / "board.pdf"
    with pytest.raises(UsageError, match=r"Choose paper a0, or a board of 0\.0224 m") as refused:
        print_board("aprilgrid:6x6:0.088:0.3", out)
    assert not out.exists()
    assert "holds 182 x 269 mm" in str(refused.value)
    assert any("larger than A4" in note for note in print_board("aprilgrid:6x6:0.088:0.3", out, paper="a0").notes)
    assert not print_board("aprilgrid:6x6:0.0224:0.3", out).notes
    with pytest.raises(UsageError, match="60 markers"):
        print_board("charuco:12x10:0.015:0.01:DICT_4X4_50", out)
    for words in ({"bigger_first": True, "dot_m": 0.014}, {"dot_m": 0.02}):
        with pytest.raises(UsageError, match="touch"):
            print_board("circles:7x5:0.02", out, **words)
    assert "bigger" in print_board("circles:7x5:0.02", out).notes[0]
    assert "one count odd" in print_board("checkerboard:8x6:0.02", out).notes[0]
