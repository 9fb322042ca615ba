"""GenICam cameras: Aravis's fake GigE camera on loopback, read by the driver and measured by the command."""

import subprocess
from collections.abc import Iterator
from itertools import islice
from typing import Any

import pytest

from armsight.drivers import CameraSettings, aravis
from armsight.drivers.aravis import AravisCamera, genicam_cameras
from armsight.errors import DeviceFailed, DeviceLost, DeviceNotFound, UsageError
from armsight.records import Frame
from armsight.testing.genicam import ADDRESS, fake_genicam_camera, missing
from refusals import refuses

MISSING = missing()
needs_aravis = pytest.mark.skipif(bool(MISSING), reason=f"no GenICam camera can be played here: {MISSING}")


@pytest.fixture
def stock() -> Iterator[subprocess.Popen[bytes]]:
    with fake_genicam_camera() as process:
        yield process


def first(count: int, **asked: Any) -> list[Frame]:
    colour = asked.pop("colour", False)
    with AravisCamera(ADDRESS, colour=colour, settings=CameraSettings(**asked)) as camera:
        return list(islice(camera, count))


@needs_aravis
def test_frames_carry_the_camera_s_own_stamps_and_exposure(stock: object) -> None:
    frames = first(4, exposure_s=0.004, gain=2.0)
    assert {frame.image.shape for frame in frames} == {(512, 512)}
    assert {frame.exposure_s for frame in frames} == {0.004}
    assert [frame.sequence for frame in frames] == sorted({frame.sequence for frame in frames})
    again = first(1)[0]
    assert again.sequence == 0 and again.exposure_s == 0.004  # the camera keeps what it was told


@needs_aravis
def test_the_first_camera_is_found_without_a_name(stock: object) -> None:
    assert genicam_cameras() == ("camera:aravis:Aravis-Fake-GV01",)
    with AravisCamera("") as camera:
        assert next(iter(camera)).source == "camera:aravis"


@needs_aravis
def test_eight_bit_formats_become_grey_or_bgr(stock: object) -> None:
    for name in ("Mono8", "RGB8", "BayerRG8", "BayerBG8", "BayerGB8", "BayerGR8"):
        assert first(1, pixel_format=name)[0].image.shape == (512, 512), name
        assert first(1, pixel_format=name, colour=True)[0].image.shape == (512, 512, 3), name


@needs_aravis
def test_what_the_camera_has_not_is_refused_with_what_it_has(stock: object) -> None:
    for asked, cure in (
        ({"pixel_format": "Mono16"}, "Mono8"),
        ({"pixel_format": "Nosuch"}, "Mono8"),
        ({"trigger": "Line7"}, "Line0"),
        ({"trigger": "Software"}, "Line0"),
        ({"exposure_s": 1000.0}, "1e-05 to 10"),
        ({"gain": -3.0}, "0 to 10"),
    ):
        with pytest.raises(DeviceFailed) as info:
            first(1, **asked)
        assert cure in info.value.cure, asked
        assert info.value.consequence
    assert first(1, pixel_format="Mono8")[0].image.shape == (512, 512)


@needs_aravis
def test_a_second_program_is_refused(stock: object) -> None:
    with AravisCamera(ADDRESS), pytest.raises(DeviceFailed, match=r"controlled|in use"), AravisCamera(""):
        pass
    with AravisCamera(ADDRESS), refuses(DeviceFailed, "in use"), AravisCamera(ADDRESS):
        pass


@needs_aravis
def test_a_camera_that_is_not_there_is_answered_with_those_that_are(stock: object) -> None:
    with refuses(DeviceNotFound, "camera:aravis:nosuch") as info, AravisCamera("nosuch"):
        pass
    assert "camera:aravis:Aravis-Fake-GV01" in info.value.cure


@needs_aravis
def test_a_camera_that_goes_is_lost_even_while_it_waits_for_its_trigger(stock: subprocess.Popen[bytes]) -> None:
    settings = CameraSettings(trigger="Line0")
    with refuses(DeviceLost, "answers"), AravisCamera(ADDRESS, settings=settings) as camera:
        stock.kill()
        list(camera)


@needs_aravis
def test_a_camera_that_was_triggered_runs_freely_for_the_next_one(stock: object) -> None:
    with AravisCamera(ADDRESS, settings=CameraSettings(trigger="Line0")):
        pass
    assert first(1)[0].sequence == 0


def test_without_aravis_the_cure_says_what_to_install() -> None:
    def absent() -> Any:
        raise DeviceNotFound("Aravis cannot be loaded", cure="Install the extra")

    with refuses(DeviceNotFound, "loaded"), AravisCamera("x", load=absent):
        pass
    with pytest.raises(UsageError, match="--focus"):
        AravisCamera("x", settings=CameraSettings(focus=1.0))


def test_stamps_follow_the_camera_s_clock_and_numbers_count_lost_frames() -> None:
    stamps = aravis._Stamps("cam", 0.01)
    got = [stamps.of(10**18 + ns, number, 5.0) for ns, number in ((0, 65534), (40_000_000, 65535), (120_000_000, 2))]
    assert [t_s for t_s, _ in got] == pytest.approx([4.995, 5.035, 5.115])  # the exposure ended on arrival, at 5.0
    assert [number for _, number in got] == [0, 1, 3]  # 65535 is followed by 1, which was lost
    with refuses(DeviceFailed, "time stamp", "after"):
        stamps.of(10**18, 3, 6.0)


def test_a_camera_without_stamps_gives_times_of_arrival() -> None:
    stamps = aravis._Stamps("cam", 0.01)
    assert [stamps.of(0, n, t)[0] for n, t in ((1, 5.0), (2, 5.5))] == pytest.approx([4.995, 5.495])
