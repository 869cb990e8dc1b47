"""Networks as plain arrays: what they compute, how they are stored, and what is refused."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from labrun.errors import SpecError
from labrun.learned import (
    LearnedModel,
    Network,
    Scaling,
    SlidingAffine,
    Training,
    exact_affine,
    files_of,
    from_table,
    read_learned,
    to_table,
    train,
)


def data(count=400, seed=0):
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(count, 3)) * [1.0, 0.1, 5.0] + [3.0, 0.0, -2.0]
    y = (
        x @ np.array([[1.0, -2.0], [30.0, 4.0], [0.1, 0.5]])
        + [7.0, -7.0]
        + 0.05 * rng.normal(size=(count, 2))
    )
    return x, y


def deep(seed=1):
    rng = np.random.default_rng(seed)
    sizes = [3, 4, 4, 2]
    weights = tuple(rng.normal(size=pair) for pair in itertools.pairwise(sizes))
    biases = tuple(rng.normal(size=size) for size in sizes[1:])
    x, y = data()
    return Network(weights, biases, "identity", Scaling.of(x), Scaling.of(y))


def test_exact_affine_is_what_least_squares_says_without_any_scaling():
    x, y = data()
    plain = np.column_stack([x, np.ones(len(x))])
    result = plain @ np.linalg.lstsq(plain, y, rcond=None)[0]
    np.testing.assert_allclose(exact_affine(x, y)(x), result, atol=1e-9)


def test_a_network_with_identity_activation_is_one_affine_layer_however_deep():
    x, _ = data()
    np.testing.assert_allclose(deep().collapsed()(x), deep()(x), atol=1e-9)
    with pytest.raises(ValueError, match="not an affine map"):
        Network(deep().weights, deep().biases, "tanh", deep().inputs, deep().outputs).collapsed()


@pytest.mark.parametrize("window", [50, None])
def test_a_window_that_slides_gives_what_regression_on_it_gives(window):
    x, y = data(5000)
    start, ridge = deep().collapsed(), 1e-3
    sliding = SlidingAffine(start, window, ridge)
    for part in np.array_split(np.arange(len(x)), 900):
        sliding.add(x[part], y[part])
    kept = slice(-(window or 0), None)
    z = np.column_stack([start.inputs.scaled(x[kept]), np.ones(len(x[kept]))])
    w0 = np.vstack([start.weights[0], start.biases[0]])
    target = start.outputs.scaled(y[kept])
    # ridge towards w0 as rows of data: sqrt(ridge n) (w - w0) = 0
    weight = np.sqrt(ridge * len(z)) * np.eye(4)
    wanted = np.linalg.lstsq(np.vstack([z, weight]), np.vstack([target, weight @ w0]), rcond=None)[0]
    result = np.vstack([sliding.solved().weights[0], sliding.solved().biases[0]])
    np.testing.assert_allclose(result, wanted, atol=1e-8)


def test_without_a_ridge_directions_that_no_sample_moves_in_stay_as_they_were():
    start = deep().collapsed()
    sliding = SlidingAffine(start, None, 0.0)
    x, _ = data(1)
    sliding.add(x, start(x) + 0.3)
    assert sliding.solved()(x) == pytest.approx(start(x) + 0.3)
    z = np.append(start.inputs.scaled(x)[0], 1.0)
    change = np.vstack(
        [sliding.solved().weights[0] - start.weights[0], sliding.solved().biases[0] - start.biases[0]]
    )
    across = np.eye(4) - np.outer(z, z) / (z @ z)
    assert across @ change == pytest.approx(0.0, abs=1e-9)


def test_a_sample_that_is_no_number_teaches_nothing():
    start = deep().collapsed()
    sliding = SlidingAffine(start, 50, 1e-3)
    x, y = data(40)
    sliding.add(x, y)
    before = sliding.solved().weights[0]
    sliding.add(np.full((1, 3), np.nan), y[:1])
    sliding.add(x[:1], np.full_like(y[:1], np.inf))
    assert sliding.count == 40
    assert (sliding.solved().weights[0] == before).all()


def test_identity_by_lbfgs_comes_to_exact_affine_least_squares():
    x, y = data()
    network, took_s = train(Training(hidden=(4, 4)), x, y, seed=1)
    assert took_s > 0
    errors = [np.abs(other(x) - y).mean() for other in (network, exact_affine(x, y))]
    assert errors[0] <= 1.05 * errors[1]


def test_training_goes_on_from_the_weights_it_is_given():
    x, y = data()
    begin, _ = train(Training(most_iterations=1), x, y, seed=1)
    further, _ = train(Training(most_iterations=5), x, y, seed=2, start=begin)
    before, after = (np.abs(network(x) - y).mean() for network in (begin, further))
    assert after < before
    np.testing.assert_array_equal(further.inputs.mean, begin.inputs.mean)


def model(network=None):
    return LearnedModel(
        network or deep(), {"a": "1", "b": "1", "c": "m"}, {"u": "deg", "v": "deg"}, "bench", "", {"run": "r"}
    )


def written(folder, model, stem="net"):
    for name, content in files_of(model, stem).items():
        (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return folder / f"{stem}.toml"


def test_a_model_comes_back_from_its_files_to_the_last_bit(tmp_path):
    result = read_learned(written(tmp_path, model()))
    x, _ = data()
    np.testing.assert_array_equal(result.network(x), deep()(x))
    assert (result.inputs, result.outputs, result.rig) == (model().inputs, model().outputs, "bench")
    np.testing.assert_array_equal(from_table(to_table(result)).network(x), deep()(x))


def test_nothing_in_the_files_can_be_executed(tmp_path):
    written(tmp_path, model())
    arrays = np.load(tmp_path / "net.npz", allow_pickle=False)
    assert all(arrays[name].dtype == np.float64 for name in arrays.files)


def test_weights_of_another_fit_are_refused(tmp_path):
    path = written(tmp_path, model())
    written(tmp_path, model(deep(seed=9)), "other")
    (tmp_path / "net.npz").write_bytes((tmp_path / "other.npz").read_bytes())
    with pytest.raises(SpecError, match=r"weights in net\.npz are not those that .*/net\.toml describes"):
        read_learned(path)


def test_a_missing_half_is_said(tmp_path):
    path = written(tmp_path, model())
    (tmp_path / "net.npz").unlink()
    with pytest.raises(SpecError, match=r"net\.npz, which cannot be read"):
        read_learned(path)


def test_weights_that_are_no_numbers_and_layers_that_do_not_fit_are_refused(tmp_path):
    good = deep()
    weights = (*good.weights[:-1], good.weights[-1] * np.nan)
    broken = Network(weights, good.biases, "identity", good.inputs, good.outputs)
    with pytest.raises(SpecError, match="not finite numbers"):
        read_learned(written(tmp_path, model(broken)))
    table = to_table(model())
    with pytest.raises(SpecError, match=r"weights of 3 x 4, .* do not lead from 1 inputs to 2 outputs"):
        from_table({**table, "inputs": {"a": "1"}})
    with pytest.raises(SpecError, match="weights of no layer do not lead"):
        from_table({**table, "weights": [], "biases": []})


@pytest.mark.parametrize("scale", [0.0, -1.0, np.inf, np.nan])
def test_a_scale_that_cannot_be_divided_by_is_refused(tmp_path, scale):
    good = deep()
    broken = replace(good, inputs=replace(good.inputs, scale=np.full(3, scale)))
    with pytest.raises(SpecError, match=r"net\.toml .* scaling needs finite numbers, and scales above 0"):
        read_learned(written(tmp_path, model(broken)))


def test_a_scaling_that_is_not_that_of_the_weights_is_refused(tmp_path):
    path = written(tmp_path, model())
    text = path.read_text()
    before = repr(float(model().network.inputs.scale[0]))
    assert before in text
    path.write_text(text.replace(before, "2.6", 1))
    with pytest.raises(SpecError, match=r"scaling\.input_scale in .* is not that of the weights"):
        read_learned(path)
