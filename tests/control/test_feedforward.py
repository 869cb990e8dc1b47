"""Feed-forward from a model, inline or from a file."""

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from labrun.control.pid import FeedforwardPid
from labrun.control.plant import PlantModel, read_plant
from labrun.control.protocol import LoopContext, Step
from labrun.errors import SpecError
from labrun.fit.transfer import TransferFunction

CONTEXT = LoopContext(0.05, 0.0, 60.0, 20.0)
MODEL = {"gain": 0.00912, "lag_s": 0.34, "dead_s": 0.28}


def at(time_s, reference, feedback):
    return Step(time_s, 0.05, reference(time_s), feedback, 20.0, reference)


@given(st.floats(0.05, 0.5), st.floats(-0.2, 0.2), st.floats(0, 200))
def test_the_output_is_the_inverse_gain_plus_p_on_the_error(reference, error, p):
    controller = FeedforwardPid({"p": p, "model": MODEL}, CONTEXT)
    output = controller.update(at(3.0, lambda _: reference, reference - error))
    assert output == pytest.approx(reference / 0.00912 + p * error)


def test_an_exact_model_needs_no_feedback_to_settle_where_it_should():
    controller = FeedforwardPid({"model": MODEL}, CONTEXT)
    assert 0.00912 * controller.update(at(0.0, lambda _: 0.3, 0.3)) == pytest.approx(0.3)


@pytest.mark.parametrize(("lead_s", "seen_at_s"), [(0.0, 5.0), (1.5, 6.5), ("dead", 5.28)])
def test_the_feedforward_looks_ahead_on_the_reference(lead_s, seen_at_s):
    controller = FeedforwardPid({"model": MODEL, "lead_s": lead_s}, CONTEXT)
    assert controller.update(at(5.0, lambda time_s: time_s, 5.0)) == pytest.approx(seen_at_s / 0.00912)


def test_a_transfer_function_is_inverted_at_zero_frequency():
    model = {"numerator": [1.0, 3.0], "denominator": [2.0, 1.0, 6.0], "dead_s": 0.1}
    assert PlantModel.model_validate(model).static_gain == 0.5


def test_a_fitted_model_is_read_from_its_file_whatever_else_stands_there(tmp_path):
    path = tmp_path / "fopdt.toml"
    path.write_text(
        'gain = 0.009\nlag_s = 0.3\ndead_s = 0.2\nunit = "N/deg"\n[interval]\ngain = [0.008, 0.01]\n'
    )
    embedded = FeedforwardPid.embed({"p": 1.0, "model": "fopdt.toml"}, lambda name: tmp_path / name)
    assert embedded["model"] == {"gain": 0.009, "lag_s": 0.3, "dead_s": 0.2}
    assert FeedforwardPid(embedded, CONTEXT).update(at(0.0, lambda _: 0.18, 0.18)) == pytest.approx(20.0)


RESPONSES = """
[magnitude]
gain = 0.009
lag_s = 0.3
dead_s = 0.2
gain_ci95 = [0.008, 0.01]
input_unit = "deg"

[angle]
numerator = [-0.9]
denominator = [0.1, 0.5, 1.0]
dead_s = 0.0
"""


def test_a_fit_of_several_responses_is_read_by_the_response(tmp_path):
    (tmp_path / "fopdt.toml").write_text(RESPONSES)

    def embedded(**keys):
        return FeedforwardPid.embed({"model": "fopdt.toml", **keys}, lambda name: tmp_path / name)

    assert embedded(response="magnitude") == {"model": {"gain": 0.009, "lag_s": 0.3, "dead_s": 0.2}}
    assert embedded(response="angle")["model"]["denominator"] == [0.1, 0.5, 1.0]
    with pytest.raises(SpecError, match=r"holds 2 responses: magnitude, angle\n.*response = \"magnitude\""):
        embedded()
    with pytest.raises(SpecError, match=r'no response "magnitud"\n.*magnitude'):
        embedded(response="magnitud")


def test_the_only_response_of_a_file_needs_no_name(tmp_path):
    path = tmp_path / "fopdt.toml"
    path.write_text(RESPONSES.partition("[angle]")[0])
    assert read_plant(path) == {"gain": 0.009, "lag_s": 0.3, "dead_s": 0.2}


def test_what_the_fit_writes_is_what_the_feedforward_reads(tmp_path):
    fitted = TransferFunction.first_order(
        0.009, 0.3, 0.2, input_name="gait.a", input_unit="deg", output_unit="N"
    )
    path = tmp_path / "fopdt.toml"
    path.write_text(f"# labrun fit\n\n[magnitude]\n{tomli_w.dumps(fitted.to_table())}")
    assert read_plant(path, "magnitude") == {"gain": 0.009, "lag_s": 0.3, "dead_s": 0.2}


def test_a_response_of_an_inline_model_is_refused():
    with pytest.raises(SpecError, match="written inline"):
        FeedforwardPid({"model": MODEL, "response": "magnitude"}, CONTEXT)


def test_a_file_that_is_no_fitted_response_is_refused(tmp_path):
    path = tmp_path / "other.toml"
    path.write_text("stiffness = 3\n")
    with pytest.raises(SpecError, match="neither gain nor numerator"):
        read_plant(path)
    with pytest.raises(SpecError, match="cannot be read"):
        read_plant(tmp_path / "absent.toml")


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ({"lag_s": 1.0}, "needs its gain"),
        ({"gain": 0.0}, "cannot be inverted"),
        ({"numerator": [1.0]}, "both"),
        ({"numerator": [1.0], "denominator": [1.0, 0.0]}, "no static gain"),
        ({"gain": 1.0, "lag_ms": 3.0}, "lag_s"),
    ],
)
def test_a_model_that_cannot_be_inverted_says_why(model, message):
    with pytest.raises(SpecError, match=message):
        FeedforwardPid({"model": model}, CONTEXT)
