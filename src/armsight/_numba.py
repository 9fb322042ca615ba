"""How all kernels are compiled: nothing else in the package names numba's njit.

error_model numpy: a division by zero gives inf or NaN, which callers test for, in place of a branch that raises: exact
data must never raise from within compiled code, and the branches cost half of the time to compile. cache: compiled
once per machine. nogil: threads may run beside each other.

A kernel that Python calls is a `kernel`. One that only other kernels call is an `inner_kernel`, which costs the
compiler much less: see InnerKernel and decision 0017.
"""

from __future__ import annotations

import gc
from collections.abc import Callable
from types import FunctionType
from typing import Any
from weakref import WeakKeyDictionary

from llvmlite.binding import ffi  # type: ignore[import-untyped]
from numba import njit, prange, types
from numba.core import base, compiler, errors, event
from numba.core.codegen import JITCodeLibrary
from numba.core.cpu_options import FastMathOptions
from numba.core.dispatcher import _FunctionCompiler  # type: ignore[attr-defined]
from numba.core.postproc import PostProcessor, VariableLifetime
from numba.core.registry import CPUDispatcher
from numba.core.targetconfig import ConfigStack
from numba.core.transforms import canonicalize_cfg
from numba.core.types.functions import BaseFunction
from numba.core.typing import context, templates

from armsight._kernel_cache import keep

RULES: Any = {"nogil": True, "error_model": "numpy", "_nrt": True, "no_cfunc_wrapper": True}
EXACT: Any = {"fastmath": False}
"""These and _nrt are said and not left out: numba lets a function inherit the rules of the one that it is first
compiled for, so that the last digits would hang on which kernel comes first."""
FUSED: Any = {"contract"}
REORDERED: Any = {"contract", "reassoc", "nsz"}
DEFAULTS: dict[str, Any] = compiler.Flags().values()


class _BitcodeLibrary(JITCodeLibrary):
    """A kernel's bitcode for its callers, with no machine code of its own.

    numba optimises a callee, makes machine code of it, then links its bitcode into every caller and does it all once
    more there: here it is left to the callers.
    """

    def _optimize_final_module(self) -> None:
        """Leave it to the callers."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _Flags(compiler.Flags):
    """As numba's own, compared quickly: that is asked a hundred thousand times, option by option."""

    def values(self) -> dict[str, Any]:
        """Return all options with their values."""
        return DEFAULTS | self._values


class _InnerCompiler(_FunctionCompiler):  # type: ignore[misc]
    """As numba's own, into a _BitcodeLibrary and without the wrappers for Python and C."""

    def _compile_core(self, args: Any, return_type: Any) -> Any:
        flags: Any = _Flags()
        self.targetdescr.options.parse_as_flags(flags, self.targetoptions)
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        context = self.targetdescr.target_context
        library = _BitcodeLibrary(context.codegen(), self.py_func.__qualname__)
        result = compiler.compile_extra(
            self.targetdescr.typing_context,
            context,
            self.py_func,
            args=args,
            return_type=return_type,
            flags=flags,
            locals=self.locals,
            library=library,
            pipeline_class=self.pipeline_class,
        )
        if result.typing_error is not None:
            raise result.typing_error
        if not (flags.nrt or self.py_func.__module__.startswith("numba.")):
            _require_no_arrays(result)
        key = object()  # what callers find the function by, where numba has the wrapper for Python
        context.insert_user_function(key, result.fndesc, [library])
        return result._replace(entry_point=key)


def _require_no_arrays(result: Any) -> None:
    """Raise where a kernel that counts no references returns an array, or calls a kernel that does: it would leak."""
    types_of, calls = result.type_annotation.typemap, result.type_annotation.calltypes
    returned = [result.signature.return_type]
    for call, signature in calls.items():
        if getattr(call, "op", "") == "call" and isinstance(types_of[call.func.name], types.Dispatcher):
            returned.append(signature.return_type)
    if any(map(_holds_array, returned)):
        raise errors.NumbaTypeError(
            f"{result.fndesc.qualname} counts no references: it may return no array, nor call what does"
        )


def _holds_array(kind: Any) -> bool:
    return isinstance(kind, types.Array) or any(map(_holds_array, getattr(kind, "types", ())))


_called: Any = None  # what each copy of the following calls: an inner kernel


def _call(*args: Any) -> Any:
    return _called(*args)


class InnerKernel(CPUDispatcher):
    """A kernel for other kernels: not cached, as its callers are, with all that they call.

    From Python (tests do) it is called through a kernel made for the purpose, kept as all are. It may not call itself.
    """

    def __init__(self, py_func: Callable[..., Any], targetoptions: dict[str, Any]) -> None:
        super().__init__(py_func, None, targetoptions)
        self._compiler = _InnerCompiler(py_func, self.targetdescr, targetoptions, self.locals, compiler.Compiler)
        self._from_python: Callable[..., Any] | None = None

    def add_overload(self, cres: Any) -> None:
        """Keep a compiled signature; unlike numba's own, out of Python's reach."""
        self.overloads[tuple(cres.signature.args)] = cres

    def __call__(self, *args: Any) -> Any:
        """Call it from Python."""
        if self._from_python is None:  # a global: what a closure holds numba would look a kept one up by
            space = {"__name__": self.py_func.__module__, "_called": self}
            caller = FunctionType(_call.__code__, space, self.py_func.__name__)
            caller.__qualname__ = f"{self.py_func.__module__}.{self.py_func.__qualname__}"
            self._from_python = keep(njit(caller, **EXACT, **RULES))
        return self._from_python(*args)


def _decorator(template: Any) -> Callable[..., Any]:
    """Return what makes a dispatcher of a function by which numba implements one of its own, as an inner kernel."""

    def decorate(**options: Any) -> Any:
        if not PLAIN.issuperset(options):
            return NUMBAS_DECORATOR(template)(**options)
        return lambda function: InnerKernel(function, {"nopython": True, **options})

    return decorate


def _typed(function: Any, contexts: Any, args: Any, kws: Any) -> Any:
    """Return the signature of a call of one of numba's functions, as numba finds it, each only once.

    numba asks for it anew at each call in each kernel, and twice: it tries ten candidates for the sum of two numbers.
    With it belongs what implements it, by the rules of the kernel that calls.
    """
    flags = ConfigStack.top_or_none()
    rules = None if flags is None else _rules(flags)
    if rules is None or not all(one.is_precise() for one in (*args, *kws.values())):
        return NUMBAS_TYPING(function, contexts, args, kws)
    known = KNOWN.setdefault(function, {})
    key = contexts, rules, tuple(args), tuple(kws.items())
    if key not in known:
        signature = NUMBAS_TYPING(function, contexts, args, kws)
        known[key] = signature, function.get_impl_key(signature)
    signature, implementation = known[key]
    function._impl_keys[signature.args] = implementation
    return signature


def _rules(flags: Any) -> frozenset[Any] | None:
    """Return the options that are set, to be compared quickly; None where one is of a kind that cannot be."""
    found = set[Any]()
    for name, value in flags._values.items():
        if isinstance(value, FastMathOptions):
            found.add((name, frozenset(value.flags)))
        elif isinstance(value, bool | str):
            found.add((name, value))
        elif value != DEFAULTS[name]:
            return None
    return frozenset(found)


def _processed(post: PostProcessor, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:
    """Renew what is known of a function's variables, as numba does; which live where is found only when asked for.

    numba finds it nine times for each function: only generators and its code for Python's objects need that.
    """
    function: Any = post.func_ir
    if function.is_generator:
        NUMBAS_PROCESSING(post, emit_dels, extend_lifetimes)
        return
    function.blocks = canonicalize_cfg(function.blocks)
    function.variable_lifetime, function.generator_info = VariableLifetime(function.blocks), None
    if emit_dels:
        post._insert_var_dels(extend_lifetimes)


def _refreshed(context: Any) -> None:
    """Take over new declarations, as numba does, where there are any: it looks fifteen times for each function."""
    declared = sum(len(part) for registry in context._registries for part in vars(registry).values())
    if DECLARED.get(context) != declared:
        NUMBAS_REFRESHING[isinstance(context, base.BaseContext)](context)
        DECLARED[context] = declared


KNOWN = WeakKeyDictionary[Any, dict[Any, tuple[Any, Any]]]()
DECLARED = WeakKeyDictionary[Any, int]()  # by context
PLAIN = frozenset({"nopython", "no_cpython_wrapper", "no_cfunc_wrapper", "fastmath", "forceobj", "boundscheck"})
OVERLOADS: Any = templates._OverloadFunctionTemplate
NUMBAS_DECORATOR: Any = OVERLOADS._get_jit_decorator
NUMBAS_TYPING: Any = BaseFunction.get_call_type
NUMBAS_PROCESSING: Any = PostProcessor.run
NUMBAS_REFRESHING: Any = context.BaseContext.refresh, base.BaseContext.refresh
QUICK: tuple[tuple[Any, str, Any], ...] = (
    (OVERLOADS, "_get_jit_decorator", _decorator),
    (BaseFunction, "get_call_type", _typed),
    (PostProcessor, "run", _processed),
    (context.BaseContext, "refresh", _refreshed),
    (base.BaseContext, "refresh", _refreshed),
    (ffi.lib._lock, "_cblist", []),  # at each call of LLVM numba starts and stops a timer, which has no reader here
)
"""Parts of numba, and what stands for them while kernels are compiled."""
NUMBAS = tuple((owner, name, getattr(owner, name)) for owner, name, _ in QUICK)


class _Quickly(event.Listener):
    """While a kernel is compiled numba does the same with less work.

    The compiler makes millions of small objects that live until it ends: looking for garbage costs a tenth of it.
    """

    def __init__(self) -> None:
        self.depth = 0
        self.was_on = False

    def on_start(self, _: event.Event) -> None:
        if self.depth == 0:
            self.was_on = gc.isenabled()
            gc.disable()
            self._set(QUICK)
        self.depth += 1

    def on_end(self, _: event.Event) -> None:
        self.depth -= 1
        if self.depth == 0:
            self._set(NUMBAS)
            if self.was_on:
                gc.enable()

    def _set(self, parts: tuple[tuple[Any, str, Any], ...]) -> None:
        for owner, name, part in parts:
            setattr(owner, name, part)


event.register("numba:compile", _Quickly())  # called with the compiler's lock held


def _kept(**options: Any) -> Callable[[Callable[..., Any]], CPUDispatcher]:
    return lambda function: keep(njit(function, **RULES, **options))


def _inner(**options: Any) -> Callable[[Callable[..., Any]], InnerKernel]:
    return lambda function: InnerKernel(function, {"nopython": True, **EXACT, **RULES, **options})


kernel = _kept(**EXACT)
"""For everything: results are the same on every machine with the same numba."""

fast_kernel = _kept(fastmath=FUSED)
"""Products and sums may be fused: for the hottest paths, where the last digit does not matter."""

sum_kernel = _kept(fastmath=REORDERED)
"""Sums may also be reordered into vector lanes: for sums over pixels and residuals."""

inner_kernel = _inner()
"""A kernel that only kernels call."""

inner_fast_kernel = _inner(fastmath=FUSED)
"""A fast_kernel that only kernels call."""

inner_sum_kernel = _inner(fastmath=REORDERED)
"""A sum_kernel that only kernels call."""

inline_kernel = _inner(forceinline=True)
"""Put into its callers whole, by LLVM: for the innermost loop, where LLVM by itself would rather call."""

inline_sum_kernel = _inner(forceinline=True, fastmath=REORDERED)
"""An inline_kernel whose sums may be reordered with those of the sum_kernel that it is put into."""

lean_kernel = _inner(_nrt=False)
"""An inner_kernel that counts no references: the caller's arrays outlive it.

Counting is two atomic steps for each row of an array and each array of a NamedTuple that is taken out: a third of the
time of a fit of a light, half of that of a cast ray. It may neither make nor return an array, nor call what returns
one.
"""

lean_sum_kernel = _inner(_nrt=False, fastmath=REORDERED)
"""A sum_kernel that only kernels call, and that counts no references."""

borrowing_kernel = _inner(forceinline=True, _nrt=False)
"""A lean_kernel put into its callers whole."""

parallel_kernel = _kept(parallel=True, **EXACT)
"""Runs on all cores, with prange."""

__all__ = [
    "InnerKernel",
    "borrowing_kernel",
    "fast_kernel",
    "inline_kernel",
    "inline_sum_kernel",
    "inner_fast_kernel",
    "inner_kernel",
    "inner_sum_kernel",
    "kernel",
    "lean_kernel",
    "lean_sum_kernel",
    "parallel_kernel",
    "prange",
    "sum_kernel",
]
