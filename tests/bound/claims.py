"""What error bound each kind of model has, as the code says of one model or more of that kind.

    python -m tests.bound.claims

prints the table of SOUNDNESS.md; a test holds the page to it.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from unittest import mock

from tests.bound.cases import Case
from tests.bound.lstms import Forgetful as Gated
from tests.bound.lstms import make_lstm
from tests.bound.planted import make_case
from tests.bound.recurrent import Forgetful, make_recurrent
from tests.bound.test_range_bound import WILD, make_wide_gru
from tests.golden.model_factory import Shape, draw_float_model
from tests.golden.models import CASES
from zerodrift.export.error_bound import BY_RANGE
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.product import IntegerProduct

BEGIN = "<!-- claims: python -m tests.bound.claims -->"
END = "<!-- end of claims -->"
CLOSE = "a bound from its roundings"
RANGE = "a wide bound, from the range of its states alone (cause `range`)"
NOTHING = "none"


def _draw(shape: Shape, gain: float = 1.0) -> Case:
    described, calibration = draw_float_model(shape, 3)
    described = replace(described, coefficients=described.coefficients * gain)
    return Case.of(described, calibration)


def _draw_load(gain: float) -> Case:
    return _draw(Shape(inputs=1, hidden=0, front_end=("load",), measured=(0,), outputs=1), gain)


OF_USERS = "operations of users without a rule for their error"
KINDS: dict[str, Sequence[Callable[[], Case]]] = {
    "effects, a lag bank, dense networks (`mlp`, `mlp_seq`, `tcn`), with a window or without": (
        lambda: make_case("lowpass of a product"),
        lambda: make_case("two layers"),
    ),
    "one GRU in which an error shrinks by the sizes of the weights, with a window or without": (
        lambda: make_recurrent(Forgetful()),
        lambda: make_recurrent(Forgetful(window=6)),
    ),
    "one LSTM of which the same holds": (lambda: make_lstm(Gated()),),
    "GRUs on top of each other, each of which shrinks errors": (
        lambda: make_recurrent(Forgetful(hidden=2, upper=(2,))),
    ),
    "other GRUs and LSTMs, and LSTMs on top of each other": tuple(WILD.values()),
    "the same, where the limits of the answer say as much": (make_wide_gru,),
    "recurrent layers that read several others, or with a normalisation between them": (
        lambda: _draw(CASES["layered"].shape),
        lambda: _draw(CASES["layer_norm"].shape),
    ),
    "effects of the load, which give an error of the drift back smaller": (
        lambda: _draw_load(1.0),
    ),
    "effects of the load, which give it back enlarged": (lambda: _draw_load(1e5),),
    OF_USERS: (lambda: make_case("product"),),
}
"""Kind, as the page names it -> models of it."""


def find_claim(kind: str) -> tuple[str, str]:
    """Return what is claimed of a kind of model, and what `why` says of its first one.

    Raises:
        ValueError: the models of the kind differ.
    """
    of = IntegerNode if kind == OF_USERS else IntegerProduct  # the first has no rule
    with mock.patch.object(IntegerProduct, "bound_error", of.bound_error):
        bounds = [make().bound() for make in KINDS[kind]]
    claims = {
        NOTHING if not bound.outputs else RANGE if BY_RANGE in bound.holds else CLOSE
        for bound in bounds
    }
    if len(claims) != 1:
        raise ValueError(f"{kind}: {claims}")
    return claims.pop(), bounds[0].why.split(": ")[0]


def write_table() -> str:
    """Return the table, as Markdown."""
    lines = ["| model | error bound | `why` says |", "|---|---|---|"]
    for kind in KINDS:
        claim, why = find_claim(kind)
        lines.append(f"| {kind} | {claim} | {why} |".replace("  |", " |"))
    return "\n".join(lines)


if __name__ == "__main__":
    print(write_table())
