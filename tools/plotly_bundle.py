"""Pack a release of plotly.js for the reports: `npm pack plotly.js-gl3d-dist-min`, then run this on the archive."""

from __future__ import annotations

import gzip
import json
import sys
import tarfile
from pathlib import Path

PLACE = Path(__file__).resolve().parents[1] / "src/armsight/report/plotlyjs"
SCRIPT = "plotly-gl3d.min.js"


def main() -> None:
    """Write the script, compressed, its licence, and where both come from."""
    with tarfile.open(sys.argv[1]) as archive:
        script, licence, about = (_member(archive, name) for name in (SCRIPT, "LICENSE", "package.json"))
    found = json.loads(about)
    PLACE.mkdir(exist_ok=True)
    (PLACE / f"{SCRIPT}.gz").write_bytes(gzip.compress(script, 9, mtime=0))
    (PLACE / "LICENSE").write_bytes(licence)
    (PLACE / "NOTICE.txt").write_text(
        f"{SCRIPT}.gz is {SCRIPT} of the npm package {found['name']} {found['version']}, compressed and otherwise as "
        f"published.\nCopyright Plotly, Inc., licensed under the MIT license (LICENSE). Packed by "
        "tools/plotly_bundle.py.\n"
    )


def _member(archive: tarfile.TarFile, name: str) -> bytes:
    file = archive.extractfile(f"package/{name}")
    if file is None:
        raise SystemExit(f"{sys.argv[1]} holds no package/{name}: pack plotly.js-gl3d-dist-min")
    return file.read()


if __name__ == "__main__":
    main()
