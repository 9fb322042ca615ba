"""Files of other people's public repositories, by repository, commit and path: none is kept here, nothing is fetched.

The folder that $ARMSIGHT_PUBLIC names holds OWNER+NAME each: a clone (or OWNER+NAME/repo, bare or not), or the file
alone under its path. A test of a file that is not there is skipped.
"""

import os
import subprocess
from pathlib import Path

import pytest

FOLDER = Path(os.environ.get("ARMSIGHT_PUBLIC", Path(__file__).parents[2] / "shared" / "data" / "public"))


def public_file(repository, commit, path):
    """The bytes of a file of a public repository."""
    copy = FOLDER / repository.replace("/", "+")
    if (copy / path).is_file():
        return (copy / path).read_bytes()
    git = next(
        (one for one in (copy / "repo", copy) if any((one / part).is_dir() for part in ("objects", ".git"))), None
    )
    shown = git and subprocess.run(["git", "-C", git, "show", f"{commit}:{path}"], capture_output=True, check=False)
    if not shown or shown.returncode:
        pytest.skip(f"{repository} at {commit}, {path} is not in {FOLDER}")
    return shown.stdout
