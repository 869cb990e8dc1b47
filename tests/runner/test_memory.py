"""What a simulated bench remembers with a trial does not grow with the trials."""

import pytest

from labrun.errors import ExperimentError

SHORT = {
    "rig__devices__cell": None,
    "trial__settle": None,
    "trial__tare": None,
    "trial__cycles": None,
    "trial__discard_cycles": None,
    "trial__duration_s": 0.05,
    "trial__repeats": 30,
    "objectives": {},
    "gait": {"plugin": "hold", "joints": {"tail": {"angle_deg": "a"}}},
}
CONDITIONS = [{"a": 10, "f": 1.0}, {"a": 20, "f": 1.0}]


def sizes(lab):
    lab.session.measure(CONDITIONS)
    return [len(outcome.checkpoint) for outcome in lab.session.outcomes]


@pytest.mark.parametrize("scene", ["caudal-tank", "pond:Pond"])
def test_on_a_rig_without_a_sensor_it_stays_the_same_size(lab, scene):
    remembered = sizes(lab(**SHORT, rig__scene={"plugin": scene}))
    assert len(remembered) == 60
    assert max(remembered[10:]) < 2 * max(remembered[:10])


def test_a_scene_that_keeps_all_of_its_past_is_named_and_the_trials_are_kept(lab):
    lab = lab(**SHORT, rig__scene={"plugin": "pond:Hoarder"})
    with pytest.raises(
        ExperimentError, match=r"the scene pond:Hoarder returned a snapshot of .*; at most 1 MB"
    ):
        lab.session.measure(CONDITIONS)
    assert [outcome.status for outcome in lab.folder.outcomes().values()][:2] == ["done", "done"]
