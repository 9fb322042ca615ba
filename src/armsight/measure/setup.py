"""What stays the same from frame to frame, prepared once."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from armsight.measure.match import SLACK_PX
from armsight.measure.model import TargetModel
from armsight.measure.settings import SpotSettings
from armsight.optics import PackedRig, Rig
from armsight.records import Target


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """The rig, the target and how spots are found.

    slack_px: what calibration, the target's measures and the shutters' skew may add to a spot's deviation before a
    match is doubted. A colour of the target is looked for unless the settings name their own. Raises Degenerate
    for a measured target whose spots (three or more) lie on one line. overlaid: one image holds both views, one upon
    the other (a mirror rig's complex image); it is then given as the left and as the right frame.
    """

    rig: Rig
    target: Target
    settings: SpotSettings = field(default_factory=SpotSettings)
    slack_px: float = SLACK_PX
    overlaid: bool = False
    packed: PackedRig = field(init=False, repr=False)
    model: TargetModel = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "packed", PackedRig.of(self.rig))
        object.__setattr__(self, "model", TargetModel.of(self.target))
        if self.target.colour is not None and self.settings.colour is None:
            object.__setattr__(self, "settings", replace(self.settings, colour=self.target.colour))
