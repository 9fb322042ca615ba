"""What a camera's picture says about its exposure and focus."""

import numpy as np
import pytest

from armsight.measure.planning import Aiming, aiming_hint
from armsight.measure.settings import SpotSettings
from armsight.measure.spots import find_spots
from armsight.records import Frame

SETTINGS = SpotSettings()


def picture(*, height: float, sigma_px: float, room: float = 20.0) -> Frame:
    """Three lights of a height above an even room, with a grey level of noise."""
    y, x = np.mgrid[0:240, 0:320]
    image = np.random.default_rng(5).normal(room, 1.0, y.shape)
    for u, v in ((80.0, 60.0), (200.0, 90.0), (150.0, 180.0)):
        image += height * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2.0 * sigma_px**2))
    return Frame(image=np.clip(np.rint(image), 0, 255).astype(np.uint8), t_s=0.0, sequence=0, source="drawn")


@pytest.mark.parametrize(
    ("frame", "advice"),
    [
        (picture(height=150.0, sigma_px=2.0), Aiming.GOOD),
        (picture(height=600.0, sigma_px=2.0), Aiming.CLIPPED),
        (picture(height=18.0, sigma_px=2.0), Aiming.FAINT),
        (picture(height=150.0, sigma_px=8.0), Aiming.BLURRED),
        (picture(height=0.0, sigma_px=2.0), Aiming.NOTHING_SEEN),
        (picture(height=0.0, sigma_px=2.0, room=300.0), Aiming.ROOM_TOO_BRIGHT),
    ],
)
def test_the_most_urgent_change_is_advised(frame: Frame, advice: Aiming) -> None:
    assert aiming_hint(frame, find_spots(frame.image, SETTINGS), SETTINGS).advice is advice
