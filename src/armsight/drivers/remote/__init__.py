"""A robot behind a robot server: the protocol, a client's connection, and the Robot on top of it."""

from armsight.drivers.remote.link import Heart, Link
from armsight.drivers.remote.remote_robot import RemoteRobot
from armsight.drivers.remote.wire import ServerAddress
