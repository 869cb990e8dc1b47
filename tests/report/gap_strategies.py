"""Diagnoses of any numbers and any names."""

from dataclasses import replace
from typing import get_args

import gap_examples as examples
import numpy as np
from hypothesis import strategies as st

from labrun.gap import Cause, MissingForce, Name, Place, RatedCandidate, ResampledNumber, Shrinkage, Sizes
from labrun.gap.diagnosis import Rest, Rung, Verdict

BASE = examples.static()
numbers = st.floats(-1e9, 1e9, allow_nan=False)
sizes = st.floats(0.0, 1e6, allow_nan=False)
shares = st.floats(-3.0, 3.0)
words = st.text(st.characters(max_codepoint=0x17F, exclude_categories=("Cc",)), min_size=1, max_size=60)
names = st.builds(Name, words, words, st.sampled_from(["effect", "parameter"]))
estimates = st.builds(
    lambda ends, unit: ResampledNumber(ends[1], ends[0], ends[2], unit),
    st.tuples(numbers, numbers, numbers).map(sorted),
    st.sampled_from(["1", "N m", "s", "kg m^2", "rad"]),
)
values = st.dictionaries(words, estimates, max_size=3)
places = st.builds(
    Place,
    st.sampled_from(["channel", "condition", "phase", "frequency", "state", "reversal"]),
    words,
    shares,
    st.none() | st.floats(0.0, 1.0),
    words,
)
candidates = st.builds(
    RatedCandidate,
    names,
    st.sampled_from(["cause", "rival", "not-needed", "excluded", "not-visible"]),
    st.none() | shares,
    values,
    values,
    st.lists(names, max_size=2).map(tuple),
    words,
)
references = st.dictionaries(words, st.tuples(numbers, st.sampled_from(["1", "rad/s", ""])), max_size=2)
causes = st.builds(
    Cause,
    names,
    st.floats(0, 1) | st.just(float("nan")),
    values,
    shares,
    shares,
    st.lists(names, max_size=2).map(tuple),
    references,
    words,
)
rests = st.builds(
    Rest, sizes, shares, st.none() | st.floats(0, 1), st.lists(words, max_size=2).map(tuple), st.booleans()
)
sentences = st.lists(words, max_size=6).map(tuple)


@st.composite
def traces(draw):
    samples, outputs = draw(st.integers(1, 12)), draw(st.just(2))
    rng = np.random.default_rng(draw(st.integers(0, 99)))
    scale = draw(st.sampled_from([0.0, 1e-9, 1.0, 1e9]))
    base = BASE.traces[0]
    columns = {
        name: scale * rng.standard_normal((samples, outputs))
        for name in ("measured", "raw", "recalibrated", "after")
    }
    return replace(base, label=draw(words), time_s=np.arange(samples) / 10.0, **columns)


@st.composite
def missing(draw):
    rng = np.random.default_rng(draw(st.integers(0, 99)))
    count = draw(st.integers(1, 3))
    column = tuple(draw(st.sampled_from([0.0, 1e-6, 1e6])) * rng.standard_normal(20) for _ in range(count))
    return MissingForce(draw(words), "N m", draw(shares), ("",) * count, column, column[::-1], column, column)


@st.composite
def rungs(draw, outputs):
    return Rung(
        draw(words),
        draw(st.none() | names),
        {name: draw(sizes) for name in outputs},
        draw(sizes),
        draw(shares),
    )


@st.composite
def diagnoses(draw):
    outputs = draw(st.lists(words, min_size=2, max_size=2, unique=True))
    return replace(
        BASE,
        verdict=draw(st.sampled_from(get_args(Verdict))),
        sentence=draw(words),
        gap=Sizes(draw(sizes), draw(sizes), draw(sizes), draw(sizes)),
        where=tuple(draw(st.lists(places, max_size=12))),
        causes=tuple(draw(st.lists(causes, max_size=3))),
        candidates=tuple(draw(st.lists(candidates, max_size=8))),
        shrinkage=draw(st.none() | st.builds(Shrinkage, shares, shares, shares)),
        recalibration=draw(
            st.dictionaries(words, st.tuples(numbers, st.just("free") | st.floats(0, 1), numbers), max_size=3)
        ),
        limitations=draw(sentences),
        what_next=draw(sentences),
        notes=draw(sentences),
        channels=((outputs[0], "N m"), (outputs[1], "1")),
        noise={name: draw(sizes) for name in outputs},
        ladder=tuple(draw(st.lists(rungs(outputs), min_size=2, max_size=5))),
        rest=draw(rests),
        stopped=draw(st.sampled_from(["", "time", "interrupted"])),
        conditions=draw(st.integers(1, 3)),
        missing=tuple(draw(st.lists(missing(), max_size=2))),
        traces=tuple(draw(st.lists(traces(), max_size=3))),
    )
