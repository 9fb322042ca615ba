"""Recordings in MCAP: everything on one clock, readable after a crash."""

from armsight.store.recording.images import Encoded, ImageFormat, encode
from armsight.store.recording.mcapfile import CHUNK_S
from armsight.store.recording.reader import Command, Event, Recorded, Recording, SpotsSeen
from armsight.store.recording.repair import Repaired, cut, repair
from armsight.store.recording.writer import RecordingWriter
