"""The options of live cameras, the same for every command that takes them."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from armsight.errors import UsageError

if TYPE_CHECKING:
    from armsight.drivers import CameraSettings

PANEL = "Live cameras (both the same)"


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraOptions:
    """What was given on the command line; None where nothing was."""

    exposure: float | None = None
    gain: float | None = None
    focus: float | None = None
    white_balance: float | None = None
    trigger: str | None = None
    pixel_format: str | None = None

    def settings(self, zoom: float | None = None) -> CameraSettings:
        """Return them as settings, with a zoom to set. Raises UsageError for a value that no camera can have."""
        from armsight.drivers import CameraSettings

        return CameraSettings(
            exposure_s=self.exposure,
            gain=self.gain,
            focus=self.focus,
            white_balance_k=self.white_balance,
            trigger=self.trigger,
            pixel_format=self.pixel_format,
            zoom=zoom,
        )

    def settings_by_side(self, zoom: tuple[float | None, float | None]) -> tuple[CameraSettings, CameraSettings]:
        """Return them with the zoom to set of the left and the right camera. Raises UsageError where there is none."""
        if zoom == (None, None):
            raise UsageError(
                "--set-zoom is given, and no zoom to set", cure="Give --zoom-left and --zoom-right, or one of them"
            )
        return self.settings(zoom[0]), self.settings(zoom[1])


NONE_GIVEN = CameraOptions()


def _option(flag: str, metavar: str, text: str) -> Any:
    return typer.Option(flag, metavar=metavar, help=text, rich_help_panel=PANEL)


OPTIONS: dict[str, Any] = {
    "exposure": Annotated[float | None, _option("--exposure", "S", "Lock the exposure, in s.")],
    "gain": Annotated[
        float | None, _option("--gain", "GAIN", "Lock the gain: in dB with GenICam, else in the driver's unit.")
    ],
    "focus": Annotated[float | None, _option("--focus", "VALUE", "Lock the focus, in the driver's unit.")],
    "white_balance": Annotated[float | None, _option("--white-balance", "K", "Lock the white balance, in kelvin.")],
    "trigger": Annotated[
        str | None, _option("--trigger", "LINE", "GenICam: expose at the edges of this input, such as Line1.")
    ],
    "pixel_format": Annotated[
        str | None, _option("--pixel-format", "NAME", "GenICam: such as Mono8 or BayerRG8; 8 bits.")
    ],
}


def takes_cameras(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of live cameras; it gets them as one argument, camera_options, its last."""
    own = inspect.signature(command)
    kinds = get_type_hints(command, include_extras=True)
    added = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=kind)
        for name, kind in OPTIONS.items()
    ]
    kept = [
        one.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=kinds[name])
        for name, one in own.parameters.items()
        if name != "camera_options"
    ]

    @functools.wraps(command)
    def run(**given: Any) -> None:
        options = CameraOptions(**{name: given.pop(name) for name in OPTIONS})
        command(**given, camera_options=options)

    run.__signature__ = own.replace(parameters=kept + added)  # type: ignore[attr-defined]  # a wrapper's own parameters
    run.__annotations__ = {one.name: one.annotation for one in kept + added}
    return run
