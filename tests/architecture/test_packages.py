"""Wheels and sources hold all that the packages need, and nothing that lies beside them."""

import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MADE = {".pyc", ".nbi", ".nbc"}
PACKAGES = [(".", "armsight"), ("sim", "armsight_sim"), ("plant", "armsight_plant"), ("lab", "armsight_lab")]
BESIDE = {"CHANGELOG.md", "LICENSE", "README.md", "PKG-INFO", ".gitignore", "pyproject.toml"}


@pytest.mark.parametrize(("folder", "package"), PACKAGES)
def test_a_package_is_whole(folder, package, tmp_path):
    command = [sys.executable, "-m", "hatchling", "build", "--directory", str(tmp_path)]
    subprocess.run(command, cwd=ROOT / folder, check=True, capture_output=True)
    source = ROOT / folder / "src"
    own = {
        file.relative_to(source).as_posix()
        for file in (source / package).rglob("*")
        if file.is_file() and file.suffix not in MADE
    }
    (wheel,), (sdist,) = tmp_path.glob("*.whl"), tmp_path.glob("*.tar.gz")
    with zipfile.ZipFile(wheel) as archive:
        assert {name for name in archive.namelist() if ".dist-info/" not in name} == own
    with tarfile.open(sdist) as archive:
        held = {Path(*Path(name).parts[1:]).as_posix() for name in archive.getnames()}
    assert {name.removeprefix("src/") for name in held if name.startswith("src/")} == own
    assert {name for name in held if not name.startswith("src/")} <= BESIDE
