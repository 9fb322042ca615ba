"""Centres and areas of lit discs and spheres against Blender's renderer."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight_sim import Lens, Light, Rest, Sensor, SimCamera, ambient

DATA = np.load(Path(__file__).parent / "data" / "renderer" / "lit_shapes.npz")
CENTRE_TOLERANCE_PX = 0.01


def as_disc(kind, centre, radius, normal):
    """Centre, radius and facing of the flat disc that the camera cannot tell from the shape.

    The rays that touch a sphere meet it on a circle, nearer than its centre by the ratio (radius / distance)^2.
    """
    if kind == "disc":
        return centre, radius, normal
    ratio = radius**2 / (centre @ centre)
    return centre * (1.0 - ratio), radius * np.sqrt(1.0 - ratio), -centre


def total_and_centre(image):
    v, u = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    return image.sum(), np.array([(image * u).sum(), (image * v).sum()]) / image.sum()


@pytest.mark.parametrize("index", range(len(DATA["kind"])))
def test_centre_and_area_agree(index):
    width, height = DATA["size_px"].tolist()
    focal = float(DATA["focal_px"])
    camera = SimCamera(
        lens=Lens(width=width, height=height, focal_px=(focal, focal), centre_px=((width - 1) / 2, (height - 1) / 2)),
        T_world_camera=RigidTransform.identity(),
        sensor=Sensor(),
        backdrop=ambient(width, height, 0.0),
    )
    kind = str(DATA["kind"][index])
    centre, radius, facing = as_disc(
        kind, DATA["centre_m"][index], float(DATA["radius_m"][index]), DATA["normal"][index]
    )
    light = Light(name="A", xyz_m=(0.0, 0.0, 0.0), level=1.0, sigma_px=0.5, diameter_m=2 * radius, facing=tuple(facing))
    ours = camera.light([light], Rest(T_world_target=RigidTransform.from_translation(centre)), 0.0)[:, :, 0]
    (i, j), theirs = DATA["corner_px"][index], DATA["crops"][index].astype(float)
    area, middle = total_and_centre(ours[j : j + 40, i : i + 40].astype(float))
    peer_area, peer_middle = total_and_centre(theirs)
    np.testing.assert_allclose(middle, peer_middle, atol=CENTRE_TOLERANCE_PX)
    assert area == pytest.approx(peer_area, rel=2e-3)
