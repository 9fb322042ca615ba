"""What verifications come to: level and next step, of all that was seen and of a part."""

from types import SimpleNamespace

import pytest

from armsight.verify.alignment import FOREIGN
from armsight.verify.model import Kind
from armsight.verify.verdicts import FIND_MOVED, live_verdict, mastering_verdict, verify_verdict
from refusals import names_it


def verified(**more):
    seen = {"cause": "none", "kind": None, "n": 9, "rejected": [], "joints": ["one"], "verdict": "as it is"}
    laid = SimpleNamespace(hidden_m=None)
    return SimpleNamespace(**{**seen, "after": SimpleNamespace(rms_m=1e-4), "alignment": laid, **more})


@pytest.mark.parametrize(
    ("cause", "kind", "level", "said"),
    [
        ("measurement", None, "good", "Correct nothing in the arm"),
        ("several joints", None, "bad", "armsight calibrate arm"),
        ("model", None, "care", "armsight calibrate arm"),
        ("undecided", None, "care", "Measure more poses"),
        ("joint 2", Kind.ZERO.value, "bad", "joint 2"),
        ("joint 3", Kind.BACKLASH.value, "bad", "does not mend backlash"),
    ],
)
def test_what_to_do_after_a_verification(cause, kind, level, said):
    verdict = verify_verdict(verified(cause=cause, kind=kind))
    assert verdict.level == level and said in verdict.next[0] and cause in verdict.headline
    alone = verify_verdict(verified(cause=cause, kind=kind, joints=[]))
    assert alone.level == level and names_it(alone.next[0], "--arm", "--joints") and cause not in alone.headline


def test_errors_that_base_and_tool_may_hide_and_a_part_of_the_rows_are_not_called_nothing():
    for hidden_m, level, said in ((2e-3, "care", "--world"), (5e-5, "good", "Correct nothing in the arm")):
        verdict = verify_verdict(verified(cause="measurement", alignment=SimpleNamespace(hidden_m=hidden_m)))
        assert verdict.level == level and said in verdict.next[0]
    gross = [SimpleNamespace(why=f"{FOREIGN} by 3 mm")] * 2
    verdict = verify_verdict(verified(rejected=gross))
    assert (verdict.level, verdict.next) == ("care", [FIND_MOVED])


def watched(**more):
    levels = SimpleNamespace(to_dict=lambda: {"warn_m": 1e-3, "stop_m": None})
    seen = {"level": "good", "n": 100, "n_compared": 100, "levels": levels, "verdict": "as it is"}
    return SimpleNamespace(**{**seen, **more})


def test_what_to_do_where_not_all_was_seen():
    """A good verdict on a part says so."""
    whole, few, many = (live_verdict(watched(n_compared=n)) for n in (100, 99, 90))
    assert (whole.level, few.level, many.level) == ("good", "good", "care")
    assert whole.next != few.next == many.next
    unset = SimpleNamespace(to_dict=lambda: {"warn_m": None, "stop_m": None})
    assert names_it(live_verdict(watched(levels=unset)).next[0], "--warn-mm", "--stop-mm")
    assert [live_verdict(watched(level=one)).level for one in ("warn", "stop", "unknown")] == ["care", "bad", "bad"]
    some, all_ = (
        mastering_verdict(
            SimpleNamespace(cause="none", verdict="", joints=[SimpleNamespace(judged=one) for one in (True, last)])
        )
        for last in (False, True)
    )
    assert some.level == all_.level == "good" and some.next != all_.next
