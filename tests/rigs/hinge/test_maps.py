"""Maps of stiffness and damping over specimens: exact polynomials, refits, coverage, the simulated bench's own maps."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labrun_plugins.rigs.hinge.body import body_of
from labrun_plugins.rigs.hinge.map_findings import map_warnings
from labrun_plugins.rigs.hinge.polynomial import CONSTANT, PUBLISHED, Form, design, fit_polynomial
from swings import swing

from labrun.app.fit import fit
from labrun.app.run import run as execute
from labrun.errors import FitError, RequestError
from labrun.experiment import load_named, shipped_experiments
from labrun.models import load_model

PLATE = shipped_experiments() / "models" / "hinge-specimens.toml"
WIDTHS = np.array([20.0, 30.0, 40.0, 50.0, 60.0]) * 1e-3
LINES = {
    "w": np.array([*WIDTHS, *[50e-3] * 10]),
    "l": np.array([*[1.75e-3] * 5, 1e-3, 1.75e-3, 2.5e-3, 3.25e-3, 4e-3, *[1.75e-3] * 5]),
    "a": np.array([*[43e-4] * 10, 20e-4, 30e-4, 55e-4, 70e-4, 85e-4]),
}


def truth(quantity, sizes):
    whole = (
        PUBLISHED["damping", ("a", "l", "w")] if quantity == "damping" else PUBLISHED["stiffness", ("l", "w")]
    )
    columns = design(tuple(whole.coefficients), sizes)
    return columns @ np.array(list(whole.coefficients.values()))


def fitted(form, sizes, values, *, seed=0, scatter=0.0, releases=5, between_releases=0.0):
    rng = np.random.default_rng(seed)
    of = [
        mean * (1 + scatter * rng.standard_normal()) * (1 + between_releases * rng.standard_normal(releases))
        for mean in values
    ]
    return fit_polynomial(form, sizes, of, rng=rng)


@given(
    coefficients=st.lists(st.floats(-10, 10), min_size=7, max_size=7),
    shift=st.floats(0.8, 1.2),
)
@settings(max_examples=30)
def test_an_exact_polynomial_comes_back_in_metres_and_square_metres(coefficients, shift):
    form = Form.of("damping", ("w", "l", "a"))
    sizes = {name: shift * values for name, values in LINES.items()}
    values = design(form.terms, sizes) @ np.array(coefficients)
    polynomial = fit_polynomial(
        form, sizes, [np.full(2, value) for value in values], rng=np.random.default_rng(0)
    )
    np.testing.assert_allclose(polynomial.fitted, values, atol=1e-12)
    # a coefficient is known as well as its term's share of the map
    reach = np.abs(design(form.terms, sizes)).max(axis=0)
    np.testing.assert_allclose(polynomial.coefficients * reach, coefficients * reach, atol=1e-9)


def test_leaving_a_specimen_out_is_a_fit_without_it():
    form = Form.of("damping", ("a", "l", "w"))
    result = fitted(form, LINES, truth("damping", LINES), scatter=0.03)
    for index in range(len(result.measured)):
        kept = np.arange(len(result.measured)) != index
        rest = fit_polynomial(
            form,
            {name: values[kept] for name, values in LINES.items()},
            [np.full(2, value) for value in result.measured[kept]],
            rng=np.random.default_rng(0),
        )
        there = rest.value({name: values[index : index + 1] for name, values in LINES.items()})[0]
        assert result.left_out_error[index] == pytest.approx(result.measured[index] - there, rel=1e-6)


def test_intervals_hold_the_truth_where_mountings_differ_and_releases_alone_do_not():
    form, sizes = Form.of("damping", ("w",)), {"w": WIDTHS}
    values = truth("damping", {"w": WIDTHS, "l": np.full(5, 1.75e-3), "a": np.full(5, 43e-4)})
    exact = fitted(form, sizes, values).coefficients
    whole, alone = [], []
    for seed in range(150):
        result = fitted(form, sizes, values, seed=seed, scatter=0.0315, between_releases=0.005)
        whole.append((result.intervals[:, 0] <= exact) & (exact <= result.intervals[:, 1]))
        alone.append((result.by_releases[:, 0] <= exact) & (exact <= result.by_releases[:, 1]))
    assert 0.88 < np.mean(whole) < 0.995
    assert np.mean(alone) < 0.5


def test_the_regressors_are_well_conditioned_only_once_centred_and_scaled():
    result = fitted(Form.of("damping", ("a", "l", "w")), LINES, truth("damping", LINES))
    assert result.condition < 20
    assert result.raw_condition > 1e5


def test_sizes_that_change_together_leave_coefficients_open_and_they_are_named():
    form = Form.of("stiffness", ("l", "w"))
    sizes = {"w": WIDTHS, "l": WIDTHS / 20}
    result = fitted(form, sizes, np.linspace(0.01, 0.02, 5), between_releases=0.01)
    assert result.estimates.keys() == {"k_0"}
    text = " ".join(map_warnings(result))
    for name in ("k_w", "k_w2", "k_l", "k_l2"):
        assert name in text
    assert "do not determine" in text


def test_as_many_coefficients_as_specimens_are_told_and_only_releases_say_how_sure_they_are():
    result = fitted(
        Form.of("stiffness", ("w",)), {"w": WIDTHS[:3]}, [0.005, 0.008, 0.011], between_releases=0.01
    )
    assert result.freedom == 0
    assert not np.isfinite(result.left_out_mae)
    assert np.isfinite(result.intervals).all()
    assert any("nothing is left to judge it by" in text for text in map_warnings(result))
    with pytest.raises(FitError, match="one release each"):
        fitted(Form.of("stiffness", ("w",)), {"w": WIDTHS[:3]}, [0.005, 0.008, 0.011], releases=1)


def test_two_degrees_of_freedom_and_coefficients_that_may_be_zero_are_told():
    straight = 0.01 + 0.1 * WIDTHS
    result = fitted(Form.of("stiffness", ("w",)), {"w": WIDTHS}, straight, scatter=0.02, seed=0)
    text = " ".join(map_warnings(result))
    assert "2 degrees of freedom" in text
    assert "k_w2 and k_w are not distinguishable from zero separately" in text


def test_a_map_that_turns_negative_between_specimens_is_told_with_the_place():
    sizes = {"w": np.array([10.0, 20.0, 50.0, 60.0]) * 1e-3}
    values = 1e-4 * ((sizes["w"] / 1e-3 - 35) ** 2 / 225 - 0.5)
    result = fitted(Form.of("damping", ("w",)), sizes, values, between_releases=0.001)
    assert result.measured.min() > 0
    (text,) = [text for text in map_warnings(result) if "negative" in text]
    assert "w = 24.5 to 45.5 mm" in text


def test_the_plate_of_the_shipped_model_has_the_inertia_and_weight_of_a_plate():
    condition = {"width_mm": 30.0, "length_mm": 4.0, "area_cm2": 60.0}
    body = body_of(load_model(PLATE), condition)
    height, mass = 60e-4 / 0.05, 3.58 * 60e-4
    lever = (height + 4e-3) / 2
    assert body.inertia == pytest.approx(mass * (height**2 / 12 + lever**2), rel=1e-9)
    assert body.gravity_torque == pytest.approx(mass * 9.81 * lever, rel=1e-9)
    # twice the density is twice both: 3 % of it shifts k and b by 3 %, whatever their sizes
    density = body.by_tolerance[0]
    assert density == pytest.approx([0.03, 0.03], rel=1e-5)
    k, b = body.shift(0.01, 1e-5)
    assert b >= 0.03
    assert k == pytest.approx(0.03, abs=0.02)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("tolerance = 0.03", 'tolerance = "free"'), "leaves areal_density free"),
        (("*sin(angle)", "*angle"), "sine"),
        (("damping ", "drag "), "no parameter damping"),
    ],
)
def test_a_model_that_is_no_hinge_with_a_known_body_is_refused_by_name(tmp_path, change, words):
    text = PLATE.read_text().replace(*change)
    if "drag" in change[1]:
        text = text.replace("damping*rate", "drag*rate")
    (tmp_path / "other.toml").write_text(text)
    with pytest.raises(FitError, match=words):
        body_of(load_model(tmp_path / "other.toml"), {"length_mm": 1.75, "area_cm2": 43.0})


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """The three shipped experiments on a bench without scatter and drag: what is left is the maps."""
    results = tmp_path_factory.mktemp("results")
    quiet = (
        'rig.scene={plugin="hinge-bench", scatter=0, drag_coefficient=0}',
        "sweep.axes.release=[17, 23]",
        "trial.duration_s=5",
    )
    result = {}
    for name in ("hinge-width", "hinge-length", "hinge-area"):
        loaded = load_named(name, results, quiet)
        result[name] = execute(loaded, results=results, dry_run=True, seed=3, draw=False).run
    return result


@pytest.mark.rendered
def test_all_runs_together_give_the_benchs_own_maps_3_11_and_3_12(runs):
    width, *more = runs.values()
    result = fit(width, more=more)
    assert result.data.trials == 34
    parameters = result.parameters
    for quantity, names in (("damping", ("a", "l", "w")), ("stiffness", ("l", "w"))):
        form = Form.of(quantity, names)
        for name, term in zip(form.names, form.terms, strict=True):
            assert parameters[name].value == pytest.approx(form.published.coefficients[term], rel=0.03), name
            assert parameters[name].unit == form.unit(term)
    maps = json.loads((width / "fit" / "hinge-maps.json").read_text())["maps"]
    assert all(fitted_map["mae_percent"] < 0.3 for fitted_map in maps)
    (quality,) = [table for table in result.tables if "condition number" in table.title]
    assert "4.01 % (3.11)" in str(quality.rows[0])
    assert "1.39 % (3.12)" in str(quality.rows[1])
    assert result.figure.stat().st_size > 20_000


def test_one_run_gives_the_maps_over_its_own_size_beside_the_published_ones(runs):
    over_width, over_area = fit(runs["hinge-width"]), fit(runs["hinge-area"])
    assert set(over_width.parameters) == {"b_w2", "b_w", "b_0", "k_w2", "k_w", "k_0"}
    assert over_width.parameters["k_w"].value == pytest.approx(0.4298, rel=0.02)
    assert fit(runs["hinge-area"]).parameters == over_area.parameters
    assert set(over_area.parameters) == {"b_a2", "b_a", "b_0"}
    assert any("the hinge is one" in text for text in over_area.findings)
    assert any("(3.6)" in text and "(3.11)" in text for text in over_area.findings)
    by_fourier = fit(runs["hinge-width"], settings={"way": "fourier"})
    assert by_fourier.parameters["k_w"].value == pytest.approx(over_width.parameters["k_w"].value, rel=0.02)
    assert by_fourier.parameters["k_w"].value != over_width.parameters["k_w"].value


def test_the_same_run_twice_would_count_double_and_is_refused(runs):
    run = runs["hinge-width"]
    with pytest.raises(RequestError, match="named twice"):
        fit(run, more=[run / "run.h5"])


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """CSV recordings of three hinges by another integrator; their conditions name the width only."""
    folder = tmp_path / "hinges"
    folder.mkdir()
    body = body_of(load_model(PLATE), {"length_mm": 1.75, "area_cm2": 43.0})
    tables = ['experiment = "hinges"', '[channels.angle]\nkind = "output"\nunit = "rad"']
    for width_mm, k in ((30, 0.008), (40, 0.0113), (50, 0.0143)):
        for number in range(2):
            time_s, angle = swing(
                0.3 + 0.1 * number,
                stiffness=k, damping=1e-6 * width_mm,
                inertia=body.inertia, gravity=body.gravity_torque,
                duration_s=4.0, rate_hz=120.0,
            )  # fmt: skip
            name = f"{width_mm}-{number}.csv"
            np.savetxt(
                folder / name,
                np.column_stack([time_s, angle]),
                delimiter=",",
                header="time_s,angle",
                comments="",
            )
            tables.append(
                f'[[trials]]\nfile = "{name}"\ncondition = {{ width_mm = {width_mm} }}\nrepeat = {number + 1}'
            )
    (folder / "recording.toml").write_text("\n".join(tables))
    (folder / "model.toml").write_text(PLATE.read_text())
    return folder


def test_recordings_take_sizes_that_conditions_lack_from_the_settings(recording, tmp_path):
    stated = {"length_mm": 1.75, "area_cm2": 43}
    result = fit(recording, method="hinge-maps", settings=stated, results=tmp_path / "results")
    at = {"w": np.array([30e-3, 40e-3, 50e-3])}
    form = Form.of("stiffness", ("w",))
    coefficients = np.array([result.parameters[name].value for name in form.names])
    np.testing.assert_allclose(design(form.terms, at) @ coefficients, [0.008, 0.0113, 0.0143], rtol=1e-3)
    assert any("fewer than 5 releases" in text for text in result.warnings)
    with pytest.raises(RequestError, match="does not say area_cm2") as error:
        fit(recording, method="hinge-maps", settings={"length_mm": 1.75}, results=tmp_path / "results")
    assert "--set area_cm2=" in error.value.hint
    with pytest.raises(RequestError, match="width_m"):
        fit(recording, method="hinge-maps", settings={**stated, "widht_mm": 3}, results=tmp_path / "results")


def test_specimens_of_one_size_are_no_map(recording, tmp_path):
    text = (recording / "recording.toml").read_text()
    (recording / "recording.toml").write_text(text.replace("width_mm", "piece"))
    stated = {"width_mm": 40, "length_mm": 1.75, "area_cm2": 43}
    with pytest.raises(FitError, match="same dimensions") as error:
        fit(recording, method="hinge-maps", settings=stated, results=tmp_path / "results")
    assert "--model hinge" in error.value.hint


def test_the_constant_is_the_last_term_of_every_form():
    assert all(Form.of(quantity, names).terms[-1] == CONSTANT for quantity, names in PUBLISHED)
