"""Certificates for both sides, and tokens."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from armsight.store.tokens import add_token
from armsight_plant.certificates import make_pair


@dataclass(frozen=True)
class Keys:
    """Both sides' certificates, whom the server trusts, and the tokens."""

    server: tuple[Path, Path]
    client: tuple[Path, Path]
    stranger: tuple[Path, Path]
    trusted: Path
    tokens: Path
    of: dict[str, str]


@pytest.fixture(scope="session")
def keys(tmp_path_factory):
    folder = tmp_path_factory.mktemp("keys")
    made = {who: make_pair(folder / who, f"{who}.example") for who in ("server", "client", "stranger")}
    trusted = folder / "trusted"
    trusted.mkdir()
    (trusted / "client.pem").write_bytes(made["client"][0].read_bytes())
    tokens = folder / "tokens.yaml"
    of = {role: add_token(tokens, role, role) for role in ("watch", "acknowledge", "drive")}
    return Keys(**made, trusted=trusted, tokens=tokens, of=of)
