"""tokens.yaml: who may watch, acknowledge alarms, and drive a robot server. It holds hashes, never a token."""

from __future__ import annotations

import hashlib
import hmac
import secrets
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, get_args

from pydantic import Field

from armsight.errors import BadFile, UsageError
from armsight.store.codec import Strict, validated
from armsight.store.schema import Origin, read_document, write_document

FORMAT = "armsight/tokens"
TOKEN_BYTES = 32
"""A token is 256 random bits: nobody guesses it, so a plain SHA-256 of it tells nothing and needs no salt."""

PRIVATE_MODE = 0o600

Role = Literal["watch", "acknowledge", "drive"]
"""Each may what those before it may; acknowledge: alarms, over OPC UA."""
ROLES: tuple[str, ...] = get_args(Role)
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._-]{0,39}$")]


class TokenEntry(Strict):
    """Whom a token stands for, what it allows, and its SHA-256 in hexadecimal digits."""

    name: Name
    role: Role
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]

    def matches(self, token: str) -> bool:
        """Return whether this is the token; takes the same time for every wrong one."""
        return hmac.compare_digest(self.sha256, _hash(token))


class TokensModel(Origin):
    """The file."""

    format: Literal["armsight/tokens"]
    tokens: Annotated[list[TokenEntry], Field(min_length=1, max_length=100)]


def read_tokens(path: Path) -> tuple[TokenEntry, ...]:
    """Return the entries of tokens.yaml. Raises BadFile, also where others may write it or a name is there twice."""
    entries = tuple(validated(TokensModel, read_document(path, FORMAT), str(path)).tokens)
    if path.stat().st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise BadFile(
            f"{path}: others than its owner may write it",
            consequence="Anyone of them could drive the robot; it is not used",
            cure=f"chmod 600 {path}",
        )
    names = [entry.name for entry in entries]
    if len(set(names)) != len(names):
        raise BadFile(f"{path}: a name is there twice", consequence="Who drives would not be known", cure="Rename one")
    return entries


def add_token(path: Path, name: str, role: str) -> str:
    """Add a new token to tokens.yaml, made where it is missing, and return it: it is kept nowhere.

    A name that is there gets this token in place of its old one. Raises UsageError, BadFile, DeviceFailed.
    """
    if role not in ROLES:
        raise UsageError(f"{role!r} is no role", cure=f"Choose {' or '.join(ROLES)}")
    token = secrets.token_urlsafe(TOKEN_BYTES)
    before = read_tokens(path) if path.exists() else ()
    content = {"name": name, "role": role, "sha256": _hash(token)}
    try:
        entry = validated(TokenEntry, content, "the token")
    except BadFile as error:
        raise UsageError(error.cause, cure="Give NAME:ROLE, such as anna:drive") from error
    _write(path, [*(other for other in before if other.name != name), entry])
    return token


def _write(path: Path, entries: Sequence[TokenEntry]) -> None:
    write_document(path, FORMAT, {"tokens": [entry.model_dump() for entry in entries]}, ())
    path.chmod(PRIVATE_MODE)


def _hash(token: str) -> str:
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest()
