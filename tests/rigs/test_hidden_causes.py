"""What is hidden in a rig's bench is found from the rig's own experiment, and nothing where nothing is hidden."""

import pytest

import labrun
from labrun.app.diagnose import reveal

BEAMS = ",".join(
    f'{{beam="{beam}",specimen={specimen},reach={reach}}}'
    for beam in ("long", "short")
    for specimen in (1, 2)
    for reach in (-28.648, 28.648)
)
CAUSES = {
    "polyester-tensile": (
        (),
        ("bias@force:offset=2", "cubic-stiffness@strip:coefficient=2e9", "coulomb-friction@strip:torque=2"),
    ),
    "hinge-tensile": (
        (),
        ("saturation@force:level=110", "bias@force:offset=2", "cubic-stiffness@strip:coefficient=-4e6"),
    ),
    "hinge-life": (
        ("trial.until.max_cycles=300",),
        (
            "cubic-stiffness@hinge:coefficient=0.0006",
            "saturation@torque_z:level=0.1",
            "asymmetric-stiffness@hinge:excess=0.0016",
        ),
    ),
    "hinge-repeatability": (
        (),
        (
            "backlash@hinge:gap=0.0033",
            "rest-offset@hinge:offset=0.03",
            "coulomb-friction@hinge:torque=0.00075",
        ),
    ),
    "fin-materials": (
        (),
        ("drag-error@fin:coefficient=0.12", "delay@tail:delay=0.05", "cross-talk@torque_x:share=-0.3"),
    ),
    "fin-trace": (
        (),
        ("cross-talk@torque_x:share=-0.3", "delay@tail:delay=0.05", "drag-error@fin:coefficient=0.12"),
    ),
    "fin-amplitude": (
        ("trial.duration_s=50",),  # from the smallest amplitude to the greatest
        ("saturation@torque_y:level=0.2", "saturation@tail:level=0.52", "cross-talk@torque_x:share=-0.3"),
    ),
    "beam-buckling": (
        (f"run.conditions=[{BEAMS}]",),
        (
            "saturation@force:level=6",
            "coulomb-friction@beam:torque=0.03",
            "asymmetric-stiffness@beam:excess=-0.228",
        ),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rig", "hidden"), [(rig, hidden) for rig, (_, causes) in CAUSES.items() for hidden in causes]
)
def test_a_hidden_cause_is_named_alone_or_in_a_stated_set(rig, hidden, tmp_path):
    overrides, _ = CAUSES[rig]
    run = labrun.run(rig, dry_run=True, seed=1, overrides=overrides, hide=[hidden], results=tmp_path).run
    labrun.diagnose(run, page=False, results=tmp_path)
    compared = reveal(run, results=tmp_path)
    assert compared.score in ("right", "right, in a stated set"), compared.stored["sentence"]


@pytest.mark.slow
@pytest.mark.parametrize("rig", [*CAUSES, "six-bar"])
def test_where_nothing_is_hidden_nothing_is_announced(rig, tmp_path):
    overrides, _ = CAUSES.get(rig, ((), ()))
    run = labrun.run(rig, dry_run=True, seed=1, overrides=overrides, hide=["none"], results=tmp_path).run
    labrun.diagnose(run, page=False, results=tmp_path)
    compared = reveal(run, results=tmp_path)
    assert compared.score == "right", compared.stored["sentence"]
