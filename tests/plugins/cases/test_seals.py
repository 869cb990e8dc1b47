"""Same seed, same cases; answers are what was sealed, or it is told."""

import json
from pathlib import Path

from generating_cases import Done, Generate, generate_apart
from labrun_plugins.cases.writing import seal, verify

Made = tuple[Path, Done]


def contents(folder: Path) -> dict[str, bytes]:
    """Return every file that does not depend on the salt."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in ("salt.txt", "seal.json")
    }


def copy_of(folder: Path, to: Path) -> Path:
    for name, content in contents(folder).items():
        (to / name).parent.mkdir(parents=True, exist_ok=True)
        (to / name).write_bytes(content)
    for name in ("seal.json", "sealed/salt.txt"):
        (to / name).write_bytes((folder / name).read_bytes())
    return to


def test_the_seal_is_the_first_and_only_thing_on_standard_output(made: Made) -> None:
    folder, done = made
    seal = json.loads((folder / "seal.json").read_text())
    assert done.stdout.count("\n") == 1
    assert done.stdout.startswith(f"seal {seal['all']} ")


def test_same_seed_same_bytes_whatever_the_workers_and_the_first_case(made: Made, tmp_path: Path) -> None:
    folder, _ = made
    done = generate_apart(
        "--cases", "2", "--first", "2", "--seed", "12", "--workers", "2", "--out", str(tmp_path / "again")
    )
    assert done.returncode == 0, done.stderr
    again = contents(tmp_path / "again")
    assert again
    assert again == {name: bytes_ for name, bytes_ in contents(folder).items() if "case-0001" not in name}


def test_a_case_has_as_many_conditions_and_repeats_as_are_asked_for(
    run_generator: Generate, tmp_path: Path
) -> None:
    done = run_generator(
        "--cases", "1", "--only", "control", "--conditions", "12", "--repeats", "2", "--out", str(tmp_path / "made")
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "made" / "cases" / "case-0001").glob("trial*.csv"))) == 24
    answer = json.loads((tmp_path / "made" / "sealed" / "case-0001.json").read_text())
    assert (answer["conditions"], answer["repeats"]) == (12, 2)
    for wrong in (("--conditions", "0"), ("--condition", "12")):
        assert run_generator(*wrong, "--out", str(tmp_path / "none")).returncode == 2


def test_one_kind_alone_is_made_of_cases_that_the_mixture_of_the_same_seed_does_not_have(
    made: Made, run_generator: Generate, tmp_path: Path
) -> None:
    kinds = {}
    for only in ("control", "effect"):
        folder = tmp_path / only
        done = run_generator("--cases", "1", "--seed", "12", "--only", only, "--out", str(folder))
        assert done.returncode == 0, done.stderr
        assert f", {only} alone;" in done.stdout
        kinds[only] = json.loads((folder / "sealed" / "case-0001.json").read_text())
    assert [answer["kind"] for answer in kinds.values()] == ["control", "effect"]
    mixed = json.loads((made[0] / "sealed" / "case-0001.json").read_text())
    truths = [kind["true_parameters"] for kind in (mixed, *kinds.values())]
    assert all(truths.count(truth) == 1 for truth in truths)


def test_a_kind_that_the_mixture_does_not_have_is_refused(run_generator: Generate, tmp_path: Path) -> None:
    done = run_generator("--cases", "1", "--only", "controls", "--out", str(tmp_path / "none"))
    assert done.returncode == 2
    assert "invalid choice: 'controls'" in done.stderr


def test_a_seal_depends_on_the_answers_and_on_the_salt_only(made: Made, tmp_path: Path) -> None:
    folder = copy_of(made[0], tmp_path / "copy")
    salt = (folder / "sealed" / "salt.txt").read_text().strip()
    before = json.loads((folder / "seal.json").read_text())
    assert seal(folder, salt) == before
    other = seal(folder, "another salt")
    assert other["all"] != before["all"]
    assert set(other["cases"].values()).isdisjoint(before["cases"].values())
    assert verify(folder) == []


def test_untouched_answers_verify(made: Made, run_generator: Generate) -> None:
    folder, _ = made
    assert run_generator("--verify", str(folder)).returncode == 0


def test_a_changed_answer_is_found_and_named(made: Made, run_generator: Generate, tmp_path: Path) -> None:
    folder = copy_of(made[0], tmp_path / "changed")
    path = folder / "sealed" / "case-0002.json"
    answer = json.loads(path.read_text())
    answer["causes"] = [{"kind": "effect", "effect": "backlash", "site": "hinge"}]
    path.write_text(json.dumps(answer, indent=1) + "\n")
    done = run_generator("--verify", str(folder))
    assert done.returncode == 1
    assert "case-0002.json: changed after it was sealed" in done.stdout
    assert "case-0001" not in done.stdout


def test_a_missing_an_added_and_a_resealed_answer_are_found(
    made: Made, run_generator: Generate, tmp_path: Path
) -> None:
    folder = copy_of(made[0], tmp_path / "changed")
    (folder / "sealed" / "case-0003.json").rename(folder / "sealed" / "case-0004.json")
    seal = json.loads((folder / "seal.json").read_text())
    seal["cases"]["case-0001"] = "0" * 64
    (folder / "seal.json").write_text(json.dumps(seal))
    done = run_generator("--verify", str(folder))
    assert done.returncode == 1
    assert "case-0003 is missing" in done.stdout
    assert "not in the seal" in done.stdout
    assert "hash over all" in done.stdout


def test_it_does_not_write_into_a_folder_that_has_something_in_it(
    run_generator: Generate, tmp_path: Path
) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    done = run_generator("--cases", "1", "--seed", "12", "--out", str(tmp_path))
    assert done.returncode == 2
    assert "not empty" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_what_a_diagnosis_sees_does_not_tell_the_answer(made: Made) -> None:
    folder, _ = made
    for path in sorted((folder / "cases").iterdir()):
        answer = json.loads((folder / "sealed" / f"{path.name}.json").read_text())
        seen = (path / "recording.toml").read_text() + (path / "model.toml").read_text()
        for cause in answer["causes"]:
            if cause["kind"] == "effect":
                assert cause["effect"] not in seen
        assert "seed" not in seen
        assert sorted({other.suffix for other in path.iterdir()}) == [".csv", ".toml"]
