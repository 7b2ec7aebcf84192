"""The C of a model's nodes, one face after the other, from the operations' own folders."""

from collections.abc import Collection, Mapping

import jinja2
from jinja2.environment import TemplateModule

from zerodrift.operations.c_text import StateField, format_int64
from zerodrift.operations.intervals import Interval
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.registry import FOLDERS


class NodeText:
    """Renders nodes: a face is the macro of that name in `operations/FOLDER/c.j2`, if it is there.

    A class derived from another operation's takes what it lacks from there. Else a state is one
    number, at rest what the value is there, and sound within its bound.

    Args:
        environment: finds the templates.
        context: what a model's templates know.
        bounds: what is proven of each place in the model.
        needed_at_rest: names of the nodes whose values some state at rest is made from.
    """

    def __init__(
        self,
        environment: jinja2.Environment,
        context: Mapping[str, object],
        bounds: Mapping[str, Interval],
        needed_at_rest: Collection[str],
    ) -> None:
        self._environment, self._context = environment, context
        self._bounds, self._needed_at_rest = bounds, needed_at_rest
        self._macros: dict[str, TemplateModule | None] = {}

    def _render(self, face: str, node: IntegerNode) -> str:
        for kind in (c.__dict__["kind"] for c in type(node).__mro__ if "kind" in c.__dict__):
            macro = getattr(self._find_macros(FOLDERS[kind]), face, None)
            if macro is not None:
                return str(macro(node))
        return ""

    def _find_macros(self, folder: str) -> TemplateModule | None:
        if folder not in self._macros:
            try:
                template = self._environment.get_template(f"{folder}/c.j2")
            except jinja2.TemplateNotFound:
                self._macros[folder] = None
            else:
                self._macros[folder] = template.make_module(dict(self._context))
        return self._macros[folder]

    def constants(self, node: IntegerNode) -> str:
        """Return the tables."""
        return self._render("constants", node)

    def convert(self, node: IntegerNode) -> str:
        """Return how a raw code becomes that of its channel."""
        return self._render("convert", node)

    def functions(self, node: IntegerNode) -> str:
        """Return the functions that the node's step calls."""
        return self._render("functions", node)

    def claims(self, node: IntegerNode) -> str:
        """Return static assertions beside those of the certificate's bounds."""
        return self._render("claims", node)

    def sound(self, node: IntegerNode) -> str:
        """Return what sets `sound` to 0 where the state is not where the proof says it can be."""
        return self._render("sound", node) or "".join(
            self._ask_number(node, field) for field in node.list_state()
        )

    def _ask_number(self, node: IntegerNode, field: StateField) -> str:
        place, name = f"s->{field.name}", field.name.removeprefix(f"{node.name}_")
        bound, form = self._bounds[f"{node.name}.{name}"], format_int64 if field.bits > 32 else str
        beyond = f"({place} < {form(bound.low)}) || ({place} > {form(bound.high)})"
        return f"    if ({beyond}) {{\n        sound = 0u;\n    }}\n"

    def relax(self, node: IntegerNode) -> str:
        """Return how a recurrent layer comes to rest under the present input."""
        return self._render("relax", node)

    def copy(self, node: IntegerNode) -> str:
        """Return the int16 copy of a recurrent layer's present output."""
        return self._render("copy", node)

    def elapse(self, node: IntegerNode) -> str:
        """Return what the test harness does for a log that begins after power-on."""
        return self._render("elapse", node)

    def value(self, node: IntegerNode) -> str:
        """Return the value as a function of the inputs."""
        return self._render("value", node) or _declare(node, node.express())

    def settled(self, node: IntegerNode) -> str:
        """Return the value at rest."""
        return _declare(node, node.express_at_rest()) if node.stateful else self.value(node)

    def rest(self, node: IntegerNode) -> str:
        """Return the state at rest, and before it the value there if others need that."""
        if not node.stateful:
            return self.value(node)
        value = self.settled(node) if node.name in self._needed_at_rest else ""
        first, *_ = node.list_state()
        own = self._render("rest", node)
        return value + (own or f"    s->{first.name} = {node.express_at_rest()};\n")

    def step(self, node: IntegerNode) -> str:
        """Return the step: the value, and the state after it."""
        values = node.name if node.width else f"&{node.name}"
        return self._render("step", node) or (
            f"{self.value(node)}    ZD_OBSERVE({values}, {max(node.width, 1)}u);\n"
        )


def _declare(node: IntegerNode, expression: str) -> str:
    return f"    const int32_t {node.name} = {expression};\n"
