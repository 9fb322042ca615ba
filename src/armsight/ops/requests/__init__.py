"""What each command is told: one frozen dataclass a request, from whose fields the command line makes its flags.

These modules import nothing that takes long, so that a command's help and a wrong flag are answered at once; what only
a type names is imported for type checkers alone. A module is loaded when its name is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from armsight.ops.requests import motion as motion
else:
    _MODULES = ("motion",)

    def __getattr__(name: str) -> object:
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return import_module(f"{__name__}.{name}")
