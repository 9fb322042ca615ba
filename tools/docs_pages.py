"""Pages of the documentation that are made: start, examples, reference, JSON keys, flags, tables of benchmarks."""

from __future__ import annotations

import ast
import csv
import runpy
from importlib import import_module
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

import armsight

ROOT = Path(__file__).resolve().parent.parent


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    pages = {
        "index.md": start_page(),
        "examples/index.md": examples_page(),
        "reference/index.md": reference_page(),
        "json.md": made_by("json_schemas"),
        "python-flags.md": made_by("python_flags"),
        "protocol-messages.md": made_by("protocol_messages"),
        "benchmark-tables.md": made_by("benchmark_results"),
        **{name: f"{head}\n{csv_table(ROOT / rows)}\n" for name, (head, rows) in TABLES.items()},
    }
    for name, content in pages.items():
        files.append(File.generated(config, name, content=content))
    return files


def on_post_build(config: MkDocsConfig) -> None:
    """Refuse a reference that lacks a public name, and pages that need a network."""
    pages = {path: path.read_text(encoding="utf-8") for path in Path(config.site_dir).rglob("*.html")}
    reference = pages[Path(config.site_dir) / "reference" / "index.html"]
    missing = [
        name
        for name, module in armsight._places().items()
        if not module.startswith("armsight._")
        if f'id="{module}.{name}"' not in reference and f">{name}<" not in reference
    ]
    outside = [path.name for path, text in pages.items() if 'src="https://' in text]
    if missing or outside:
        raise PluginError(f"the reference lacks {missing}; a network is needed by {outside}")


def made_by(tool: str) -> str:
    """Return the page that a tool of this folder makes."""
    return str(runpy.run_path(str(ROOT / "tools" / f"{tool}.py"))["page"]())


def csv_table(path: Path) -> str:
    """Return a CSV file as a Markdown table."""
    with path.open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows))


TABLES = {
    "security-roles.md": (
        """\
# Who may say what

Every message of every socket and every route, sent by each kind of caller: without a token; on a connection whose token
was removed since; by a watcher; by a watcher, and by another driver, in the names of the driver (page, session, key);
by the driver. Three words: before anybody drives / while the driver drives / after a stop. `beat: key` is a held jog
key; *ignored* is an event of an element that a watcher's page does not have; *let go* is the enable's end.
`tests/security/test_roles.py` plays each cell against a server. See [security](security.md#who-may-say-what).
""",
        "tests/security/roles.csv",
    ),
    "security-tests.md": (
        """\
# What was tried against it

Attacks, their tests and what became of them; the tests are in `tests/security`. See [security](security.md).
""",
        "tests/security/tried.csv",
    ),
    "strangers.md": (
        """\
# Strangers' cases

Public reports, questions and file forms of this field, rebuilt as small inputs of our own: what the person had, what is
right and how it is known, and what comes now. `tests/golden/reports` runs them; the inputs lie beside the repository
(`../shared/data/reports`). Sources are given as project and number.
""",
        "tests/golden/reports/cases.csv",
    ),
}
"""Page -> its text and the table below it."""


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
    """Return every public name by the module it comes from."""
    parts = [
        "# Python reference",
        "",
        "Everything public is reached as `armsight.NAME`. Arrays go in, records come out; lengths are in metres,",
        "angles in radians, pixels count from the centre of the top-left one, `T_a_b` is the pose of b in a.",
    ]
    for module, names in public_names().items():
        if module.startswith("armsight._"):
            continue  # the version
        parts += ["", f"## {HEADINGS.get(module) or str(import_module(module).__doc__).partition('.')[0]}"]
        parts += [line for name in names for line in ("", f"::: {module}.{name}")]
    return "\n".join(parts) + "\n"


def public_names() -> dict[str, tuple[str, ...]]:
    """Return the public names by module, in the order of HEADINGS."""
    found: dict[str, tuple[str, ...]] = dict.fromkeys(HEADINGS, ())
    for name, module in armsight._places().items():
        found[module] = (*found.get(module, ()), name)
    return found


HEADINGS = {
    "armsight.api.pose": "Spots and poses",
    "armsight.ops.calibrate_cell": "Calibrating a whole cell",
    "armsight.measure.track": "Tracks",
    "armsight.ops.verify": "Verify",
    "armsight.ops.mastering": "After a crash",
    "armsight.verify.results": "What verify returns",
    "armsight.ops.measure": "Measure, record",
    "armsight.measure.results": "What measure returns",
    "armsight.ops.files": "Compare, join",
    "armsight.ops.join": "What join returns",
    "armsight_lab.api.batch": "Many runs",
    "armsight_lab.api.design": "Rigs planned",
    "armsight.ops.calibrate_hand_eye": "Hand-eye",
    "armsight.ops.calibrate_robot": "Arms calibrated, rigs placed, tool tips",
    "armsight.ops.kinematics": "Arms drawn and written",
    "armsight.ops.calibrate_cameras": "Cameras calibrated, rigs with zoom",
    "armsight.ops.calibrate_mirrors": "Mirrors",
    "armsight.ops.calibrate_rig": "Noise, targets, timing",
    "armsight.calibrate.cameras.zoom": "A zoom rig's result",
    "armsight.calibrate.light_target": "A target's result",
    "armsight.calibrate.cell": "A cell's result",
    "armsight.calibrate.handeye": "A hand-eye result",
    "armsight.calibrate.timing": "A timing's result",
    "armsight.calibrate.tooltip_result": "A tool tip's result",
    "armsight.calibrate.arm": "Results of arms and placed rigs",
    "armsight.calibrate.camera_noise.photon_transfer": "A noise's result",
    "armsight.ops.identify": "Arms identified",
    "armsight.calibrate.identify": "An identification's result",
    "armsight.ops.motion": "Servo, play",
    "armsight.ops.teach": "Teach",
    "armsight.ops.teaching": "What teach returns",
    "armsight.ops.robots": "Links to robots",
    "armsight.ops.machine": "Machine, simulations as files, papers",
    "armsight.ops": "Paths",
    "armsight_lab.api": "Histories",
    "armsight.calibrate.cameras": "Options of calibrations",
    "armsight.control.guard": "Limits of the guard",
    "armsight.drivers": "Drivers",
    "armsight.store": "Places",
    "armsight.store.foreign": "Frames of TF",
    "armsight.store.interpret": "Foreign tables",
    "armsight.store.recording": "Recordings",
    "armsight.api.files": "Files, recordings",
    "armsight.ops.convert": "Files of other programs",
    "armsight.api.remote": "Robots over a network",
    "armsight.api.simulation": "Simulation",
    "armsight.measure.settings": "Settings",
    "armsight.kinematics": "Arms",
    "armsight.optics": "Cameras, rigs and triangulation",
    "armsight.records": "Records",
    "armsight.errors": "Errors",
}
