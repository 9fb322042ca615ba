"""All results for programs by the command that gives them; the documentation and its JSON schemas are made of this."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from armsight.app.schemas.arm import ArmOutput, IdentifyOutput, ProposedPlanOutput, RobotWorldOutput
from armsight.app.schemas.base import RefusalOutput
from armsight.app.schemas.cameras import (
    CameraOutput,
    MirrorCheckOutput,
    MirrorsOutput,
    NoiseOutput,
    StereoOutput,
    ZoomRigOutput,
)
from armsight.app.schemas.compare import CompareOutput
from armsight.app.schemas.files import (
    ConvertOutput,
    ConvertTableOutput,
    ExportOutput,
    JoinOutput,
    RecordOutput,
    RepairOutput,
    SimulateOutput,
)
from armsight.app.schemas.handeye import HandEyeOutput, LightTargetOutput, PivotOutput, TipOutput
from armsight.app.schemas.kinematics import (
    ConvertArmOutput,
    FkOutput,
    FormulasOutput,
    IkOutput,
    JacobianOutput,
    PathOutput,
    ShowOutput,
)
from armsight.app.schemas.machine import DoctorOutput
from armsight.app.schemas.measure import DemoOutput, MeasureOutput
from armsight.app.schemas.paths import (
    PathChangeOutput,
    PathCheckOutput,
    PathExportOutput,
    PathPicksOutput,
    PathSmoothOutput,
)
from armsight.app.schemas.play import PlayOutput
from armsight.app.schemas.reproduce import ReproduceOutput
from armsight.app.schemas.robot import JogOutput, RobotTestOutput
from armsight.app.schemas.servo import ServoOutput
from armsight.app.schemas.teach import TeachOutput
from armsight.app.schemas.timing import TimingOutput
from armsight.app.schemas.verify import VerifyOutput, VerifyPlanOutput
from armsight.app.schemas.verify_live import MasteringOutput, MasteringPlanOutput, VerifyLiveOutput
from armsight.records.output import Output

OUTPUTS: Mapping[str, type[Output]] = MappingProxyType(
    {
        "measure": MeasureOutput,
        "demo": DemoOutput,
        "calibrate-camera": CameraOutput,
        "calibrate-camera-noise": NoiseOutput,
        "calibrate-stereo": StereoOutput,
        "calibrate-zoom-rig": ZoomRigOutput,
        "calibrate-mirrors": MirrorsOutput,
        "calibrate-mirrors-check": MirrorCheckOutput,
        "calibrate-target": LightTargetOutput,
        "calibrate-timing": TimingOutput,
        "calibrate-handeye": HandEyeOutput,
        "calibrate-tooltip": TipOutput,
        "calibrate-pivot": PivotOutput,
        "calibrate-arm": ArmOutput,
        "calibrate-robot-world": RobotWorldOutput,
        "identify": IdentifyOutput,
        "identify-propose": ProposedPlanOutput,
        "verify": VerifyOutput,
        "verify-plan": VerifyPlanOutput,
        "verify-live": VerifyLiveOutput,
        "verify-mastering": MasteringOutput,
        "verify-mastering-poses": MasteringPlanOutput,
        "record": RecordOutput,
        "record-repair": RepairOutput,
        "convert-recording": ExportOutput,
        "convert": ConvertOutput,
        "convert-table": ConvertTableOutput,
        "convert-arm": ConvertArmOutput,
        "compare": CompareOutput,
        "join": JoinOutput,
        "simulate": SimulateOutput,
        "reproduce": ReproduceOutput,
        "kinematics-fk": FkOutput,
        "kinematics-ik": IkOutput,
        "kinematics-jacobian": JacobianOutput,
        "kinematics-path": PathOutput,
        "kinematics-formulas": FormulasOutput,
        "kinematics-show": ShowOutput,
        "path-smooth": PathSmoothOutput,
        "path-change": PathChangeOutput,
        "path-check": PathCheckOutput,
        "path-export": PathExportOutput,
        "path-from-picks": PathPicksOutput,
        "robot-test": RobotTestOutput,
        "robot-jog": JogOutput,
        "play": PlayOutput,
        "servo": ServoOutput,
        "teach": TeachOutput,
        "doctor": DoctorOutput,
        "error": RefusalOutput,
    }
)
"""Name of the JSON schema -> model. The first line of a model's docstring is the command."""
