"""The specification over terms is the reference: drift, flags and states, number by number."""

import numpy as np
import pytest
from benchmarks.random_models import draw_case

from tests.golden.models import CASES
from tests.golden.vectors import load
from tests.prove.models import as_read
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import CodeArray
from zerodrift_proof.equality.specification import Specification, State
from zerodrift_proof.equality.terms import Terms, Whole

STEPS = 30


class Runner:
    """The specification on known codes: every term is a number."""

    def __init__(self, model: IntegerModel) -> None:
        self.meaning = Specification(Terms(), as_read(model))
        self.model, self.state = model, self.meaning.blank()

    def start(self, raw: list[int], settled: bool) -> None:
        codes = self._codes(raw)
        if settled and not self.meaning.lacks(codes).low:
            self.state = self.meaning.settle(codes)

    def _codes(self, raw: list[int]) -> list[Whole]:
        return self.meaning.convert([self.meaning.number(r) for r in raw])

    def step(self, raw: list[int]) -> tuple[list[int], int]:
        meaning, codes = self.meaning, self._codes(raw)
        lacks = meaning.lacks(codes)
        if self.state["steps"][0].low == 0:
            if lacks.low:
                outcome = meaning.wait(self.state)
                return [d.low for d in outcome.drift], outcome.flags.low
            begun = meaning.rest(self.state, codes, settled=False)
            outcome, _ = meaning.step(begun, codes, codes, lacks)
        else:
            held = meaning.hold(self.state, codes)
            outcome, _ = meaning.step(self.state, codes, held, lacks)
        self.state = outcome.state
        assert meaning.is_sound(self.state).exact == 1
        return [as_number(d) for d in outcome.drift], as_number(outcome.flags)


def as_number(term: Whole) -> int:
    assert term.exact is not None
    return term.exact


def pack(model: IntegerModel, state: State) -> list[int]:
    """Return the state as the reference packs it: rings oldest first."""
    numbers = {name: [t.low for t in cells] for name, cells in state.items()}
    out = [*numbers["steps"], *numbers["previous_temperature"]]
    out += [n for name, cells in numbers.items() if name.startswith("last_") for n in cells]
    out += numbers.get("drift", []) if model.feeds_back else []
    for node in model.nodes:
        own = {k: v for k, v in numbers.items() if k.startswith(f"{node.name}_")}
        names = [f.name for f in node.list_state() if not f.unsigned]
        ring = own.get(f"{node.name}_oldest")
        for name in sorted(names):
            cells = own[name]
            if ring is not None:
                row = len(cells) // node.list_state()[0].sizes[0]
                cells = cells[ring[0] * row :] + cells[: ring[0] * row]
            out += cells
    return out


def hold(model: IntegerModel, codes: CodeArray, settled: bool) -> None:
    """Compare a run of the reference with the specification."""
    reference, runner = Reference(model), Runner(model)
    state = reference.start(codes[None, 0], settled=settled)
    runner.start(codes[0].tolist(), settled)
    layers = [layer for layer in model.recurrents if layer.streams]
    for row in codes[:STEPS]:
        state, _, drift, flags = reference.step(state, row[None].astype(np.int64))
        assert runner.step(row.tolist()) == (drift[0].tolist(), int(flags[0]))
        if not layers:
            assert sorted(pack(model, runner.state)) == sorted(state.pack()[0].tolist())
        for layer in layers:
            own = state.nodes[layer.name]
            for key, values in own.items():
                cells = runner.state.get(f"{layer.name}_{key}")
                if cells is not None:
                    assert [c.low for c in cells] == values[0].tolist()


@pytest.mark.spread(4, "name", CASES)
def test_golden_models(name: str) -> None:
    golden = load(name)
    hold(golden.model, golden.codes, golden.settled)
    hold(golden.model, golden.codes[3:], not golden.settled)


@pytest.mark.spread(3, "number", range(12))
def test_random_models(number: int) -> None:
    case = draw_case(71, number)
    hold(case.model, case.codes[0], case.settled)
    hold(case.model, case.codes[1], not case.settled)
