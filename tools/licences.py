"""The licence of every package that armsight stands on, as a Markdown table.

    python tools/licences.py [--out FILE]

Read from what the installed packages say of themselves, so it wants the whole environment (`make install`). Parts are
the extras of pyproject.toml: a package stands with the first that needs it. Exit code 1 names the packages whose
licence is not known to go with Apache-2.0.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

OURS = ("armsight", "armsight-lab", "armsight-plant", "armsight-sim")
INSTALLATION = "install"
DEVELOPMENT = "dev"
UNSAID = {
    "axe-playwright-python": "MIT",  # its LICENSE file
    "cmeel-qhull": "Qhull",  # COPYING.txt of Qhull: free, its notice kept
    "ezc3d": "MIT",  # its LICENSE file
    "docutils": "BSD-2-Clause",  # public domain for the most part; the GPL is that of an Emacs mode, not installed
    "pyglet": "BSD-3-Clause",  # its LICENSE file
}
"""What packages do not say in their metadata, and where it is said."""
PERMISSIVE = re.compile(
    "(The )?(Apache|MIT|BSD|0BSD|3-Clause BSD|ISC|Zlib|PSF|Python Software Foundation|CC0|BSL-1.0|Qhull|Unlicense"
    "|Public Domain|any-OSI)",
    re.IGNORECASE,
)
SEPARATE = re.compile("MPL|Mozilla|LGPL|GNU Lesser|EPL", re.IGNORECASE)
"""Copyleft of the package's own files: it is used as it is, installed beside armsight, and nothing of it is copied."""


@dataclass(frozen=True)
class Package:
    """One package: part is the extra that needs it, empty for what armsight always needs."""

    name: str
    version: str
    licence: str
    part: str

    @property
    def known(self) -> bool:
        """Whether its licence goes with Apache-2.0."""
        return compatible(self.licence)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, help="file to write it to, in place of the screen")
    out = parser.parse_args().out
    packages = sorted(installed(), key=lambda package: (package.part == DEVELOPMENT, package.name.lower()))
    text = table(packages)
    if out is None:
        print(text, end="")
    else:
        out.write_text(text, encoding="utf-8")
    unknown = [package for package in packages if not package.known]
    for package in unknown:
        print(f"error: {package.name}: {package.licence!r} is not known to go with Apache-2.0", file=sys.stderr)
    return 1 if unknown else 0


def table(packages: list[Package]) -> str:
    """Return the packages as a table."""
    rows = [f"| {each.name} | {each.version} | {each.licence} | {each.part or 'always'} |" for each in packages]
    return "\n".join(["| package | version | licence | needed for |", "|---|---|---|---|", *rows]) + "\n"


def installed() -> Iterator[Package]:
    """Yield each package once, with the first part that needs it."""
    seen = set(OURS)
    extras = [
        extra for extra in distribution(OURS[0]).metadata.get_all("Provides-Extra") or [] if extra != INSTALLATION
    ]
    for part in ("", *sorted(extras, key=lambda extra: extra == DEVELOPMENT)):
        waiting = [name for each in OURS for name in needs(distribution(each), {part})]
        while waiting:
            name, asked = waiting.pop()
            if name in seen:
                continue
            seen.add(name)
            try:
                found = distribution(name)
            except PackageNotFoundError:  # of another platform or Python
                continue
            yield Package(found.name, found.version, licence(found), part)
            waiting += needs(found, asked)


def needs(package: Distribution, extras: set[str]) -> list[tuple[str, set[str]]]:
    """Return what a package requires here with these extras, and the extras of it."""
    required = [Requirement(text) for text in package.requires or []]
    return [
        (canonicalize_name(each.name), each.extras | {""})
        for each in required
        if each.marker is None or any(each.marker.evaluate({"extra": extra}) for extra in extras)
    ]


def compatible(expression: str) -> bool:
    """Return whether a licence goes with Apache-2.0: of alternatives one has to, of several together each."""
    together = re.split(r" AND (?![^(]*\))", expression)
    if len(together) > 1:
        return all(compatible(each.strip("()")) for each in together)
    choices = re.split(r" OR (?![^(]*\))", expression)
    if len(choices) > 1:
        return any(compatible(each.strip("()")) for each in choices)
    return bool(PERMISSIVE.match(expression) or SEPARATE.match(expression))


def licence(package: Distribution) -> str:
    """Return a package's licence: its expression, else its classifiers, else the first line of its text."""
    said = package.metadata
    if "License-Expression" in said:
        return said["License-Expression"]
    if unsaid := UNSAID.get(canonicalize_name(package.name)):
        return unsaid
    classified = [text.rpartition(" :: ")[2] for text in said.get_all("Classifier") or [] if "License ::" in text]
    told = [text for text in classified if text != "DFSG approved"]
    if told:
        return " OR ".join(told)
    return said["License"].strip().splitlines()[0] if "License" in said else "not said"


if __name__ == "__main__":
    raise SystemExit(main())
