"""The key `noise` of camera.yaml and rig.yaml."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from armsight.records import NoiseModel
from armsight.store.codec import mapping, structure
from armsight.store.schema import Origin, write_document
from armsight.store.yamls import read_yaml

NoiseKey = structure(NoiseModel)


def add_noise(path: Path, noise: Mapping[str, NoiseModel], *, inputs: Sequence[Path] = ()) -> None:
    """Write the noise into a camera.yaml (side "") or a rig.yaml (sides left, right); all else in it stays.

    The file must have been read before, as what it is: nothing is checked here.
    """
    content = read_yaml(path)
    for side, one in noise.items():
        place = content["cameras"][side] if side else content
        place["noise"] = mapping(one)
    origin = {name: content.pop(name, None) for name in ("format", "version", *Origin.model_fields)}
    write_document(path, str(origin["format"]), content, inputs, earlier=origin["inputs"] or ())
