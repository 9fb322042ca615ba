"""Where compiled kernels are kept, and what they are known by: the text of all that was compiled into them.

numba looks only at the file of the kernel itself. Kernels here call kernels of other files, whose machine code goes
into the caller's: after an update in place it would go on computing by their old text.
"""

from __future__ import annotations

import functools
import hashlib
import math
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import llvmlite  # type: ignore[import-untyped]
import numba
import numpy as np
from numba.core.caching import FunctionCache
from numba.core.registry import CPUDispatcher

Function = Callable[..., Any]

BESIDE = tuple(Path(__file__).with_name(name) for name in ("_numba.py", "_kernel_cache.py"))
"""Files that say how every kernel is compiled."""


class KernelCache(FunctionCache):
    """numba's cache of one kernel's machine code, keyed by the text of all kernels in it and by the compiler.

    numba itself adds version, processor and types. Raises RuntimeError where no folder can be written.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what is kept for a signature; None where nothing is, or where it is of another text."""
        self._cache_file._source_stamp = stamp(self._py_func)  # when it is first called all that it calls is imported
        return super().load_overload(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled; a disk that has become full or closed meanwhile costs the next start some time."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            _warn_once(str(error.strerror or error))


def keep(dispatcher: CPUDispatcher) -> CPUDispatcher:
    """Let a kernel's machine code be kept from process to process, where there is a folder for it."""
    try:
        dispatcher._cache = KernelCache(dispatcher.py_func)  # type: ignore[attr-defined]
    except RuntimeError:  # numba found no folder that can be written
        _warn_once("no folder can be written")
    return dispatcher


def stamp(function: Function) -> str:
    """Return a digest of the text of a kernel and of all that is compiled into it, and of the compiler's versions."""
    parts = {f"numba {numba.__version__}, llvmlite {llvmlite.__version__}", *map(_text_of, BESIDE), *_parts(function)}
    return hashlib.sha256("\n".join(sorted(parts)).encode()).hexdigest()


@functools.cache
def _parts(function: Function) -> frozenset[str]:
    """Return digests of the files and values that a kernel is compiled from: its own and those of all that it calls."""
    parts = {_text_of(Path(function.__code__.co_filename))}
    for name, value in _named(function):
        match value:
            case CPUDispatcher() if value.py_func is not function:
                parts |= _parts(value.py_func)
            case type() if hasattr(value, "_fields"):
                parts.add(f"{name}: {value._fields}")
            case bool() | int() | float() | complex() | str() | tuple():
                parts.add(f"{name} = {value!r}")
            case np.ndarray():
                parts.add(f"{name} = {value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}")
    return frozenset(parts)


def _named(function: Function) -> Iterator[tuple[str, Any]]:
    """Yield names and values that a kernel's code refers to beyond its own."""
    codes = [function.__code__]
    for code in codes:
        codes += [part for part in code.co_consts if isinstance(part, CodeType)]
        known = function.__globals__
        named = [known[name] for name in code.co_names if name in known]
        modules = [value for value in named if isinstance(value, ModuleType) and value not in (math, np)]
        for space in (known, *map(vars, modules)):  # a name behind a module's is among the code's names as well
            yield from ((name, space[name]) for name in code.co_names if name in space)
    closure = function.__closure__ or ()
    yield from zip(function.__code__.co_freevars, (cell.cell_contents for cell in closure), strict=True)


@functools.cache
def _text_of(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


@functools.cache
def _warn_once(why: str) -> None:
    """Warn that nothing is kept; once for each reason."""
    warnings.warn(
        f"compiled kernels cannot be kept: {why}. Every start compiles them anew, which takes seconds to minutes. "
        "Set the environment variable NUMBA_CACHE_DIR to a folder that can be written",
        stacklevel=2,
    )
