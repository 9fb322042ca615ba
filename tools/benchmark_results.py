"""Keeps what benchmarks print as data, and makes the page of all tables from it.

    python benchmarks/pose.py | tee pose.txt
    python tools/benchmark_results.py pose pose.txt

writes benchmarks/results/pose.yaml: for each run its command, date, machine and commit, and its tables as CSV. Earlier
figures of the same benchmark go; git keeps them. `make docs` makes the page; docs/benchmarks.md has the headlines, and
begins with the table of `summary`, which is written into it as well.
"""

from __future__ import annotations

import argparse
import csv
import io
import re
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

HOME = Path(__file__).resolve().parent.parent
RESULTS = HOME / "benchmarks" / "results"
HEADLINES = HOME / "docs" / "benchmarks.md"
SUMMARY = re.compile(r"(?<=<!-- summary -->\n).*?(?=<!-- end of summary -->)", re.S)
MACHINE = re.compile(r"(\d{4}-\d\d-\d\d), ([^\n;]*)")
HEAD = """\
# Tables of benchmarks

What the benchmarks printed last, ours and the peers' side by side. [Benchmarks](benchmarks.md) has the headlines, and
says how to read them. The data are `benchmarks/results/*.yaml`.
"""


def main() -> None:
    """Write the data file of one benchmark from what it printed."""
    parser = argparse.ArgumentParser(description="Keep the tables that a benchmark printed.")
    parser.add_argument("name", help="benchmark: the script's name without .py")
    parser.add_argument("printed", type=Path, help="file with what it printed")
    parser.add_argument("--options", default="", help="the options that it was run with")
    given = parser.parse_args()
    text = given.printed.read_text(encoding="utf-8")
    commit = subprocess.run(
        ["git", "rev-parse", "--short=8", "HEAD"], cwd=HOME, capture_output=True, text=True, check=True
    ).stdout.strip()
    command = f"python benchmarks/{given.name}.py {given.options}".strip()
    (RESULTS / f"{given.name}.yaml").write_text(dumped(command, text, commit), encoding="utf-8")
    HEADLINES.write_text(with_summary(HEADLINES.read_text(encoding="utf-8")), encoding="utf-8")


def dumped(command: str, printed: str, commit: str) -> str:
    """Return the data file's content. Raises SystemExit where no date and machine or no table was printed."""
    when, tables = MACHINE.search(printed), list(printed_tables(printed))
    if when is None or not tables:
        raise SystemExit("no line with date and machine, or no table, was printed: benchmarks/bench.py prints both")
    run = {"command": command, "date": when[1], "machine": when[2], "commit": commit}
    listed = [{"title": title, "rows": as_csv(rows)} for title, rows in tables]
    return yaml.dump({"runs": [{**run, "tables": listed}]}, Dumper=Literal, sort_keys=False, allow_unicode=True)


class Literal(yaml.SafeDumper):
    """Writes text of several lines line by line."""


Literal.add_representer(
    str, lambda to, text: to.represent_scalar("tag:yaml.org,2002:str", text, style="|" if "\n" in text else None)
)


def printed_tables(text: str) -> Iterator[tuple[str, list[list[str]]]]:
    """Yield the title and the rows, header first, of each Markdown table."""
    title, rows = "", list[list[str]]()
    for line in [*text.splitlines(), ""]:
        if line.startswith("|"):
            rows.append([cell.strip() for cell in line.strip().strip("|").split("|")])
            continue
        if rows:
            yield title, [rows[0], *rows[2:]]
            rows = []
        title = line.lstrip("# ") if line.startswith("#") else title


def as_csv(rows: Sequence[Sequence[str]]) -> str:
    """Return the rows as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def results() -> dict[str, Mapping[str, Any]]:
    """Return the content of every data file by the benchmark's name."""
    files = sorted(RESULTS.glob("*.yaml"))
    return {path.stem: yaml.safe_load(path.read_text(encoding="utf-8")) for path in files}


def page() -> str:
    """Return the page with every table."""
    parts = [HEAD]
    for name, content in results().items():
        parts.append(f"\n## {name}\n")
        for run in content["runs"]:
            parts.append(f"`{run['command']}`, {run['date']}, {run['machine']}, commit {run['commit']}\n")
            parts += [f"{one['title']}\n\n{markdown(one['rows'])}\n" for one in run["tables"]]
        parts += [f"{note}\n" for note in content.get("notes", ())]
    return "\n".join(parts)


def with_summary(page: str) -> str:
    """Return the page of headlines with the table of `summary` as it was printed last."""
    (run,) = results()["summary"]["runs"]
    text = f"\n{run['date']}, {run['machine']}:\n\n{markdown(run['tables'][0]['rows'])}\n\n"
    return SUMMARY.sub(lambda _: text, page)


def markdown(rows: str) -> str:
    """Return CSV as a Markdown table."""
    head, *body = csv.reader(io.StringIO(rows))
    lines = [head, ["---"] * len(head), *body]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


if __name__ == "__main__":
    main()
