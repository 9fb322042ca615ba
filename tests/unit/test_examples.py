"""Every example runs as written, is short, and leaves nothing behind."""

import os
import subprocess
from pathlib import Path

import pytest

import warm_python

EXAMPLES = sorted((Path(__file__).resolve().parents[2] / "examples").glob("*"))
LONGEST = 25
"""Lines of an example that are not blank: what is longer is no example."""


def test_they_are_numbered_and_short() -> None:
    assert [path.name[:3] for path in EXAMPLES] == [f"{number:02d}_" for number in range(1, 17)]
    counts = {path.name: sum(bool(line.strip()) for line in path.read_text().splitlines()) for path in EXAMPLES}
    assert {name: count for name, count in counts.items() if count > LONGEST} == {}


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs(example: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [warm_python.commands() / "python", str(example)],
        cwd=tmp_path, env={**os.environ, "TMPDIR": str(tmp_path)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    assert done.stdout
    assert list(tmp_path.iterdir()) == []
