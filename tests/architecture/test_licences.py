"""What armsight stands on may be used beside it: a licence that asks for more is seen."""

from pathlib import Path

import pytest

from loading import module_of

licences = module_of(Path(__file__).resolve().parents[2] / "tools" / "licences.py")


@pytest.mark.parametrize(
    ("expression", "good"),
    [
        ("MPL-2.0 AND (Apache-2.0 OR MIT)", True),
        ("EPL-2.0 OR BSD-3-Clause", True),
        ("GPL-3.0-only OR MIT", True),
        ("GPL-3.0-only", False),
        ("MIT AND GPL-2.0-or-later", False),
        ("GPL-3.0-only AND (Apache-2.0 OR MIT)", False),
        ("not said", False),
    ],
)
def test_a_licence_is_weighed(expression, good):
    assert licences.compatible(expression) is good


def test_every_package_here_goes_with_ours():
    found = list(licences.installed())
    assert {"numpy", "scipy", "pytest"} <= {package.name for package in found}
    assert [package for package in found if not package.known] == []
    assert {package.part for package in found if package.name in ("numpy", "pytest")} == {"", "dev"}
