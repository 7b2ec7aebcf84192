"""Hypothesis strategies for models of every shape, and for names that no C compiler should see."""

from hypothesis import strategies as st
from tests.golden.model_factory import FRONT_ENDS, Shape

HOSTILE_NAMES = (
    "*/ #include <x>",
    "??/",
    "ends with a backslash\\",
    '"; system("x"); "',
    "Température °C",
    "温度",
    "int",
    "while",
    "zd_gru",
    "_Bool",
    "__LINE__",
    "",
    "   ",
    "\n#error injected\n",
    "x" * 300,
    "6 axis",
    "a b",
    "a-b",
    "%s%n",
)

names = st.one_of(st.sampled_from(HOSTILE_NAMES), st.text(max_size=40))


@st.composite
def shapes(
    draw: st.DrawFn, most_inputs: int = 8, most_hidden: int = 64, most_outputs: int = 16
) -> Shape:
    """Draw any shape the generator accepts."""
    inputs = draw(st.integers(1, most_inputs))
    outputs = draw(st.integers(1, most_outputs))
    wide = draw(st.booleans())
    lowest = -(2**31) if wide else -(2**15)
    none = st.sampled_from((None, lowest, lowest, 7, 2**15 - 1))
    low, high = draw(st.tuples(st.integers(-5000, 0), st.integers(1, 5000)))
    further = st.tuples(st.integers(1, 12), st.sampled_from(("tanh", "relu", "relu6")))
    return Shape(
        name=draw(names),
        inputs=inputs,
        hidden=draw(st.one_of(st.just(0), st.integers(1, most_hidden))),
        outputs=outputs,
        reset=draw(st.sampled_from(("after", "before"))),
        weights=draw(st.sampled_from(("int16", "int8"))),
        window=draw(st.sampled_from((0, 0, 1, 2, 10))),
        front_end=tuple(draw(st.lists(st.sampled_from(FRONT_ENDS), max_size=5))),
        gain=draw(st.sampled_from((0.1, 1.0, 5.0, 40.0))),
        update_bias=draw(st.sampled_from((0.0, -4.0, -9.0))),
        code_limit=draw(st.sampled_from((32768, 12000, 300))),
        drift_limit=draw(st.sampled_from((1e9, 1e4, 20.0))),
        measured=tuple(draw(st.sampled_from(((), (0,), (0, outputs - 1) if outputs > 1 else ())))),
        wide=tuple(range(inputs)) if wide else (),
        no_reading=tuple(draw(st.lists(none, max_size=inputs))),
        ranges=tuple((i, low, high) for i in range(1, inputs) if draw(st.booleans())),
        warm_up_steps=draw(st.sampled_from((0, 1, 40))),
        channel_names=tuple(draw(st.lists(names, min_size=inputs, max_size=inputs))),
        output_names=tuple(draw(st.lists(names, min_size=outputs, max_size=outputs))),
        upper=tuple(draw(st.lists(st.integers(1, 12), max_size=2))),
        dense=tuple(draw(st.lists(further, max_size=2))),
    )
