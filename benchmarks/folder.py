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
    print(machine())
    measured(*((200, 40) if options.quick else (options.pairs, min(DISTINCT, options.pairs))))


def measured(pairs: int, distinct: int) -> None:
    """Print what measuring so many pairs takes, so many of them distinct."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_folder(folder, pairs, distinct)
        run(folder, folder / "warm", ["--frames", "3"])  # compiles, where the cache is empty
        _, _, start = run(folder, folder / "start", ["--frames", "3"])
        seconds, samples, summary = run(folder, folder / "out", [])
        decode_s = decode_only(folder, min(pairs, 500))
        size_mb = sum(path.stat().st_size for path in (folder / "left").iterdir()) / pairs / 1e6
    rows = max(written for _, written in samples)
    tenth = next(mb for mb, written in samples if written >= 0.1 * rows)
    last = next(mb for mb, written in samples if written >= 0.99 * rows)
    most = max(mb for mb, _ in samples)
    rate, cpu_ms = pairs / seconds, (summary["cpu_s"] - start["cpu_s"]) / pairs * 1e3
    table(
        "armsight measure on a folder of PNG pairs, 1280x720",
        ["", "value"],
        [
            ["pairs (posed, position only, lost)", f"{pairs} ({summary['n_ok']}, {summary['n_position_only']}, "
             f"{summary['n_lost']})"],
            ["size of a PNG, MB", round(size_mb, 3)],
            ["whole program, s", round(seconds, 1)],
            ["pairs a second, start included", f"{rate:.1f} (wanted {TARGET_PAIRS_S:g})"],
            ["processor time a pair, ms (all threads)", f"{cpu_ms:.1f}"],
            ["other work on the machine, processes running", f"{os.getloadavg()[0]:.1f}"],
            ["cv2.imread alone in one thread, pairs a second", round(1.0 / decode_s, 1)],
            ["measuring a pair, ms median / p99", f"{summary['ms_per_frame']['median']:.3f} / "
             f"{summary['ms_per_frame']['p99']:.3f}"],
            ["memory with 10 % of the poses written, MB", round(tenth)],
            ["memory with all poses written, MB", round(last)],
            ["memory at most, while the report is written, MB", round(most)],
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


def run(folder: Path, out: Path, more: list[str]) -> tuple[float, list[tuple[float, int]], dict]:
    """Run armsight measure; return its seconds, (memory in MB, bytes of poses.csv) over time, and what it says."""
    words = ["measure", "--rig", str(folder / "cell/rig.yaml"), "--target", str(folder / "cell/target.yaml"),
             "--left", str(folder / "left"), "--right", str(folder / "right"), "--fps", "60", "-o", str(out), "--json",
             *more]  # fmt: skip
    start_s, before = time.perf_counter(), os.times()
    process = subprocess.Popen([sys.executable, "-c", "from armsight.cli import main; main()", *words],
                               stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)  # fmt: skip
    memory, poses = [], out / "poses.csv"
    while process.poll() is None:
        written = poses.stat().st_size if poses.exists() else 0
        memory.append((resident_mb(process.pid), written))
        time.sleep(SAMPLE_S)
    process.wait()
    seconds, after = time.perf_counter() - start_s, os.times()
    content = json.loads(process.stdout.read())
    if process.returncode:
        raise SystemExit(f"armsight measure failed: {content}")
    content["cpu_s"] = sum(after[2:4]) - sum(before[2:4])  # of children that have ended
    return seconds, [sample for sample in memory if sample[0] > 0.0], content


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
