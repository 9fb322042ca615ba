"""The messages of EGM as far as armsight uses them, built at run time from field numbers and types.

The numbers are those of ABB's published definition of the sensor interface (package abb.egm, proto2), chapter
"Externally Guided Motion" of the application manual "Controller software IRC5 / OmniCore". Fields left out here are
skipped by every protobuf reader. All fields are optional here; what must be there is checked in `packets`.
"""

from __future__ import annotations

from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

FIELD = descriptor_pb2.FieldDescriptorProto
UINT32, UINT64, BOOL, DOUBLE, ENUM = (
    FIELD.TYPE_UINT32,
    FIELD.TYPE_UINT64,
    FIELD.TYPE_BOOL,
    FIELD.TYPE_DOUBLE,
    FIELD.TYPE_INT32,  # an enumeration and an int32 are the same on the wire, and unknown values stay readable
)

MESSAGES: dict[str, dict[str, tuple[int, int | str, bool]]] = {
    "EgmHeader": {"seqno": (1, UINT32, False), "tm": (2, UINT32, False), "mtype": (3, ENUM, False)},
    "EgmCartesian": {"x": (1, DOUBLE, False), "y": (2, DOUBLE, False), "z": (3, DOUBLE, False)},
    "EgmQuaternion": {f"u{i}": (i + 1, DOUBLE, False) for i in range(4)},
    "EgmPose": {"pos": (1, "EgmCartesian", False), "orient": (2, "EgmQuaternion", False)},
    "EgmJoints": {"joints": (1, DOUBLE, True)},
    "EgmClock": {"sec": (1, UINT64, False), "usec": (2, UINT64, False)},
    "EgmPlanned": {"joints": (1, "EgmJoints", False), "cartesian": (2, "EgmPose", False)},
    "EgmFeedBack": {
        "joints": (1, "EgmJoints", False),
        "cartesian": (2, "EgmPose", False),
        "time": (4, "EgmClock", False),
    },
    "EgmState": {"state": (1, ENUM, False)},
    "EgmRobot": {
        "header": (1, "EgmHeader", False),
        "feedBack": (2, "EgmFeedBack", False),
        "planned": (3, "EgmPlanned", False),
        "motorState": (4, "EgmState", False),
        "mciState": (5, "EgmState", False),
        "mciConvergenceMet": (6, BOOL, False),
        "rapidExecState": (8, "EgmState", False),
    },
    "EgmSensor": {"header": (1, "EgmHeader", False), "planned": (2, "EgmPlanned", False)},
}
"""Field name: (number, type or message, repeated). EgmState stands for the three messages of one enumeration each."""


def _classes() -> dict[str, Any]:
    """Return the message classes by name, in a pool of their own."""
    file = descriptor_pb2.FileDescriptorProto(name="armsight/egm.proto", package="armsight.egm", syntax="proto2")
    for name, fields in MESSAGES.items():
        message = file.message_type.add(name=name)
        for field, (number, kind, repeated) in fields.items():
            label = FIELD.LABEL_REPEATED if repeated else FIELD.LABEL_OPTIONAL
            entry = message.field.add(name=field, number=number, label=label)
            if isinstance(kind, str):
                entry.type, entry.type_name = FIELD.TYPE_MESSAGE, f".armsight.egm.{kind}"
            else:
                entry.type = kind  # type: ignore[assignment]
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"armsight.egm.{name}")) for name in MESSAGES
    }


CLASSES = _classes()
EgmRobotMessage: Any = CLASSES["EgmRobot"]
EgmSensorMessage: Any = CLASSES["EgmSensor"]
