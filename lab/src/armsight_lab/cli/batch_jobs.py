"""The jobs that a person asks for: of a file with a row for each, or of a command for each file that fits a pattern."""

from __future__ import annotations

import glob
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from armsight.drivers.images import natural_key
from armsight.errors import BadFile, NotEnoughData, UsageError
from armsight_lab.batch.job_files import JobRow, close_to, read_jobs
from armsight_lab.batch.jobs import Job
from armsight_lab.cli.batch_commands import checked_job, commands_of, parameters

YES, NO = ("true", "yes", "1"), ("false", "no", "0")
PLACEHOLDERS = ("path", "name", "parent", "number")
_PLACEHOLDER = re.compile(r"\{([a-z_]*)\}")


def jobs_of_file(path: Path, settings: dict[str, object]) -> list[Job]:
    """Return the jobs that a file lists. Raises BadFile, UsageError, naming row and key."""
    return [_job_of_row(row, settings) for row in read_jobs(path)]


def jobs_of_pattern(pattern: str, name: str, words: Sequence[str], settings: dict[str, object]) -> list[Job]:
    """Return a job of the words for each file or folder that fits the pattern, in natural order.

    In words and name, {} and {path} stand for its path, {name} for its name without ending, {parent} for its folder's
    name, {number} for its place, from 1. Raises NotEnoughData where nothing fits, UsageError.
    """
    found = sorted(glob.glob(pattern, recursive=True), key=natural_key)  # noqa: PTH207  absolute patterns as well
    if not found:
        raise NotEnoughData(
            f"nothing fits the pattern {pattern}",
            consequence="There is no job to do",
            cure="Check the folder, and put the pattern in quotes, or the shell fills it in",
        )
    command, rest = commands_of(words, "the command")
    _check_placeholders([name, *rest])
    if len(found) > 1 and not any(_PLACEHOLDER.search(word) for word in rest):
        raise UsageError(
            f"the command names none of the {len(found)} files, so each job would do the same",
            consequence="No job is begun",
            cure="Write {} where the file's path belongs, such as --left {}",
        )
    jobs = []
    for number, text in enumerate(found, 1):
        path = Path(text)
        values = {"": str(path), "path": str(path), "name": path.stem, "parent": path.absolute().parent.name}
        values["number"] = str(number)
        filled = [_filled(word, values) for word in (name, *rest)]
        jobs.append(checked_job(filled[0], command, filled[1:], settings, text))
    return jobs


def _filled(text: str, values: dict[str, str]) -> str:
    return _PLACEHOLDER.sub(lambda found: values[found[1]], text)


def _check_placeholders(texts: Sequence[str]) -> None:
    for text in texts:
        for unknown in [one for one in _PLACEHOLDER.findall(text) if one and one not in PLACEHOLDERS]:
            raise UsageError(
                f"{{{unknown}}} stands for nothing{close_to(unknown, PLACEHOLDERS)}",
                consequence="No job is begun",
                cure=f"Use {', '.join(f'{{{one}}}' for one in ('', *PLACEHOLDERS))}",
            )


def _job_of_row(row: JobRow, settings: dict[str, object]) -> Job:
    where = f"{row.where}, {row.name!r}"
    command, rest = commands_of(row.command.split(), where)
    known = parameters(command)
    flags, positional = list(rest), []
    for key, value in row.given.items():
        found = next((one for one in known if key.lstrip("-").replace("_", "-") in _names(one)), None)
        if found is None:
            names = [_names(one)[0] for one in known]
            raise BadFile(
                f"{where}: `{command}` has no {key[:60]!r}{close_to(key, names)}",
                consequence="No job is begun",
                cure=f"It takes {', '.join(names)}",
            )
        if found.param_type_name == "argument":
            positional += [str(one) for one in (value if isinstance(value, list) else [value])]
        else:
            flags += _words(found, value, f"{where}, {key}")
    words = [*flags, *(["--", *positional] if positional else [])]
    return checked_job(row.name, command, words, settings, where)


def _names(parameter: Any) -> list[str]:
    """Return what a key may be called: the flag without its dashes, or its name."""
    named = [one.lstrip("-") for one in (*parameter.opts, *parameter.secondary_opts) if one.startswith("--")]
    return list(dict.fromkeys([*named, parameter.name.replace("_", "-")]))


def _words(parameter: Any, value: object, where: str) -> Iterator[str]:
    """Yield a flag's words on the command line. Raises BadFile."""
    flag = max(parameter.opts, key=len)
    if parameter.is_flag:
        told = str(value).lower()
        if told not in (*YES, *NO):
            raise BadFile(f"{where}: {value!r} is neither true nor false", consequence="No job is begun")
        if told in YES:
            yield flag
        elif parameter.secondary_opts:
            yield parameter.secondary_opts[0]
        return
    if isinstance(value, bool):
        raise BadFile(f"{where}: it takes a value, not {str(value).lower()}", consequence="No job is begun")
    values = value if isinstance(value, list) else [value]
    if parameter.nargs != 1:
        yield from (flag, *map(str, values))
    elif len(values) > 1 and not parameter.multiple:
        raise BadFile(f"{where}: it takes one value, not a list", consequence="No job is begun")
    else:
        yield from (f"{flag}={one}" for one in values)
