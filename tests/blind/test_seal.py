"""What a dry run hides is sealed: nobody reads it by accident, resume knows it, reveal tells whether it is whole."""

import itertools
import json
import re
from pathlib import Path

import h5py
import numpy as np
import pytest

from labrun.app.resume import resume
from labrun.app.run import run as execute
from labrun.blind import Seal, named_model, redacted, reveal, write_seal
from labrun.blind.hiding import choose_hidden
from labrun.effects import effects
from labrun.errors import RecordingError, RequestError
from labrun.experiment import load_named
from labrun.runner import SilentProgress
from labrun.search import conditions
from labrun.store import open_run

SMALL = ("run.conditions=[{release=20},{release=40}]", "trial.repeats=2", "trial.duration_s=3")


def seal(folder, hidden):
    made = Seal.of(hidden)
    write_seal(folder, made)
    return made


class Notes(SilentProgress):
    """Keeps what is told."""

    def __init__(self):
        self.messages = []

    def note(self, text):
        self.messages.append(text)


def dry_run(folder, hide, *, overrides=SMALL, progress=None, name="hinge", **more):
    loaded = load_named(name, folder, list(overrides))
    return execute(
        loaded,
        results=folder / "results",
        dry_run=True,
        seed=1,
        progress=progress or SilentProgress(),
        draw=False,
        hide=hide,
        **more,
    ).run


@pytest.fixture(scope="module")
def friction(tmp_path_factory):
    return dry_run(tmp_path_factory.mktemp("bench"), ["coulomb-friction@hinge:torque=4.3217e-4"])


@pytest.fixture
def copy_of(friction, tmp_path):
    import shutil

    return Path(shutil.copytree(friction, tmp_path / "results" / "hinge" / "run"))


def everything_readable(run):
    """Return all that a person finds who looks at the files, HDF5 attributes and strings included."""
    results = []
    for path in sorted(run.rglob("*")):
        if path.is_file():
            results.append(path.read_bytes())
        if path.suffix == ".h5":
            with h5py.File(path) as file:
                results += _texts(file)
    return b"\n".join(results)


def _texts(file):
    texts = []

    def take(name, item):
        texts.append(name.encode())
        texts.extend(f"{key}={value!r}".encode() for key, value in item.attrs.items())
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "OSU":
            texts.append(repr(item[()]).encode())

    take("/", file)
    file.visititems(take)
    return texts


def ids_of(hidden):
    """Return the names that would give the answer away; not those that stand in any experiment file."""
    harmless = {
        "angle",
        "damping",
        "stiffness",
        "inertia",
        "torque",
        "force",
        "gap",
        "offset",
        "upper",
        "lower",
    }
    return (
        {effect.effect for effect in hidden} | {name for effect in hidden for name in effect.values}
    ) - harmless


def test_reveal_tells_what_was_hidden_and_that_nobody_had_looked(copy_of):
    result = reveal(copy_of)
    (effect,) = result.hidden
    assert (effect.effect, effect.site, effect.kind) == ("coulomb-friction", "hinge", "joint")
    assert effect.values["torque"] == 4.3217e-4
    assert effect.units["torque"] == "N m"
    assert result.opened_before == ()
    assert "coulomb-friction at hinge" in str(effect)


def test_a_parameter_can_be_hidden_and_nothing_readable_tells_of_it(tmp_path):
    run = dry_run(tmp_path, ["stiffness=0.0173205"])
    assert b"0.01732" not in everything_readable(run)
    result = reveal(run)
    (effect,) = result.hidden
    assert (effect.kind, effect.effect, effect.values) == ("parameter", "stiffness", {"stiffness": 0.0173205})
    assert "parameter stiffness = 0.01732 N m/rad" in str(effect)
    plain = dry_run(tmp_path / "plain", ["none"])
    bent, straight = (_angles(open_run(drawn_run))[0] for drawn_run in (run, plain))
    count = min(len(bent), len(straight))
    assert np.abs(bent[:count] - straight[:count]).max() > 0.05


def test_a_second_look_tells_of_the_first(copy_of):
    reveal(copy_of)
    again = reveal(copy_of)
    assert len(again.opened_before) == 1
    assert again.to_json()["opened_before"] == list(again.opened_before)


def test_the_packed_file_of_a_run_is_as_good_a_name_for_it_as_its_folder(copy_of):
    assert reveal(copy_of / "run.h5").hidden == reveal(copy_of).hidden


def test_nothing_of_the_answer_stands_in_the_run_folder_as_a_person_reads_it(friction):
    text = everything_readable(friction)
    for word in ("coulomb", "friction", "transition_speed", "43217"):
        assert word.encode() not in text, word
    assert "sealed_sha256" in json.loads((friction / "provenance.json").read_text())


def test_a_run_that_is_not_packed_yet_tells_no_more_than_a_finished_one(tmp_path):
    run = dry_run(tmp_path, ["viscoelastic-creep@hinge"], limit=2)
    assert list((run / "trials").glob("*.h5"))
    text = everything_readable(run)
    assert b"creep" not in text
    assert b"time_constant" not in text
    # the memory of the bench, which has a place for the state of the effect, is no plain text either
    checkpoint = next(iter(json.loads(line) for line in _checkpoints(run)))
    assert list(checkpoint["scene"]) == ["sealed"]


def _checkpoints(run):
    from labrun.store import RunFolder

    return [outcome.checkpoint for outcome in RunFolder(run).outcomes().values()]


def test_of_what_is_drawn_nothing_is_told_in_the_folder_or_to_the_person(tmp_path):
    progress = Notes()
    run = dry_run(tmp_path, ["random"], progress=progress, hide_seed=2)
    result = reveal(run)
    assert result.hidden
    text = everything_readable(run) + "\n".join(progress.messages).encode()
    for word in ids_of(result.hidden):
        assert not re.search(rb"(?<![\w-])" + re.escape(word.encode()) + rb"(?![\w-])", text), word
    assert any(result.sha256[:16] in line for line in progress.messages)


@pytest.mark.parametrize("hide", [["none"], ["coulomb-friction@hinge", "bias@angle"]])
def test_the_length_of_a_seal_does_not_tell_how_much_it_holds(tmp_path, hide):
    first = seal(tmp_path, [])
    hidden = choose_hidden(hide, load_named("hinge", tmp_path, []).experiment, None, [])
    assert len(seal(tmp_path, hidden).answer) == len(first.answer)


def test_a_run_without_hide_has_nothing_to_reveal(tmp_path):
    run = dry_run(tmp_path, [])
    assert not (run / "seal.json").exists()
    with pytest.raises(RecordingError, match="nothing is sealed"):
        reveal(run)


def test_that_nothing_is_hidden_is_an_answer_too(tmp_path):
    run = dry_run(tmp_path, ["none"])
    result = reveal(run)
    assert result.hidden == ()


def test_what_is_no_run_has_no_seal(tmp_path):
    with pytest.raises(RecordingError, match="not a run folder"):
        reveal(tmp_path)


def _changed(run, **keys):
    path = run / "seal.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **keys}))


def test_another_answer_under_the_old_hash_is_found_out(copy_of, tmp_path):
    other = seal(tmp_path, [])
    _changed(copy_of, answer=other.answer)
    with pytest.raises(RecordingError, match="not the one that its hash was made of"):
        reveal(copy_of)


def test_another_seal_altogether_is_found_out(copy_of):
    seal(copy_of, [])
    with pytest.raises(RecordingError, match="not the seal that the run began with"):
        reveal(copy_of)


@pytest.mark.parametrize("broken", ["", "{}", '{"sha256": "0", "answer": "%%"}'])
def test_a_seal_that_is_no_seal_is_a_clear_error(copy_of, broken):
    (copy_of / "seal.json").write_text(broken)
    with pytest.raises(RecordingError, match="seal is broken"):
        reveal(copy_of)


def test_an_answer_that_cannot_be_decoded_is_a_clear_error(copy_of):
    _changed(copy_of, answer="aGVsbG8=")
    with pytest.raises(RecordingError, match="cannot be decoded"):
        reveal(copy_of)


def test_a_seal_that_is_gone_is_missed_by_reveal_and_by_resume(tmp_path):
    run = dry_run(tmp_path, ["coulomb-friction@hinge"], limit=1)
    (run / "seal.json").unlink()
    with pytest.raises(RecordingError, match="is gone"):
        reveal(run)
    with pytest.raises(RecordingError, match="is gone"):
        resume(run, draw=False)


def _angles(run):
    return [run.signals(outcome.index)["cameras"].column("angle") for outcome in run.outcomes]


def test_a_resumed_run_hides_what_it_began_with_and_ends_as_if_it_had_never_stopped(tmp_path):
    hide = ["presliding-friction@hinge", "lag@angle"]
    whole = dry_run(tmp_path, hide)
    stopped = dry_run(tmp_path, hide, limit=2)
    assert len(list(stopped.glob("trials/*.h5"))) == 2
    resume(stopped, draw=False)
    for ours, theirs in zip(_angles(open_run(stopped)), _angles(open_run(whole)), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert reveal(stopped).hidden == reveal(whole).hidden


def test_resuming_is_not_opening(tmp_path):
    run = dry_run(tmp_path, ["random"], limit=1)
    resume(run, draw=False)
    assert reveal(run).opened_before == ()


def test_hiding_changes_what_is_measured_and_nothing_else_of_the_run(tmp_path):
    plain, friction = dry_run(tmp_path, ["none"]), dry_run(tmp_path, ["coulomb-friction@hinge:torque=4e-4"])
    assert (plain / "spec.toml").read_text() == (friction / "spec.toml").read_text()
    ours, theirs = _angles(open_run(plain))[0], _angles(open_run(friction))[0]
    assert np.abs(ours - theirs).max() > 0.05


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """What the seeds 0, 1 and 2 draw for the small experiment."""
    loaded = load_named("hinge", tmp_path_factory.mktemp("drawn"), list(SMALL))
    model, where = named_model(loaded), conditions(loaded.experiment)
    return [choose_hidden(["random"], loaded.experiment, model, where, seed=number) for number in range(3)]


def test_the_same_hide_seed_draws_the_same_and_another_something_else(drawn, tmp_path):
    hidden = reveal(dry_run(tmp_path, ["random"], hide_seed=2)).hidden
    assert [(effect.effect, effect.site, effect.values) for effect in hidden] == [
        (hidden["effect"], hidden["site"], hidden["values"]) for hidden in drawn[2]
    ]
    assert len({json.dumps(drawn_run) for drawn_run in drawn}) > 1


def test_a_hidden_effect_is_one_of_the_library_at_a_site_of_the_model(drawn):
    known = {(effect.id, effect.kind) for effect in effects()}
    for hidden in itertools.chain(*drawn):
        assert (hidden["effect"], hidden["kind"]) in known
        assert hidden["site"] in ("hinge", "angle")


@pytest.mark.parametrize(
    ("hide", "message"),
    [
        (["coulomb-frction@hinge"], "coulomb-friction"),
        (["coulomb-friction@hing"], 'did you mean "hinge'),
        (["coulomb-friction"], "EFFECT@SITE"),
        (["coulomb-friction@hinge:torqe=1"], "torque"),
        (["coulomb-friction@hinge:torque=much"], "not name=number"),
        (["coulomb-friction@angle"], "sits at joint sites"),
        (["delay@hinge"], "not at a joint site"),
        (["random", "none"], "stands alone"),
        (["stifness=0.02"], 'did you mean "stiffness'),
        (["stiffness=soft"], "not name=number"),
        (["stiffness=0.02", "none"], "stands alone"),
    ],
)
def test_what_cannot_be_hidden_is_refused_before_anything_runs(tmp_path, hide, message):
    with pytest.raises(RequestError, match=re.escape(message)):
        dry_run(tmp_path, hide)
    assert not (tmp_path / "results").exists()


def test_a_real_bench_hides_nothing_on_request(tmp_path):
    with pytest.raises(RequestError, match="--dry-run"):
        execute(
            load_named("hinge", tmp_path, []),
            results=tmp_path,
            dry_run=False,
            draw=False,
            hide=["random"],
        )


def test_hiding_in_the_open_and_under_seal_do_not_mix(tmp_path):
    open_hide = 'rig.scene.hide=[{effect="coulomb-friction", site="hinge"}]'
    with pytest.raises(RequestError, match="in the open already"):
        dry_run(tmp_path, ["random"], overrides=[*SMALL, open_hide])


def test_an_experiment_without_a_model_has_nothing_to_draw_from(tmp_path):
    with pytest.raises(RequestError, match="names no model"):
        dry_run(tmp_path, ["random"], name="turn-torque", overrides=())


def test_the_stored_command_line_keeps_the_secret():
    line = ["labrun", "run", "hinge", "--hide", "backlash@hinge", "--seed", "1", "--hide=lag@angle"]
    assert redacted(line) == [
        "labrun",
        "run",
        "hinge",
        "--hide",
        "(sealed)",
        "--seed",
        "1",
        "--hide=(sealed)",
    ]


def test_a_further_run_can_use_the_bench_of_an_earlier_one_without_opening_its_seal(copy_of, tmp_path):
    again = dry_run(tmp_path, [f"same-as:{copy_of}"], overrides=[*SMALL, "trial.repeats=1"])
    assert not json.loads((copy_of / "seal.json").read_text()).get("opened")
    assert reveal(again).hidden == reveal(copy_of).hidden


def test_a_run_that_hides_nothing_under_seal_has_no_bench_to_use_again(tmp_path):
    plain = dry_run(tmp_path, [], overrides=[*SMALL, "trial.repeats=1"])
    with pytest.raises(RequestError, match="hides nothing under seal"):
        dry_run(tmp_path, [f"same-as:{plain}"])
