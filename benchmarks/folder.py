"""armsight measure on a folder of PNG pairs: pairs a second with decoding, and memory at 10 % and at the end.

The pairs are a simulated cell's frames, played forwards and backwards as often as needed: files beyond the first
few hundred are hard links, so every file is opened and decoded, from the page cache as a recording just made is.

    python benchmarks/folder.py [--pairs 10000] [--quick]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2

from bench import machine, table

DISTINCT = 200
TARGET_PAIRS_S = 60.0
SAMPLE_S = 0.05


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=1000)
    parser.add_argument("--quick", action="store_true", help="200 pairs, 40 of them distinct")
    options = parser.parse_args()
    pairs, distinct = (200, 40) if options.quick else (options.pairs, min(DISTINCT, options.pairs))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_folder(folder, pairs, distinct)
        run(folder, folder / "warm", ["--frames", "3"])  # compiles, where the cache is empty
        seconds, memory_mb, summary = run(folder, folder / "out", [])
        decode_s = decode_only(folder, min(pairs, 500))
        size_mb = sum(path.stat().st_size for path in (folder / "left").iterdir()) / pairs / 1e6
    tenth, end = memory_mb[len(memory_mb) // 10], memory_mb[-1]
    rate = pairs / seconds
    print(machine())
    table(
        "armsight measure on a folder of PNG pairs, 1280x720",
        ["", "value"],
        [
            ["pairs (posed, position only, lost)", f"{pairs} ({summary['n_ok']}, {summary['n_position_only']}, "
             f"{summary['n_lost']})"],
            ["size of a PNG, MB", round(size_mb, 3)],
            ["whole program, s", round(seconds, 1)],
            ["pairs a second, start included", f"{rate:.1f} (wanted {TARGET_PAIRS_S:g})"],
            ["cv2.imread alone in one thread, pairs a second", round(1.0 / decode_s, 1)],
            ["measuring a pair, ms median / p99", f"{summary['ms_per_frame']['median']:.3f} / "
             f"{summary['ms_per_frame']['p99']:.3f}"],
            ["memory at 10 % of the time, MB", round(tenth)],
            ["memory at the end, MB", round(end)],
        ],
    )  # fmt: skip


def make_folder(folder: Path, pairs: int, distinct: int) -> None:
    """Write the frames: simulate the distinct ones, link the others forwards and backwards."""
    command("simulate", "webcam-cell", "--frames", str(distinct), "-o", str(folder / "cell"))
    there_and_back = [*range(distinct), *range(distinct - 2, 0, -1)] if distinct > 2 else list(range(distinct))
    for side in ("left", "right"):
        (folder / side).mkdir()
        originals = sorted((folder / "cell" / side).iterdir())
        for index in range(pairs):
            original = originals[there_and_back[index % len(there_and_back)]]
            os.link(original, folder / side / f"{index:06d}.png")


def run(folder: Path, out: Path, more: list[str]) -> tuple[float, list[float], dict]:
    """Run armsight measure; return its seconds, its memory in MB over time, and what it says."""
    words = ["measure", "--rig", str(folder / "cell/rig.yaml"), "--target", str(folder / "cell/target.yaml"),
             "--left", str(folder / "left"), "--right", str(folder / "right"), "--fps", "60", "-o", str(out), "--json",
             *more]  # fmt: skip
    start_s = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-c", "from armsight.cli import main; main()", *words],
                               stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)  # fmt: skip
    memory = []
    while process.poll() is None:
        memory.append(resident_mb(process.pid))
        time.sleep(SAMPLE_S)
    seconds = time.perf_counter() - start_s
    content = json.loads(process.stdout.read())
    if process.returncode:
        raise SystemExit(f"armsight measure failed: {content}")
    return seconds, [value for value in memory if value > 0.0], content


def resident_mb(pid: int) -> float:
    """Return a process's resident memory in MB, 0 where it has just ended."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0
    found = [line for line in lines if line.startswith("VmRSS")]
    return float(found[0].split()[1]) / 1024.0 if found else 0.0


def decode_only(folder: Path, count: int) -> float:
    """Return seconds per pair of reading the files with OpenCV and nothing else, in one thread."""
    files = [folder / side / f"{index:06d}.png" for index in range(count) for side in ("left", "right")]
    start_s = time.perf_counter()
    for path in files:
        cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    return (time.perf_counter() - start_s) / count


def command(*words: str) -> None:
    subprocess.run([sys.executable, "-c", "from armsight.cli import main; main()", *words], check=True)


if __name__ == "__main__":
    main()
