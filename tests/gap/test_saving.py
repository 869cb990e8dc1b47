"""The corrected model is a model: a second diagnosis finds nothing left, and a dry run swings like the bench."""

from dataclasses import replace

import pytest
from diagnosing import diagnose

from labrun.app.diagnose import StoredDiagnosis, save, store
from labrun.app.run import run as execute
from labrun.errors import RequestError, StoreError
from labrun.experiment import load_named
from labrun.gap.diagnose import Options
from labrun.gap.diagnosis import ResampledNumber
from labrun.gap.saving import require_new, save_model
from labrun.models import load_model

from .benches import among

SMALL = (
    "run.conditions=[{release=15},{release=45}]",
    "trial.repeats=2",
    "trial.duration_s=2",
)
QUICK = Options(places=False)


def dry_run(folder, hide, *more):
    loaded = load_named("hinge", folder, [*SMALL, *more])
    return execute(loaded, results=folder / "results", dry_run=True, seed=3, draw=False, hide=hide).run


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    run = dry_run(folder, ["coulomb-friction@hinge:torque=3e-4"])
    diagnosis = diagnose(run, options=among("coulomb-friction", "lag"))
    model = folder / "corrected.toml"
    save_model(diagnosis.to_json(), "hinge-pendulum", model)
    return folder, run, diagnosis, model


def test_the_hidden_friction_is_found_in_the_run(bench):
    _, _, diagnosis, _ = bench
    named = {str(diagnosis.causes[0].name), *map(str, diagnosis.causes[0].indistinguishable_from)}
    assert "coulomb-friction at hinge" in named


@pytest.mark.slow
def test_a_second_diagnosis_with_the_corrected_model_finds_nothing_left(bench):
    _, run, _, model = bench
    again = diagnose(run, model=model, options=QUICK)
    assert again.causes == ()
    assert again.verdict == "no-gap"


def test_the_corrected_model_says_what_it_was_corrected_by(bench):
    *_, model = bench
    assert "orrected" in model.read_text()
    assert [effect.effect.id for effect in load_model(model).effects]


def test_a_ratio_is_written_without_a_unit(bench, tmp_path):
    _, _, diagnosis, _ = bench
    cause = replace(diagnosis.causes[0], values={"share": ResampledNumber(0.1, 0.09, 0.11, "1")})
    save_model(replace(diagnosis, causes=(cause,)).to_json(), "hinge-pendulum", tmp_path / "saved.toml")
    assert "share = 0.1 [0.09, 0.11]\n" in (tmp_path / "saved.toml").read_text()


@pytest.mark.slow
def test_a_dry_run_of_the_corrected_model_lacks_nothing_at_the_hinge(bench):
    folder, _, _, model = bench
    of_model = dry_run(folder, [], f'rig.scene={{plugin="hinge-bench", model="{model}"}}')
    compared = diagnose(of_model, model=model, options=QUICK)
    bare = diagnose(of_model, options=QUICK)
    # the release falls between two frames of the cameras: some of a frame's delay is there to be seen
    assert not any(cause.name.site == "hinge" for cause in compared.causes)
    assert bare.gap.recalibrated > 3.0 * compared.gap.recalibrated


def test_a_model_that_cannot_be_this_bench_is_refused(tmp_path):
    other = 'rig.scene={plugin="hinge-bench", model="hinge-specimens"}'
    with pytest.raises(Exception, match=r"cannot be the hinge bench|condition"):
        dry_run(tmp_path, [], other)


def test_a_file_that_is_there_is_not_overwritten(bench):
    _, _, diagnosis, model = bench
    with pytest.raises(RequestError, match="there already"):
        save_model(diagnosis.to_json(), "hinge-pendulum", model)


def test_a_folder_that_takes_no_file_is_told_before_a_model_is_made(bench, tmp_path, monkeypatch):
    _, _, diagnosis, _ = bench

    def refused(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refused)
    with pytest.raises(StoreError, match=r"saved\.toml could not be written to .*: Permission denied"):
        require_new(tmp_path / "saved.toml")
    with pytest.raises(StoreError, match="Permission denied"):
        save_model(diagnosis.to_json(), "hinge-pendulum", tmp_path / "saved.toml")


def test_a_disk_that_is_full_when_the_model_is_written_is_told_in_words(bench, tmp_path, monkeypatch):
    _, _, diagnosis, _ = bench

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("labrun.gap.saving.replace_durably", full)
    with pytest.raises(StoreError, match="the disk is full"):
        save_model(diagnosis.to_json(), "hinge-pendulum", tmp_path / "saved.toml")


def test_a_stored_diagnosis_gives_the_same_model(bench):
    folder, run, diagnosis, model = bench
    store(diagnosis, run / "gap", page=False, source="hinge-pendulum")
    assert save(run, folder / "saved.toml") == ""
    assert (folder / "saved.toml").read_text() == model.read_text()
    with pytest.raises(RequestError, match="there already"):
        save(run, model)


def test_parameters_that_only_imitate_what_is_missing_are_not_called_a_correction(bench, tmp_path):
    _, _, diagnosis, _ = bench
    unknown = replace(diagnosis, verdict="unexplained", causes=(), effects=())
    save_model(unknown.to_json(), "hinge-pendulum", tmp_path / "saved.toml")
    text = (tmp_path / "saved.toml").read_text()
    assert text.startswith("# Recalibrated only: the cause is not in the library.")
    assert "orrected by a diagnosis" not in text
    assert "do not rely on them elsewhere" in text
    assert load_model(tmp_path / "saved.toml").effects == ()


def test_a_model_saved_without_a_cause_comes_with_a_warning(bench, tmp_path):
    _, _, diagnosis, model = bench
    stored = StoredDiagnosis(
        replace(diagnosis, verdict="unexplained", causes=()), tmp_path / "d.json", model=model
    )
    assert "recalibrated only: the cause is not in the library" in stored.warning
    assert StoredDiagnosis(diagnosis, tmp_path / "d.json", model=model).warning == ""
    assert replace(stored, model=None).warning == ""
