"""Files that are called after a name."""

import json
from types import SimpleNamespace

from hypothesis import given
from hypothesis import strategies as st

from labrun.app.diagnose_robot import JointsDone
from labrun.app.kept import stem_of

NAMES = st.text(st.sampled_from("ab.-_/ \u00e4\u00f6"), min_size=1, max_size=4)


@given(first=NAMES, second=NAMES)
def test_different_names_give_different_files(first, second):
    assert (stem_of(first) == stem_of(second)) == (first == second)
    assert "/" not in stem_of(first)


def test_a_name_that_needs_no_change_is_kept():
    assert stem_of("driven-pendulum_2") == "driven-pendulum_2"


def test_joints_that_are_done_are_kept_before_the_others_are(tmp_path):
    done = JointsDone(tmp_path / "results" / "gap-joints.json")
    done.keep("shoulder", SimpleNamespace(to_json=lambda: {"verdict": "no-gap"}))
    done.keep("elbow", SimpleNamespace(to_json=lambda: {"verdict": "unexplained"}))
    done.keep("elbow", SimpleNamespace(to_json=lambda: {"verdict": "explained", "gap": float("nan")}))
    assert json.loads(done.file.read_text()) == {
        "shoulder": {"verdict": "no-gap"}, "elbow": {"verdict": "explained", "gap": None},
    }  # fmt: skip
