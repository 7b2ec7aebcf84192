"""A whole model: its names, its constants, its state, and every function, run over intervals.

The names that a model's C gives to things, and what it writes between a macro's brackets.

A name decides what a compiler takes for what: a function `memset` of a model's own is called
wherever the compiler itself fills memory. Every name is therefore held against those that the
generator makes (docs/reference/generated-c.md).
"""

import re
from collections.abc import Mapping, Sequence

from zerodrift_proof.certificate.assembly import run_assembly
from zerodrift_proof.certificate.guard import (
    cut_known,
    has_block,
    is_summed,
    read_block_set,
    read_guard,
)
from zerodrift_proof.certificate.intervals import IntervalMachine
from zerodrift_proof.certificate.kernels import RULES, STRUCTS
from zerodrift_proof.certificate.parser import (
    CCall,
    CDeclare,
    CField,
    CFor,
    CIndex,
    CInteger,
    CList,
    CName,
    CNode,
    CNumbers,
    CUnary,
    Function,
    Initialiser,
    Program,
    Variable,
    is_name,
    parse,
    walk,
)
from zerodrift_proof.certificate.preprocessor import (
    NAMES_OF_TABLES,
    SIZES,
    SWITCHES,
    Build,
    BuildWay,
    ModelTokens,
    read_ways,
)
from zerodrift_proof.certificate.values import (
    TYPES,
    Address,
    Block,
    FaultError,
    Found,
    NotUnderstoodError,
    Pointer,
    Struct,
    Value,
    anything,
    make_block,
    read_lines,
)

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
OWN_STRUCTS = ("input", "state", "block")
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
        known = {f"{self._prefix}_{name}_t" for name in (*OWN_STRUCTS, "codes")}
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


class Runtime:
    """The constants and tables of zd_runtime.h and zd_runtime.c."""

    def __init__(self, texts: Mapping[str, str]) -> None:
        """Read them.

        Args:
            texts: file name -> content.
        """
        files = [text for name, text in texts.items() if name.startswith("zd_")]
        plain = re.sub(r"/\*.*?\*/", "", "\n".join(files), flags=re.S)
        found = re.findall(r"#define (ZD_\w+) (0[xX][0-9a-fA-F]+|[1-9]\d*|0)(?=\s)", plain)
        self.numbers = {name: int(value, 0) for name, value in found if name not in SWITCHES}
        self.tables = {
            name: [int(n) for n in numbers.split(",")]
            for name, numbers in re.findall(r"(\w+)\[[\w +]+\] = \{([-\d,\s]*)\}", plain)
        }
        self.lines = read_lines(self.tables)


def read_models(texts: Mapping[str, str], prefix: str) -> "list[Model]":
    """Return a machine for every way in which the model can be compiled, none of them run yet.

    Args:
        texts: file name -> content, of the model's header and source and of the runtime.
        prefix: of the model.

    Raises:
        NotUnderstoodError: something without a rule.
        FaultError: it does not compile.
    """
    runtime, models = Runtime(texts), list[Model]()
    alike: dict[tuple[str, ...], Model] = {}
    for way, every in read_ways(texts, prefix, runtime.numbers):
        tokens, asked = cut_known(every, prefix) if has_block(every, prefix) else (every, 0)
        plain = tuple(w for w in tokens.words if w[0] != '"' and w not in NAMES_OF_TABLES)
        if (model := alike.get(plain)) is not None:
            model.add_builds(way, _parse(tokens, prefix))
            continue
        for int_bits, per_pair in _list_chips(way, tokens):
            alike[plain] = Model(way, tokens, prefix, runtime, int_bits, per_pair, asked)
            models.append(alike[plain])
    return models


def _parse(tokens: ModelTokens, prefix: str) -> Program:
    """Return what the words declare, under names that a model has."""
    program = parse(tokens, tuple(STRUCTS))
    check_names(program, prefix)
    return program


def _list_chips(way: BuildWay, tokens: ModelTokens) -> list[tuple[int, int]]:
    """Return the bits of int, and the words of scratch for two numbers, that a build can have."""
    if {"ZD_GRU_ASSEMBLY", "ZD_ASSEMBLY"} & way.defined.keys():
        return [(32, 2)]
    kernel = way.defined.get("ZD_KERNEL", 0)
    if kernel == 0 and "zd_gru_step_pairs" in tokens.words:
        return [(32, 1), (32, 2), (16, 2)]  # of a block, on every core
    return {0: [(32, 2), (16, 2)], 1: [(32, 1), (32, 2)]}.get(kernel, [(32, 2)])


class Model(IntervalMachine):
    """One way of compiling a model."""

    def __init__(
        self,
        way: BuildWay,
        tokens: ModelTokens,
        prefix: str,
        runtime: Runtime,
        int_bits: int = 32,
        per_pair: int = 2,
        block_bytes: int = 0,
    ) -> None:
        """Read all declarations.

        Args:
            way: what a build defines.
            tokens: what is left to compile.
            prefix: of the model.
            runtime: its constants.
            int_bits: of C's int.
            per_pair: words of scratch for two numbers in the kernel for pairs of them.
            block_bytes: length of a block that `check_block` asks for; 0: there are none.
        """
        super().__init__(_parse(tokens, prefix), prefix, runtime.numbers, RULES, int_bits)
        narrow = ", int of 16 bits" if int_bits == 16 else ""
        self.name, self.defined = way.name + narrow, way.defined
        self._texts: list[tuple[Build, Mapping[str, tuple[str, ...]]]] = []
        """What each build of which nothing but the assembly is another defines, and that."""
        self.add_builds(way, self.program)
        self.has_block, self._block_bytes = block_bytes > 0, block_bytes
        self.per_pair, self.tables, self.tanh_lines = per_pair, runtime.tables, runtime.lines
        self.h_limit = runtime.numbers["ZD_GRU_H_LIMIT_Q30"]
        self._prove_recurrence()

    def _prove_recurrence(self) -> None:
        """Show |h| <= limit by induction, from the lines that tanh is made of."""
        lines, limit = self.tanh_lines, self.h_limit
        ends = [end for line in lines for end in line]
        self.lines = len(lines)
        self.tanh_max = max(map(abs, ends), default=0)
        self.r_max = (1 << 30) + self.tanh_max
        shown = {
            "tanh rises from line to line": ends == sorted(ends),
            "tanh is odd": [-e[0] for e in lines[:0:-1]] == [e[0] for e in lines[1:]],
            "u <= 1 - 2^-16: from |n - h| >= 2^16 a step does not pass n": self.r_max
            <= (1 << 31) - (1 << 15),
            "from nearer it passes n by 1 at most": self.tanh_max + 1 <= limit,
            "the state's copy fits 16 bits": (limit + (1 << 14)) >> 15 <= 32767,
        }
        self.failures += [
            f"|h| <= {limit} does not hold: {k}" for k, true in shown.items() if not true
        ]

    def run(self) -> None:
        """Run every function.

        Raises:
            NotUnderstoodError: the C holds something without a rule.
        """
        try:
            for constant in self.program.constants:
                self._read_constant(constant)
            for claim in self.program.claims:
                if self.number(claim).exact != 1:
                    self.fail("does not compile: a claim that does not hold")
            self.outputs = self.constant(self._expand("OUTPUTS"))
            if self.has_block:
                self.blocks = read_block_set(self, self.prefix, self._block_bytes)
                self._called.add(f"{self.prefix}_is_admissible")
            self.guard = read_guard(self, self.prefix)
            self.summed = is_summed(self, self.prefix)
        except FaultError as error:
            self.fail(str(error))
            return
        entries = (
            *ENTRIES,
            *(e for e in FURTHER if f"{self.prefix}_{e}" in self.program.functions),
        )
        missing = [e for e in ENTRIES if f"{self.prefix}_{e}" not in self.program.functions]
        if missing:
            raise NotUnderstoodError(f"{self.prefix}: no function {missing[0]}")
        for entry in entries:
            self.explore(getattr(self, f"_run_{entry}"))
        left = {*self.program.functions, *self.program.assembly} - self._called
        if left and not self.failures:
            raise NotUnderstoodError(f"{min(left)} is never called, and was not looked at")

    def run_assembly(self, name: str, arguments: Sequence[Found]) -> None:
        """Step a layer by assembly that is known."""
        run_assembly(self, name, arguments, self._texts)

    def add_builds(self, way: BuildWay, program: Program) -> None:
        """Let the model stand for all builds of a way, which differ from it in assembly alone."""
        self._texts += [(build, program.assembly) for build in way.builds]

    def _expand(self, macro: str) -> CInteger:
        words = self.program.tokens.macros.get(f"{self.prefix.upper()}_{macro}")
        if words is None or len(words) != 1:
            raise NotUnderstoodError(f"{self.prefix}.h: no {macro}")
        return CInteger(0, words[0], int(words[0]))

    # --- constants

    def _read_constant(self, variable: Variable) -> None:
        name, kind = variable.name, variable.type.name
        self._at = variable.at
        if name in self.constants or name in self.known or variable.first is None:
            raise self.not_understood(f"{name} stands here twice")
        sizes = [self._size(size) for size in variable.sizes]
        if kind in STRUCTS and not sizes and isinstance(variable.first, CList):
            self.constants[name] = self._read_struct(name, kind, variable.first.items)
            return
        if kind not in TYPES:
            raise self.not_understood(f"a constant of {kind}")
        block = Block(name, kind, tuple(sizes), [], constant=True)
        block.cells = list(self._read_numbers(variable.first, kind, sizes, name))
        self.constants[name] = block

    def _read_numbers(self, node: Initialiser, kind: str, sizes: list[int], name: str) -> list[int]:
        if not sizes:
            if isinstance(node, CList):
                raise self.not_understood(f"{name}: a list where a number is expected")
            return [self._read_number(node, kind, name)]
        if isinstance(node, CNumbers) and len(sizes) == 1:
            found = node.numbers
            if len(found) > sizes[0]:
                raise FaultError(f"{name}: {len(found)} values for {sizes[0]}")
            for number in (min(found), max(found)):
                self._require_fit(number, kind, name, node)
            return found + [0] * (sizes[0] - len(found))
        if not isinstance(node, CList) or len(node.items) > sizes[0]:
            raise FaultError(f"{name}: more than {sizes[0]} values, or no list of them")
        inner = 1
        for size in sizes[1:]:
            inner *= size
        numbers = [n for p in node.items for n in self._read_numbers(p, kind, sizes[1:], name)]
        return numbers + [0] * (inner * sizes[0] - len(numbers))

    def _read_number(self, node: Initialiser, kind: str, name: str) -> int:
        number = self.constant(node)
        self._require_fit(number, kind, name, node)
        return number

    def _require_fit(self, number: int, kind: str, name: str, node: Initialiser) -> None:
        low, high = TYPES[kind]
        if not low <= number <= high:
            self._at = node.at
            raise FaultError(f"{name}: {number} does not fit {kind}")

    def make_layer(self, name: str, kind: str, first: CList) -> Struct:
        """Return a layer whose numbers lie in a block."""
        if kind not in STRUCTS:
            raise self.not_understood(f"a variable of {kind}")
        return self._read_struct(name, kind, first.items)

    def _read_struct(self, name: str, kind: str, items: tuple[Initialiser, ...]) -> Struct:
        struct = Struct(name, kind)
        if len(items) != len(STRUCTS[kind]):
            raise FaultError(f"{name}: {len(items)} values for {len(STRUCTS[kind])} fields")
        for (field, of, count), item in zip(STRUCTS[kind], items, strict=True):
            self._at = item.at
            if of in TYPES:
                sizes = [count] if count else []
                cells = self._read_numbers(item, of, sizes, f"{name}.{field}")
                struct.fields[field] = Block(
                    f"{name}.{field}", of, tuple(sizes), list(cells), constant=True
                )
                continue
            struct.tables[field] = None
            if isinstance(item, CInteger) and item.number == 0:
                continue
            found = self.evaluate(item) if isinstance(item, CName | CField) else None
            wanted = of.removeprefix("const ").removesuffix(" *")
            if not isinstance(found, Pointer) or found.block.type != wanted:
                raise FaultError(f"{name}.{field}: no table of {wanted}")
            if len(found.sizes) != 1 or not found.block.constant:
                raise FaultError(f"{name}.{field}: {found.block.name} is no row of constants")
            struct.tables[field] = found
        return struct

    # --- entries: what anyone may call, with any state and any input

    def _blocks(self) -> tuple[Address, ...]:
        """Return a block of those that pass the test, or none, where entries take one.

        Nothing may be read where there is none.
        """
        if not self.has_block:
            return ()
        self._without_block = self.choose(2) == 0
        block = self.make_struct(f"{self.prefix}_block_t", "b", any_bits=not self._without_block)
        if not self._without_block:
            self.blocks.admit(block)
        return (Address(block, constant=True),)

    def _call_entry(self, name: str, *arguments: Found) -> None:
        self.call(f"{self.prefix}_{name}", arguments)

    def _saved(self, any_bits: bool, entry: str) -> Pointer:
        sizes = self.program.functions[f"{self.prefix}_{entry}"].parameters[-1].sizes
        if len(sizes) != 1:
            raise self.not_understood(f"what {entry} is given")
        cell = anything("uint8_t") if any_bits else None
        block = make_block("saved", "uint8_t", [self.constant(sizes[0])], cell)
        self._live.append(block)
        return Pointer(block, Value(0, 0), block.sizes)

    def _run_init(self) -> None:
        state = self.make_state("nothing")
        self._call_entry("init", Address(state))
        self.require_sound(state, "init")

    def _run_settle(self) -> None:
        state, codes = self.make_state("nothing"), self.make_input()
        self._call_entry("settle", Address(state), *self._blocks(), Address(codes, constant=True))
        self.require_sound(state, "settle")

    def _run_step(self) -> None:
        self._step("step")

    def _run_step_after(self) -> None:
        self._step("step_after", anything("uint64_t"))

    def _step(self, entry: str, *times: Value) -> None:
        state, codes = self.make_state(), self.make_input()
        drift = make_block("drift", "int32_t", [self.outputs], None)
        self._live.append(drift)
        given = Pointer(drift, Value(0, 0), drift.sizes)
        block, own = self._blocks(), Address(codes, constant=True)
        self._call_entry(entry, Address(state), *block, own, *times, given)
        given.values(self.outputs)
        self.require_sound(state, entry)
        self.require_asked()

    def _run_save(self) -> None:
        state = self.make_state()
        saved = self._saved(any_bits=False, entry="save")
        self._call_entry("save", Address(state, constant=True), saved)
        saved.values(saved.count)

    def _run_restore(self) -> None:
        self._restore_copy("restore")

    def _run_restore_after(self) -> None:
        self._restore_copy("restore_after", anything("uint64_t"))

    def _restore_copy(self, entry: str, *times: Value) -> None:
        state = self.make_state()
        saved = self._saved(any_bits=True, entry="restore")
        self._call_entry(entry, Address(state), *self._blocks(), saved, *times)
        self.require_sound(state, entry)

    def _run_tare(self) -> None:
        self._tare("tare")

    def _run_untare(self) -> None:
        self._tare("untare")

    def _tare(self, entry: str) -> None:
        """A state that is sound stays so; one that was damaged is left as it is."""
        state = self.make_state()
        self.guard.admit(state, fresh=self.choose(2) == 0)
        self.give(state)
        self._call_entry(entry, Address(state))
        if any(cell is None for block in state.fields.values() for cell in block.cells):
            return  # the checksum of what was given is another
        self.require_sound(state, entry)

    def _run_selftest(self) -> None:
        self._replaying = True
        self._call_entry("selftest", *self._blocks())
        self._replaying = False
