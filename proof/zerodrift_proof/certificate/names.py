"""The names that a model's C gives to things, and what it writes between a macro's brackets.

A name decides what a compiler takes for what: a function `memset` of a model's own is called
wherever the compiler itself fills memory. Every name is therefore held against those that the
generator makes (docs/reference/generated-c.md). Shares no code with the generator and needs the
standard library only.
"""

import re

from zerodrift_proof.certificate.lexer import SIZES
from zerodrift_proof.certificate.nodes import (
    CCall,
    CDeclare,
    CField,
    CFor,
    CIndex,
    CInteger,
    CName,
    CNode,
    CUnary,
    Function,
    Program,
    Variable,
    is_name,
    walk,
)
from zerodrift_proof.certificate.values import NotUnderstoodError

ENTRIES = ("init", "settle", "step", "selftest", "save", "restore")
FURTHER = ("step_after", "restore_after", "tare", "untare")
"""Entries of models whose steps are told their time, or whose drift counts from a moment on."""
OF_BLOCKS = ("check_block", "choose_block")
OWN = (
    *("advance", "rest", "relax", "begin", "hold", "sum_up", "convert", "lacks_reading"),
    *("state_is_sound", "tables_are_sound", "is_admissible", "is_of", "size", "sum_fits"),
    *("rows_within", "gru_within", "add_norms"),
)
"""Functions of a model's own that its entries call."""
OF_NODES = re.compile(r"[a-z]\w*_(?:step|relax|is_sound)")
OF_ASSEMBLY = re.compile(r"[a-z]\w*_assembly")
SIGNATURES = (
    "void const int32_t * stream , int32_t * h_q30 , const int16_t * x , int32_t u_keep )",
    "void const int32_t * stream , int32_t * h_q30 , const int16_t * x , int32_t * cell ,"
    " uint32_t relaxing )",
)
"""Of the assembly of a GRU and of an LSTM: in which register each argument comes."""
STRUCTS = ("input", "state", "block")
LAYERS = ("gru", "lstm")
"""Layers whose constants bear no further word; every other constant is named NODE_PART."""


def check_names(program: Program, prefix: str) -> None:
    """Hold every name of a program against those that the generator makes.

    Args:
        program: header and source of a model; of a design without its known texts.
        prefix: of the model.

    Raises:
        NotUnderstoodError: a name of another kind, or in another place.
    """
    _NameCheck(program, prefix).check()


class _NameCheck:
    def __init__(self, program: Program, prefix: str) -> None:
        self._program, self._prefix = program, prefix
        self._entries = {f"{prefix}_{name}" for name in (*ENTRIES, *FURTHER, *OF_BLOCKS)}
        self._own = {f"{prefix}_{name}" for name in OWN} | self._entries

    def _refuse(self, at: int, why: str) -> NotUnderstoodError:
        return NotUnderstoodError(f"{self._program.place(at)}: {why}")

    def check(self) -> None:
        """Hold all of them."""
        program = self._program
        files = [
            *((name, at) for name, at in program.declared.items()),
            *((constant.name, constant.at) for constant in program.constants),
        ]
        names = [*(name for name, _ in files), *program.structs, *program.claim_names]
        if len(names) != len(set(names)):
            name = next(name for name in names if names.count(name) > 1)
            raise self._refuse(0, f"{name} is the name of two things")
        for name, at in files:
            if name.startswith("zd_"):
                raise self._refuse(at, f"{name}: names with zd_ are the runtime's")
        for name, at in program.declared.items():
            self._check_function(name, at)
        for constant in program.constants:
            self._check_constant(constant)
        self._check_structs()
        for name in program.claim_names:
            if not name.startswith(f"{self._prefix}_"):
                raise self._refuse(0, f"ZD_CLAIM: {name} does not begin with {self._prefix}_")
        for function in program.functions.values():
            self._check_body(function)

    def _is_header(self, at: int) -> bool:
        return self._program.place(at).startswith(f"{self._prefix}.h:")

    def _check_function(self, name: str, at: int) -> None:
        """Entries are declared in the header; all else is static, and of the source."""
        program, own = self._program, name in self._own
        of_node = OF_NODES.fullmatch(name) and not name.startswith(f"{self._prefix}_")
        if (name in self._entries) != self._is_header(at):
            raise self._refuse(at, f"{name}: the header declares the entries, and nothing else")
        if (name in self._entries) == (name in program.static):
            raise self._refuse(at, f"{name}: all functions but a model's entries are static")
        if function := program.functions.get(name):
            if self._is_header(function.body.at):
                raise self._refuse(function.body.at, f"{name} has its body in the header")
            if name in program.naked or not (own or of_node):
                raise self._refuse(at, f"{name} is no function in C that a model has")
        elif name in program.assembly:
            known = OF_ASSEMBLY.fullmatch(name) and program.signatures[name] in SIGNATURES
            if name not in program.naked or not known:
                raise self._refuse(at, f"{name} is no function of assembly that a model has")
        elif name in program.naked:
            raise self._refuse(at, f"{name} has attributes and no body")
        elif name not in self._entries:
            raise self._refuse(at, f"{name} is declared and has no body")

    def _check_constant(self, constant: Variable) -> None:
        name = constant.name
        if self._is_header(constant.at):
            raise self._refuse(constant.at, f"the constant {name} stands in the header")
        if "_" not in name and not (name in LAYERS and constant.type.name.startswith("zd_")):
            raise self._refuse(constant.at, f"a constant is named NODE_PART, not {name}")

    def _check_structs(self) -> None:
        known = {f"{self._prefix}_{name}_t" for name in (*STRUCTS, "codes")}
        for name, fields in self._program.structs.items():
            at = fields[0].at if fields else 0
            if name not in known or not fields:
                raise self._refuse(at, f"{name} is no struct of a model")
            if self._is_header(at) == name.endswith("_codes_t"):
                raise self._refuse(at, f"{name} is declared in the other file")

    def _check_body(self, function: Function) -> None:
        for parameter in function.parameters:
            self._check_own(parameter.name, parameter.at)
        for node in walk(function.body):
            if isinstance(node, CDeclare):
                self._check_own(node.variable.name, node.at)
                self._check_first(node.variable)
            elif isinstance(node, CFor):
                self._check_own(node.name, node.at)
                if any(is_name(part, node.name) for part in walk(node.first)):
                    raise self._refuse(node.at, f"{node.name} begins with itself")
            elif isinstance(node, CCall):
                self._check_call(node)

    def _check_own(self, name: str, at: int) -> None:
        if name.startswith("zd_"):
            raise self._refuse(at, f"{name}: names with zd_ are the runtime's")

    def _check_first(self, variable: Variable) -> None:
        """In `T x = ... x ...` C means the new x, whatever had the name before."""
        parts: list[CNode] = list(variable.sizes)
        parts += [variable.first] if variable.first is not None else []
        if any(is_name(node, variable.name) for part in parts for node in walk(part)):
            raise self._refuse(variable.at, f"{variable.name} begins with itself")

    def _check_call(self, call: CCall) -> None:
        """What a macro does with its arguments is not what a function does with them."""
        if call.name == "ZD_OBSERVE":
            places = (CName, CField, CIndex, CInteger, CUnary)
            parts = [part for argument in call.arguments for part in walk(argument)]
            if len(call.arguments) != 2 or not all(isinstance(part, places) for part in parts):
                raise self._refuse(call.at, "ZD_OBSERVE is given a place and its length")
        elif call.name == "ZD_CLAIM":
            raise self._refuse(call.at, "ZD_CLAIM stands outside of functions")
        elif call.name in ("ZD_QUIET", *SIZES) and not all(
            isinstance(argument, CInteger) for argument in call.arguments
        ):
            raise self._refuse(call.at, f"{call.name} is given integers")
