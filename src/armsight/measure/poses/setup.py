"""What stays the same from frame to frame, prepared once."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from armsight.measure.poses.pairs import SLACK_PX
from armsight.measure.poses.target_model import TargetModel
from armsight.measure.settings import SpotSettings
from armsight.optics import RIG_PARAMETERS, PackedRig, Rig
from armsight.records import NoiseModel, Target

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """The rig, the target and how spots are found.

    slack_px: what calibration, the target's measures and the shutters' skew may add to a spot's standard deviation
    before a match is doubted. A colour of the target is looked for unless the settings name their own. Raises
    Degenerate for a measured target whose spots (three or more) lie on one line. overlaid: one image holds both views,
    one upon the other (a mirror rig's complex image); it is then given as the left and as the right frame. covariance:
    of RIG_PARAMETERS and of the target's positions, (26 + 3 m, 26 + 3 m), (26, 26) where the target is taken as exact,
    (0, 0) where the rig is as well. Both are taken as independent. sides: the settings of each camera, with the gain of
    its noise where the rig knows it, and with its own of masks (left, right), (h, w), in place of the settings' one.
    """

    rig: Rig
    target: Target
    settings: SpotSettings = field(default_factory=SpotSettings)
    slack_px: float = SLACK_PX
    overlaid: bool = False
    masks: tuple[NDArray[np.bool_] | None, NDArray[np.bool_] | None] = (None, None)
    packed: PackedRig = field(init=False, repr=False)
    model: TargetModel = field(init=False, repr=False)
    covariance: Array = field(init=False, repr=False)

    sides: tuple[SpotSettings, SpotSettings] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "packed", PackedRig.of(self.rig))
        object.__setattr__(self, "model", TargetModel.of(self.target))
        object.__setattr__(self, "covariance", _joint_covariance(self.packed.covariance, self.target.covariance))
        if self.target.colour is not None and self.settings.colour is None:
            object.__setattr__(self, "settings", replace(self.settings, colour=self.target.colour))
        own = [self.settings if mask is None else replace(self.settings, mask=mask) for mask in self.masks]
        sides = tuple(_with_noise(one, noise) for one, noise in zip(own, self.rig.noise, strict=True))
        object.__setattr__(self, "sides", sides)

    def covariance_of(self, names: tuple[str, ...]) -> Array:
        """Return the covariance of the rig's parameters and of these lights' positions, in their order."""
        n = len(RIG_PARAMETERS)
        if names == self.model.names or len(self.covariance) <= n:
            return self.covariance
        lights = np.array([self.model.names.index(name) for name in names])
        index = np.concatenate([np.arange(n), (n + 3 * lights[:, None] + np.arange(3)).ravel()])
        out = np.ascontiguousarray(self.covariance[np.ix_(index, index)])
        out.setflags(write=False)  # as the whole one: one compilation serves both
        return out


def _joint_covariance(rig: Array, target: Array | None) -> Array:
    n = len(RIG_PARAMETERS)
    if target is None:
        return rig
    out = np.zeros((n + len(target), n + len(target)))
    out[:n, :n] = rig if rig.size else 0.0
    out[n:, n:] = target
    out.setflags(write=False)
    return out


def _with_noise(settings: SpotSettings, noise: NoiseModel | None) -> SpotSettings:
    """Return the settings with the shot noise's gain of a camera whose noise is known and follows a line."""
    if settings.gain is not None or noise is None or noise.linear is None:
        return settings
    return replace(settings, gain=noise.linear.gain_levels)
