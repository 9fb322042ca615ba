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
from llvmlite import binding
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import compile_result
from numba.core.registry import CPUDispatcher
from numba.core.runtime import _nrt_python  # type: ignore[attr-defined]

Function = Callable[..., Any]

BESIDE = tuple(Path(__file__).with_name(name) for name in ("_numba.py", "_kernel_cache.py"))
"""Files that say how every kernel is compiled."""


class _KeptLibrary(JITCodeLibrary):
    """Machine code as it was kept; the bitcode that kernels compile into theirs is read when one asks for it.

    numba reads it at every start, and asks each of its symbols by itself whether it is defined there.
    """

    def __init__(self, codegen: Any, name: str, code: bytes, bitcode: bytes, symbols: frozenset[str]) -> None:
        super().__init__(codegen, name)
        self._bitcode = bitcode
        self.enable_object_caching()
        self._set_compiled_object(code)
        self._finalize_final_module()
        codegen._engine._defined_symbols |= symbols

    def _get_module_for_linking(self) -> Any:
        if self._shared_module is None:
            self._shared_module = binding.parse_bitcode(self._bitcode)
        return self._shared_module


class _Kept(CompileResultCacheImpl):
    """What is kept of a compiled kernel, and how it is made of that again."""

    def reduce(self, cres: Any) -> Any:
        """Return what to keep: numba's own, the defined symbols, and of the environments those that hold something."""
        *kept, environments = cres._reduce()
        module = cres.library._get_module_for_linking()
        symbols = frozenset(
            one.name for part in (module.functions, module.global_variables) for one in part if not one.is_declaration
        )
        return *kept, tuple(one for one in environments if one.consts), symbols

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        """Return the compiled kernel."""
        (name, _, (code, bitcode)), fndesc, own, signature, objectmode, lifted, annotation, loaders, *more = payload
        environments, symbols = more
        for load in loaders:
            load()
        typing_context = target_context.typing_context
        library = _KeptLibrary(target_context.codegen(), name, code, bitcode, symbols)
        entry_point = target_context.get_executable(library, fndesc, own)
        for one in environments:
            library.codegen.set_env(one.env_name, one)
        return compile_result(
            typing_context=typing_context,
            target_context=target_context,
            entry_point=entry_point,
            type_annotation=annotation,
            signature=signature,
            objectmode=objectmode,
            lifted=lifted,
            fndesc=fndesc,
            library=library,
            environment=own,
            reload_init=loaders,
            referenced_envs=environments,
        )


class KernelCache(FunctionCache):
    """numba's cache of one kernel's machine code, keyed by the text of all kernels in it and by the compiler.

    numba itself adds version, processor and types. It would look for a folder when the kernel is declared, which few
    of those imported are called after, and import and register all that it can compile before it loads one.
    """

    _impl_class = _Kept

    def __init__(self, py_func: Function) -> None:
        self._py_func = py_func

    @functools.cached_property
    def _is_open(self) -> bool:
        """Whether there is a folder for it."""
        try:
            super().__init__(self._py_func)
        except RuntimeError:  # numba found none that can be written
            _warn_once("no folder can be written")
            return False
        return True

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what is kept for a signature; None where nothing is, or where it is of another text."""
        if not self._is_open:
            return None
        self._cache_file._source_stamp = stamp(self._py_func)  # when it is first called all that it calls is imported
        _name_runtime()
        return self._load_overload(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled; a disk that has become full or closed meanwhile costs the next start some time."""
        if not self._is_open:
            return
        try:
            super().save_overload(sig, data)
        except OSError as error:
            _warn_once(str(error.strerror or error))


def keep(dispatcher: CPUDispatcher) -> CPUDispatcher:
    """Let a kernel's machine code be kept from process to process, where there is a folder for it."""
    made: Any = dispatcher
    made._cache = KernelCache(dispatcher.py_func)
    made._compilation_chain_init_hook = bool  # numba looks for extensions among all that is installed, for 30 ms
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
def _name_runtime() -> None:
    """Give the functions of numba's runtime the names that machine code calls them by."""
    for name, address in _nrt_python.c_helpers.items():
        binding.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


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
