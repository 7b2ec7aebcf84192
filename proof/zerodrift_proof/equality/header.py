"""What a model's header tells its user, held against the model: macros, and how functions are
called.

Each is compared as it is written, with its type, and nothing else may be defined.
"""

from zerodrift_proof.equality.model import (
    FLAG_CLAMPED,
    FLAG_DAMAGED,
    FLAG_INPUT_RANGE,
    FLAG_NO_READING,
    FLAG_RATE_RANGE,
    FLAG_TARED,
    FLAG_TEMPERATURE_RANGE,
    FLAG_WARMING_UP,
    FORMAT,
    Model,
)
from zerodrift_proof.equality.syntax import PProgram

SAVED_EXTRA_BYTES = 16
"""What a saved state has beside the state."""
MANIFEST = "manifest.json"
FAULTS = {"REPLAY": 1, "TABLES": 2}
"""What a self-test may return."""
UNSIGNED = ("MODEL_ID", "SAMPLE_PERIOD_US", "FLAG_", "FAULT_")
"""Macros that begin so, behind the prefix, are of uint32_t; other numbers are plain ones."""
UNTOLD = ("H", "CODE_ID")
"""Macros that say nothing of the model: against a second inclusion, and files of two
generations."""


def find_difference(model: Model, prefix: str, program: PProgram) -> str:
    """Return what a header says otherwise than the model; "" where all is the same.

    Args:
        model: the integer model.
        prefix: of the C's names.
        program: the C as it was read.
    """
    return _compare_macros(model, prefix, program) or _compare_functions(model, prefix, program)


def _list_expected(model: Model) -> dict[str, int | str]:
    """Return the names that an application reads -> what the model says of each."""
    told: dict[str, int | str] = {
        "FORMAT": FORMAT,
        "MODEL_HASH": model.hash,
        "MODEL_ID": model.identity,
        "MANIFEST": MANIFEST,
        "CHANNELS": len(model.channels),
        "OUTPUTS": len(model.outputs),
    }
    if model.sample_period_us is not None:
        told["SAMPLE_PERIOD_US"] = model.sample_period_us
    for index, (name, output) in enumerate(zip(model.output_names, model.outputs, strict=True)):
        told[name.upper()] = index
        told[f"{name.upper()}_LSB_PER_UNIT"] = output.lsb_per_unit
    told |= {
        "FLAG_WARMING_UP": FLAG_WARMING_UP,
        "FLAG_TEMPERATURE_RANGE": FLAG_TEMPERATURE_RANGE,
        "FLAG_RATE_RANGE": FLAG_RATE_RANGE,
        "FLAG_CLAMPED": FLAG_CLAMPED,
        "FLAG_DAMAGED": FLAG_DAMAGED,
    }
    if model.guards.ranges:
        told["FLAG_INPUT_RANGE"] = FLAG_INPUT_RANGE
    if model.optional:
        told["FLAG_NO_READING"] = FLAG_NO_READING
    if model.tare:
        told["FLAG_TARED"] = FLAG_TARED
    return told | {f"FAULT_{name}": value for name, value in FAULTS.items()}


def _compare_macros(model: Model, prefix: str, program: PProgram) -> str:
    upper = f"{prefix.upper()}_"
    wanted = {
        f"{upper}{name}": _write(name, value) for name, value in _list_expected(model).items()
    }
    wanted[f"{upper}SAVED_BYTES"] = f"({SAVED_EXTRA_BYTES}u+sizeof({prefix}_state_t))"
    if model.forced:
        wanted[f"{upper}FORCED"] = "1"
    found = {
        name: "".join(words)
        for name, words in program.tokens.macros.items()
        if name.startswith(upper) and name.removeprefix(upper) not in UNTOLD
    }
    for name in (*wanted, *found):
        if found.get(name) != wanted.get(name):
            said = found.get(name, "not defined")
            return f"{name} is {said}; the model gives {wanted.get(name, 'no such name')}"
    return ""


def _write(name: str, value: int | str) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    return f"UINT32_C({value})" if name.startswith(UNSIGNED) else str(value)


def _compare_functions(model: Model, prefix: str, program: PProgram) -> str:
    wanted = {f"{prefix}_{name}": told for name, told in _list_functions(model, prefix).items()}
    for name in (*wanted, *sorted(program.public)):
        found = program.declared.get(name) if name in program.public else None
        if found != wanted.get(name):
            said = found or "not declared"
            return f"{name} is {said}; the model gives {wanted.get(name, 'no such function')}"
        if name not in program.functions:
            return f"{name} is declared and not defined"
    return ""


def _list_functions(model: Model, prefix: str) -> dict[str, str]:
    """Return the functions of a header -> result and parameters, macros replaced."""
    state, given = f"{prefix}_state_t * s", f"const {prefix}_input_t * in"
    drift = f"int32_t drift [ {len(model.outputs)} ]"
    saved = f"uint8_t saved [ ( {SAVED_EXTRA_BYTES}u + sizeof ( {prefix}_state_t ) ) ]"
    found = {
        "init": f"void ( {state} )",
        "settle": f"void ( {state} , {given} )",
        "step": f"uint32_t ( {state} , {given} , {drift} )",
        "selftest": "uint32_t ( void )",
        "save": f"void ( const {state} , {saved} )",
        "restore": f"uint32_t ( {state} , const {saved} )",
    }
    if model.variable_step:
        found["step_after"] = f"uint32_t ( {state} , {given} , uint64_t elapsed_us , {drift} )"
        found["restore_after"] = f"uint32_t ( {state} , const {saved} , uint64_t age_us )"
    if model.tare:
        found |= dict.fromkeys(("tare", "untare"), f"void ( {state} )")
    return found
