"""Files that are called after a name."""

import json

from hypothesis import given
from hypothesis import strategies as st

from labrun.app.diagnose_robot import JointsDone
from labrun.app.kept import stem_of
from labrun.gap.diagnosis import Shrinkage

NAMES = st.text(st.sampled_from("ab.-_/ \u00e4\u00f6"), min_size=1, max_size=4)


@given(first=NAMES, second=NAMES)
def test_different_names_give_different_files(first, second):
    assert (stem_of(first) == stem_of(second)) == (first == second)
    assert "/" not in stem_of(first)


def test_a_name_that_needs_no_change_is_kept():
    assert stem_of("driven-pendulum_2") == "driven-pendulum_2"


def test_joints_that_are_done_are_kept_before_the_others_are(tmp_path):
    done = JointsDone(tmp_path / "results" / "gap")
    done.keep("shoulder", Shrinkage(0.5, 0.4, 0.6))
    done.keep("elbow", Shrinkage(0.1, 0.0, 0.2))
    done.keep("elbow", Shrinkage(0.9, 0.8, 1.0))
    stored = json.loads(done.file.read_text())
    assert set(stored) == {"shoulder", "elbow"}
    assert stored["elbow"]["of"] == {"value": 0.9, "low": 0.8, "high": 1.0}
