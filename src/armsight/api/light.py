"""The noise of a camera."""

from __future__ import annotations

from typing import Literal

from armsight.app.calibrate.camera_noise import find_noise
from armsight.app.calibrate.results import NoiseOutput
from armsight.app.requests.calibrate_cameras import NoiseJob
from armsight.drivers import CameraSettings
from armsight.ops.checks import speaks_python
from armsight.ops.given import Given, Source
from armsight.records import NoiseModel, Progress
from armsight.records.output import output


@output
class NoiseResult(NoiseOutput):
    """What `calibrate_noise` found: its figures, and `model`, as `CameraResult.save` and Rig(noise=...) take it."""

    model: NoiseModel


@speaks_python(NoiseJob)
def calibrate_noise(
    frames: Source,
    *,
    side: Literal["left", "right"] | None = None,
    every: int = NoiseJob.every,
    limit: int | None = None,
    camera_settings: CameraSettings | None = None,
    progress: Progress | None = None,
) -> NoiseResult:
    """Return a camera's noise, from 4 to 50 still frames of any scene.

    frames: images, or as `measure` takes them; or a camera.yaml or rig.yaml that holds the noise, of one side. every,
    limit: of the frames. Raises NotEnoughData, Inconsistent for frames that are not still.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> scene = np.linspace(20, 200, 320 * 240).reshape(240, 320)
    >>> still = [np.uint8(scene + rng.normal(0, 2, scene.shape)) for _ in range(8)]
    >>> armsight.calibrate_noise(still).noise.n_given
    8
    """
    with Given(name="camera.yaml") as given:
        found = find_noise(given.job(NoiseJob, locals()), progress)
        return NoiseResult(noise=found.output, model=found.noise)
