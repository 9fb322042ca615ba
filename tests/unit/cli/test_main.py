"""What the command line sets before anything is imported."""

from __future__ import annotations

import os

import pytest

import armsight.cli
import armsight.cli.commands


@pytest.mark.parametrize(("said", "kept"), [(None, "1"), ("3", "3")])
def test_linear_algebra_has_one_thread_unless_the_user_says_otherwise(
    said: str | None, kept: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    if said is not None:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", said)
    seen: list[str | None] = []
    monkeypatch.setattr(
        armsight.cli.commands, "app", lambda prog_name: seen.append(os.environ.get("OPENBLAS_NUM_THREADS"))
    )
    armsight.cli.main()
    assert seen == [kept]
