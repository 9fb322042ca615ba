"""Contract suites for the users' own drivers: subclass one, give it a driver, and pytest runs the whole contract."""

from armsight.testing.cameras import CameraCase, CameraContract
from armsight.testing.checks import check, contract_tests, refused
from armsight.testing.robots import RobotCase, RobotContract, RobotReadingContract
from armsight.testing.wrong_controllers import WrongCase, WrongController

__all__ = [
    "CameraCase",
    "CameraContract",
    "RobotCase",
    "RobotContract",
    "RobotReadingContract",
    "WrongCase",
    "WrongController",
    "check",
    "contract_tests",
    "refused",
]
