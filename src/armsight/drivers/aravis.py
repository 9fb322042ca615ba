"""GenICam cameras, GigE Vision and USB3 Vision, through Aravis, whose binding is loaded when a camera is opened."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from armsight._files import DeviceLock
from armsight.clock import Clock
from armsight.drivers.camera_settings import AUTOMATIC, FLAGS, CameraSettings, require_read_back
from armsight.drivers.images import CHANNELS, grey_or_bgr, unpack_image
from armsight.drivers.live import LiveCamera
from armsight.errors import DeviceFailed, DeviceLost, DeviceNotFound
from armsight.records import Frame

SETTINGS = ("exposure_s", "gain", "trigger", "pixel_format")
"""What can be asked of such a camera."""

LAYOUTS = {
    "Mono8": "mono",
    "RGB8": "rgb",
    "RGB8Packed": "rgb",
    "BGR8": "bgr",
    "BGR8Packed": "bgr",
    "BayerRG8": "rggb",
    "BayerBG8": "bggr",
    "BayerGB8": "gbrg",
    "BayerGR8": "grbg",
}
"""Layout by GenICam's name of the pixel format: those of 8 bits, as a frame has."""

BUFFERS = 8
"""Images that may be on their way at once: a quarter of a second at 30 a second."""

POLL_US = 100_000
"""How long to wait for an image before looking whether to stop or whether the camera has gone."""

INCOMPLETE = 30
"""Images with missing parts one after the other before the link counts as failed."""

BLOCK_IDS = 0xFFFF
"""Frame numbers of GigE Vision go from 1 to this and begin again; longer ones of other cameras differ by as little."""

US = 1e-6
NS = 1e-9


def load_aravis() -> Any:
    """Return the module gi.repository.Aravis, version 0.8. Raises DeviceNotFound where a part of it is missing."""
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis
    except (ImportError, ValueError) as error:
        raise DeviceNotFound(
            f"Aravis cannot be loaded: {error}",
            consequence="GenICam cameras cannot be used",
            cure="Install the extra (pip install 'armsight[aravis]') and Aravis 0.8 with its typelib (Debian: apt-get "
            "install gir1.2-aravis-0.8, and libgirepository1.0-dev and libcairo2-dev to build the extra)",
        ) from error
    return Aravis


def genicam_cameras() -> tuple[str, ...]:
    """Return the cameras that Aravis sees now, as they are named on the command line; none where it is missing."""
    try:
        api = load_aravis()
    except DeviceNotFound:
        return ()
    return tuple(f"camera:aravis:{device}" for device in _devices(api))


class AravisCamera(LiveCamera):
    """A GenICam camera by its id, serial number or address; '' for the first one.

    t_s counts by the camera's own clock, whose stamp is taken for the start of the exposure; the first frame ties it
    to the clock: its exposure is taken to end when it arrives. A camera without stamps gives times of arrival, half an
    exposure earlier. Gaps in sequence are frames that were lost on the way. settings are locked on opening; with a
    trigger it waits as long as it takes. Raises DeviceNotFound, DeviceFailed, DeviceLost. load: for tests.
    """

    cure = "Check plug, cable and network, and start again; a camera that is set to wait for a trigger needs --trigger"

    def __init__(
        self,
        device: str = "",
        *,
        colour: bool = False,
        clock: Clock | None = None,
        origin_s: float | None = None,
        settings: CameraSettings = AUTOMATIC,
        load: Callable[[], Any] = load_aravis,
    ) -> None:
        name = f"camera:aravis:{device}" if device else "camera:aravis"
        settings.require_only(SETTINGS, name)
        super().__init__(name, clock=clock, origin_s=origin_s, lock=DeviceLock(name))
        self._device = device
        self._colour = colour
        self._settings = settings
        self._load = load
        self._camera: Any = None
        self._stream: Any = None
        self._gone = threading.Event()
        self._layout = ""
        self._exposure_s = 0.0
        self.waits = settings.trigger is not None

    def _open_device(self) -> None:
        api = self._load()
        camera = self._found(api)
        try:
            self._start(api, camera)
        except BaseException:
            _release(api, camera)  # an error's traceback keeps the camera alive, and with it the control of it
            raise

    def _start(self, api: Any, camera: Any) -> None:
        try:
            self._require_control(api, camera)
            self._set_up(api, camera)
            self._layout = _layout_of(camera, self.name)
            self._gone.clear()
            gone = self._gone
            camera.get_device().connect("control-lost", lambda *_: gone.set())
            stream = camera.create_stream(None, None)
            for _ in range(BUFFERS):
                stream.push_buffer(api.Buffer.new_allocate(camera.get_payload()))
            camera.start_acquisition()
        except _errors() as error:
            raise DeviceFailed(
                f"{self.name} cannot be started: {_words(error)}",
                consequence="There are no frames",
                cure="Check its network address and settings with arv-viewer-0.8 or the maker's tool, and that nobody "
                "else holds it",
            ) from error
        self._camera, self._stream = camera, stream

    def _found(self, api: Any) -> Any:
        try:
            return api.Camera.new(self._device or None)
        except _errors() as error:
            there = ", ".join(f"camera:aravis:{device}" for device in _devices(api))
            raise DeviceNotFound(
                f"{self.name} cannot be opened: {_words(error)}",
                consequence="There are no frames",
                cure=f"Cameras there: {there}" if there else "No GenICam camera answers: check its power and cable",
            ) from error

    def _require_control(self, api: Any, camera: Any) -> None:
        device = camera.get_device()
        if isinstance(device, api.GvDevice) and not device.is_controller():
            raise DeviceFailed(
                f"{self.name} is controlled by another program",
                consequence="It would not obey, so no frame is read",
                cure="Stop the other program; after a crash wait a few seconds until the camera notices",
            )

    def _set_up(self, api: Any, camera: Any) -> None:
        asked = self._settings
        if asked.pixel_format is not None:
            _require_known(self.name, "pixel_format", asked.pixel_format, _formats(camera))
            camera.set_pixel_format_from_string(asked.pixel_format)
        camera.set_acquisition_mode(api.AcquisitionMode.CONTINUOUS)
        if asked.exposure_s is not None:
            if camera.is_exposure_auto_available():
                camera.set_exposure_time_auto(api.Auto.OFF)
            _require_within(self.name, "exposure_s", asked.exposure_s, camera.get_exposure_time_bounds(), US)
            camera.set_exposure_time(asked.exposure_s / US)
            require_read_back(self.name, "exposure_s", asked.exposure_s, camera.get_exposure_time() * US)
        if asked.gain is not None:
            if camera.is_gain_auto_available():
                camera.set_gain_auto(api.Auto.OFF)
            _require_within(self.name, "gain", asked.gain, camera.get_gain_bounds(), 1.0)
            camera.set_gain(asked.gain)
            require_read_back(self.name, "gain", asked.gain, camera.get_gain(), step=0.5)
        if asked.trigger is not None:
            inputs = [source for source in camera.dup_available_trigger_sources() if source != "Software"]
            _require_known(self.name, "trigger", asked.trigger, inputs)  # nobody would send it triggers by software
            camera.set_trigger(asked.trigger)
        self._exposure_s = camera.get_exposure_time() * US if camera.is_exposure_time_available() else 0.0

    def _close_device(self) -> None:
        if self._camera is not None:
            with suppress(*_errors()):  # a camera that has gone cannot be told to stop
                self._camera.stop_acquisition()
                if self._settings.trigger is not None:
                    self._camera.clear_triggers()  # the next program may want frames without one
            _release(self._load(), self._camera)
        self._stream = self._camera = None  # Aravis closes what nobody holds

    def _read_frames(self) -> None:
        api, stream = self._load(), self._stream
        stamps = _Stamps(self.name, self._exposure_s)
        incomplete = 0
        while not self._stop.is_set():
            if self._gone.is_set():
                raise self._lost("no longer answers")
            buffer = stream.timeout_pop_buffer(POLL_US)
            if buffer is None:
                continue
            arrival_s = self._now_s()
            complete = buffer.get_status() == api.BufferStatus.SUCCESS
            incomplete = 0 if complete else incomplete + 1
            if complete:
                self._put(self._frame(buffer, stamps, arrival_s))
            stream.push_buffer(buffer)
            if incomplete >= INCOMPLETE:
                raise _incomplete(self.name)

    def _frame(self, buffer: Any, stamps: _Stamps, arrival_s: float) -> Frame:
        t_s, sequence = stamps.of(buffer.get_timestamp(), buffer.get_frame_id(), arrival_s)
        width, height = buffer.get_image_width(), buffer.get_image_height()
        step = width * CHANNELS[self._layout] + buffer.get_image_padding()[0]
        pixels = unpack_image(buffer.get_data(), height, width, step, self._layout)
        if pixels is None:
            raise DeviceFailed(
                f"{self.name} sent less than an image of {width}x{height} px of its pixel format",
                consequence="No frame can be measured from here on",
                cure="Leave its pixel format and size alone while it is read",
            )
        image = grey_or_bgr(pixels, self._layout, colour=self._colour)
        return Frame(image=image, t_s=t_s, sequence=sequence, source=self.name, exposure_s=self._exposure_s)


class _Stamps:
    """Times and numbers of frames from a camera's stamps and frame numbers."""

    def __init__(self, name: str, exposure_s: float) -> None:
        self._name = name
        self._exposure_s = exposure_s
        self._first_ns: int | None = None
        self._begin_s = 0.0
        self._last_s = -float("inf")
        self._last_id = 0
        self._sequence = -1

    def of(self, stamp_ns: int, frame_id: int, arrival_s: float) -> tuple[float, int]:
        """Return t_s and sequence. Raises DeviceFailed where the stamps do not increase."""
        if self._first_ns is None:
            self._first_ns = stamp_ns
            self._begin_s = arrival_s - self._exposure_s
            self._sequence = 0
        else:
            self._sequence += max((frame_id - self._last_id) % BLOCK_IDS, 1)
        self._last_id = frame_id
        begin_s = self._begin_s + (stamp_ns - self._first_ns) * NS if self._first_ns else arrival_s - self._exposure_s
        t_s = begin_s + 0.5 * self._exposure_s
        if t_s <= self._last_s:
            raise DeviceFailed(
                f"{self._name}: the camera's time stamp of frame {self._sequence} is not after the one before",
                consequence="When the frame was taken is not known, so reading stops here",
                cure="Stop whatever sets the camera's clock, and start again",
            )
        self._last_s = t_s
        return t_s, self._sequence


def _layout_of(camera: Any, name: str) -> str:
    """Return the layout of the camera's pixel format. Raises DeviceFailed that lists those that can be used."""
    pixel_format = camera.get_pixel_format_as_string()
    if pixel_format in LAYOUTS:
        return LAYOUTS[pixel_format]
    usable = [known for known in _formats(camera) if known in LAYOUTS]
    raise DeviceFailed(
        f"{name} is set to the pixel format {pixel_format}, and frames have 8 bits",
        consequence="There are no frames: nothing says which bits of a longer pixel carry the light",
        cure=f"Give --pixel-format with one of {', '.join(usable)}" if usable else "Use a camera with an 8-bit format",
    )


def _formats(camera: Any) -> list[str]:
    return list(camera.dup_available_pixel_formats_as_strings())


def _devices(api: Any) -> list[str]:
    api.update_device_list()
    return [str(api.get_device_id(i)) for i in range(api.get_n_devices())]


def _release(api: Any, camera: Any) -> None:
    """Let others control a camera of the network; Aravis lets go of those of USB when nobody holds them."""
    device = camera.get_device()
    if isinstance(device, api.GvDevice) and device.is_controller():
        with suppress(*_errors()):
            device.leave_control()


def _require_known(name: str, setting: str, asked: str, known: list[str]) -> None:
    if asked not in known:
        raise _not_there(name, f"{FLAGS[setting]} {asked} is not there", f"one of {', '.join(known)}" if known else "")


def _require_within(name: str, setting: str, asked: float, bounds: tuple[float, float], unit: float) -> None:
    low, high = bounds[0] * unit, bounds[1] * unit
    if not low <= asked <= high:
        raise _not_there(name, f"{FLAGS[setting]} {asked:g} is out of its range", f"{low:g} to {high:g}")


def _not_there(name: str, what: str, choice: str) -> DeviceFailed:
    return DeviceFailed(
        f"{name}: {what}",
        consequence="Nothing is read from it",
        cure=f"Give {choice}" if choice else "Leave it away: the camera has none",
    )


def _incomplete(name: str) -> DeviceLost:
    return DeviceLost(
        f"{name} sent {INCOMPLETE} incomplete images in a row",
        consequence="No frame can be measured from here on; what was measured until then is kept",
        cure="Allow larger packets (jumbo frames) on its network card, a longer delay between packets, or a lower rate",
    )


def _errors() -> tuple[type[Exception], ...]:
    try:
        from gi.repository import GLib
    except ImportError:  # where the API is a test's own
        return (RuntimeError,)
    return (GLib.Error,)


def _words(error: Exception) -> str:
    return str(getattr(error, "message", error))
