import json
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
from equations import OSCILLATOR

from labrun.effects import load_effect
from labrun.models import parse_model, simulate

_PROGRAM = """
import sys, json
import labrun.models, labrun.effects
assert "numba" not in sys.modules, "importing must stay cheap"
from labrun.models import load_model, simulate
import numpy as np
model = load_model(sys.argv[1])
assert "numba" not in sys.modules, "loading must stay cheap"
friction = labrun.effects.load_effect("coulomb-friction").attach("hinge", torque=0.1)
time_s, torque = np.arange(50) * 0.01, np.ones((50, 1))
out = simulate(model, time_s, torque, initial_state=[0, 0], effects=[friction], substeps=2).outputs
from labrun.compiled import compiled
from labrun.models.engine import integrate
functions = [model.derivative, model.output, model.site_values, friction.effect.function]
hits = [compiled(one.signature, one.python).cache_hits for one in functions]
hits.append(sum(integrate.stats.cache_hits.values()))
print(json.dumps([hits, out[-1].tolist()]))
"""


def _run(program: str, *arguments: str, cache: Path, folder: Path | None = None) -> str:
    environment = {**os.environ, "LABRUN_CACHE_DIR": str(cache), "PYTHONPATH": str(folder or "")}
    result = subprocess.run(
        [sys.executable, "-c", program, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_a_second_process_compiles_nothing_and_a_cache_that_was_tampered_with_is_written_anew(tmp_path):
    path, cache = tmp_path / "model.toml", tmp_path / "cache"
    path.write_text(OSCILLATOR)
    first, again = (json.loads(_run(_PROGRAM, str(path), cache=cache)) for _ in range(2))
    assert first[0][:4] == [0, 0, 0, 0]
    assert again[0] == [1, 1, 1, 1, 1]
    assert first[1] == again[1]
    modules = list((cache / "models").glob("*.py"))
    assert sum("def derivative(t, x, u, p, force, out):" in module.read_text() for module in modules) == 1
    for module in modules:
        module.write_text("raise SystemExit('not ours')")
    assert json.loads(_run(_PROGRAM, str(path), cache=cache))[1] == first[1]


def test_a_cache_directory_that_cannot_be_made_only_costs_time(tmp_path):
    (tmp_path / "file").write_text("")
    program = (
        "import numpy as np\nfrom labrun.models import parse_model, simulate\n"
        'model = parse_model(\'name = "double"\\ninputs = ["u"]\\n[outputs]\\ny = "2*u"\', \'d.toml\')\n'
        "print(simulate(model, np.zeros(1), np.full((1, 1), 1.5)).outputs.tolist())"
    )
    assert json.loads(_run(program, cache=tmp_path / "file" / "cache")) == [[3.0]]


def test_compiled_code_follows_changes_of_the_functions_it_calls(tmp_path):
    other = tmp_path / "other_physics.py"
    other.write_text(
        "from labrun.models import kernel\nGAIN = 2.0\n@kernel\ndef twice(a):\n    return 2.0 * a\n"
        "@kernel\ndef same(a):\n    return GAIN * a\n"
    )
    (tmp_path / "top_physics.py").write_text(
        "from labrun.models import python_model\nfrom other_physics import GAIN, same, twice\n"
        "def derivative(t, x, u, p, force, dx):\n    return\n"
        "def output(t, x, u, p, force, y):\n    y[0] = twice(1.0)\n    y[1] = GAIN\n    y[2] = same(1.0)\n"
        "MODEL = python_model('m', derivative=derivative, output=output, outputs=['y', 'z', 'w'])\n"
    )
    program = (
        "import numpy as np\nfrom labrun.models import load_model, simulate\n"
        "print(simulate(load_model('top_physics:MODEL'), np.zeros(1), np.empty((1, 0))).outputs[0].tolist())"
    )
    assert json.loads(_run(program, cache=tmp_path, folder=tmp_path)) == [2.0, 2.0, 2.0]
    other.write_text(other.read_text().replace("2.0 * a", "3.0 * a").replace("GAIN = 2.0", "GAIN = 5.0"))
    assert json.loads(_run(program, cache=tmp_path, folder=tmp_path)) == [3.0, 5.0, 5.0]


def test_models_and_effects_can_be_sent_to_another_process():
    model = parse_model(OSCILLATOR, "o.toml")
    effect = load_effect("coulomb-friction").attach("hinge", torque=0.1)
    there_model, there_effect = pickle.loads(pickle.dumps((model, effect)))
    given = (np.arange(9) * 0.1, np.ones((9, 1)))
    here = simulate(model, *given, initial_state=[0, 0], effects=[effect], substeps=3)
    there = simulate(there_model, *given, initial_state=[0, 0], effects=[there_effect], substeps=3)
    assert np.array_equal(here.outputs, there.outputs)


def test_no_combination_of_effects_compiles_anything_new():
    from labrun.models.engine import integrate

    model = parse_model(OSCILLATOR, "o.toml")
    names = ("coulomb-friction", "viscous-damping", "quadratic-drag", "added-inertia", "rest-offset")
    effects = [load_effect(name, "joint").attach("hinge") for name in names]
    for count in range(len(effects)):
        simulate(
            model,
            np.arange(5) * 0.1,
            np.ones((5, 1)),
            initial_state=[0, 0],
            effects=effects[:count],
            substeps=1,
        )
    assert len(integrate.signatures) == 1
