"""Pages of the documentation that are made from the project itself: start, examples, reference, JSON keys."""

from __future__ import annotations

import ast
import runpy
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parent.parent


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    pages = {
        "index.md": start_page(),
        "examples/index.md": examples_page(),
        "reference/index.md": reference_page(),
        "json.md": json_page(),
    }
    for name, content in pages.items():
        files.append(File.generated(config, name, content=content))
    return files


def json_page() -> str:
    """Return the table of keys of every command's JSON object."""
    text = runpy.run_path(str(ROOT / "tools" / "json_schemas.py"))["page"]()
    return str(text)


def start_page() -> str:
    """Return the README with its links turned from the project's root to the pages' folder."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return (
        text.replace("](docs/", "](")
        .replace('src="docs/', 'src="')
        .replace("](examples/01_find_spots.py)", "](examples/index.md)")
    )


def examples_page() -> str:
    """Return all examples, each under its own first sentence."""
    parts = ["# Examples", "", "Each runs as it stands, on simulated data, and is one of the project's tests."]
    for path in sorted((ROOT / "examples").glob("*.py")):
        source = path.read_text(encoding="utf-8")
        told = ast.get_docstring(ast.parse(source)) or path.stem
        title, _, rest = told.partition("\n")
        code = source[source.index('"""', source.index('"""') + 3) + 3 :].strip()
        parts += [
            "",
            f"## {title.rstrip('.')}",
            "",
            rest.strip(),
            "",
            f"`examples/{path.name}`",
            "",
            f"```python\n{code}\n```",
        ]
    return "\n".join(parts) + "\n"


def reference_page() -> str:
    """Return every public name by the module it comes from, in the order of the package's own list."""
    parts = [
        "# Python reference",
        "",
        "Everything public is reached as `armsight.NAME`. Arrays go in, records come out; lengths are in metres,",
        "angles in radians, pixels count from the centre of the top-left one, `T_a_b` is the pose of b in a.",
    ]
    for module, names in public_names().items():
        if module.startswith("armsight._"):
            continue  # the version
        parts += ["", f"## {HEADINGS[module]}"]
        parts += [line for name in names for line in ("", f"::: {module}.{name}")]
    return "\n".join(parts) + "\n"


def public_names() -> dict[str, tuple[str, ...]]:
    """Return the package's own table of public names, by module."""
    tree = ast.parse((ROOT / "src" / "armsight" / "__init__.py").read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == "_MODULES" and node.value is not None:
            table: dict[str, tuple[str, ...]] = ast.literal_eval(node.value)
            return table
    raise LookupError("src/armsight/__init__.py has no table _MODULES")


HEADINGS = {
    "armsight.api.pose": "Spots and poses",
    "armsight.api.cell": "Calibrating a whole cell",
    "armsight.api.tracks": "Tracks",
    "armsight.api.cameras": "Cameras and rigs",
    "armsight.api.runs": "Measure, record, verify, compare, join",
    "armsight_lab.api.batch": "Many runs",
    "armsight_lab.api.design": "Rigs planned",
    "armsight.api.light": "Targets, timing, noise, zoom, mirrors",
    "armsight.api.hand_eye": "Hand-eye",
    "armsight.api.tool_tip": "Tool tip",
    "armsight.api.robots": "Arms calibrated, rigs placed",
    "armsight.api.identify": "Arms identified",
    "armsight.api.motion": "Servo, teach, play",
    "armsight.api.links": "Links to robots",
    "armsight.api.watch": "Robots watched",
    "armsight.api.machine": "Machine and papers",
    "armsight.api": "Paths",
    "armsight_lab.api": "Histories",
    "armsight.calibrate.cameras": "Options of calibrations",
    "armsight.control.guard": "Limits of the guard",
    "armsight.drivers": "Drivers",
    "armsight.store": "Places",
    "armsight.store.foreign": "Frames of TF",
    "armsight.store.interpret": "Foreign tables",
    "armsight.store.recording": "Recordings",
    "armsight.api.files": "Files",
    "armsight.api.convert": "Files of other programs, recordings",
    "armsight.api.remote": "Robots over a network",
    "armsight.api.simulation": "Simulation",
    "armsight.measure.settings": "Settings",
    "armsight.kinematics": "Arms",
    "armsight.optics": "Cameras, rigs and triangulation",
    "armsight.records": "Records",
    "armsight.errors": "Errors",
}
