"""Generated C under Frama-C's Eva, which other people wrote: `python -m tests.certificate.eva`.

Eva runs a program over intervals and names every operation for which it cannot show that C defines
it: overflow, a narrowing that loses bits, an index outside, a shift too far, reading what was never
written. Here it runs each golden model from a new state, from rest and from a state of any bits,
with any input; and of the first one `selftest`, the table of tanh, `save` and `restore`.

It reads a copy of the C with annotations put between the lines; no line is changed:

- cases are told apart: a state that is sound and one that is not, the table's lines, the rounds of
  a loop. This changes no meaning, and Eva itself shows that the cases are all there are.
- some functions of the runtime are put in by what they give. Of the table of tanh and the CRC a
  run of its own shows it. Of `zd_gru_move`, which keeps |h| within its limit, it is taken from the
  certificate's `invariants`: a product of two intervals does not show it.

What is used of C: an int of 32 bits, unsigned numbers wrap around, and a negative number is shifted
right as the runtime asserts. The kernel in plain C is run; assembly and intrinsics are not.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.errors import CheckError
from zerodrift.c_runtime.host import render_sources
from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift.export.model_files import load_model

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
LIMIT_S = 600
LAST_LINE = 511
"""tanh has a line for each 2048 counts of its argument, from -512 to this one."""


@dataclass(frozen=True)
class EvaResult:
    """What Eva said of one program."""

    alarms: tuple[str, ...]
    """Each with file and line of the annotated copy."""
    unreached: tuple[str, ...]
    """Functions that should have been run and whose end was not reached."""

    def list_findings(self) -> list[str]:
        """Return what is wrong, in words; empty if nothing is."""
        return [*self.alarms, *(f"{name}: its end was not reached" for name in self.unreached)]


def find_frama_c() -> str | None:
    """Return Frama-C's path."""
    return shutil.which("frama-c")


def annotate(files: dict[str, str], source_name: str) -> dict[str, str]:
    """Return the files with annotations put between their lines.

    Args:
        files: text of model and runtime, by the name of the file.
        source_name: that of the model's C.

    Raises:
        CheckError: a place for an annotation is not found.
    """
    lines = [f"{2048 * k} <= t_q16 < {2048 * (k + 1)}" for k in range(-LAST_LINE, LAST_LINE)]
    ends = [f"t_q16 < {-2048 * LAST_LINE}", f"{2048 * LAST_LINE} <= t_q16"]
    pieces = f"/*@ assert pieces: {' || '.join([ends[0], *lines, ends[1]])}; */"
    of_tanh = (
        "/*@ assigns \\result \\from t_q16; ensures line: -1073709056 <= \\result <= 1073709056; */"
    )
    of_move = (
        "/*@ requires in: -1073709057 <= h_q30 <= 1073709057 && -1073709056 <= n_q30 <= 1073709056"
        " && u_q31 >= 0; assigns \\result \\from h_q30, n_q30, u_q31;"
        " ensures stays: -1073709057 <= \\result <= 1073709057; */"
    )
    of_word = "/*@ assigns \\result \\from crc, x; */"
    apart = "/*@ dynamic_split sound; */"
    return {
        **files,
        "zd_network.h": _insert(
            files["zd_network.h"],
            (r"^static inline int32_t zd_read_q30\(.*\{$", "", pieces),
            (r"^static inline int32_t zd_tanh_q30\(", of_tanh, ""),
        ),
        "zd_gru_portable.h": _insert(
            files["zd_gru_portable.h"],
            (r"^static inline int32_t zd_gru_move\(", of_move, ""),
            (r"^    uint32_t sound = 1u;$", "", apart),
        ),
        "zd_signals.h": _insert(
            files["zd_signals.h"], (r"^    uint32_t n = 30u;$", "", "/*@ loop unroll 31; */")
        ),
        "zd_runtime.c": _insert(
            files["zd_runtime.c"], (r"^ZD_SHARED_CODE uint32_t zd_crc32_word\(", of_word, "")
        ),
        source_name: _insert(
            files[source_name],
            (r"^    uint32_t sound = .*;$", "", f"{apart}\n/*@ split s->steps == 0; */"),
        ),
    }


def _insert(text: str, *places: tuple[str, str, str]) -> str:
    """Return the text with lines put before and after the only line of each pattern."""
    for pattern, before, after in places:
        found = list(re.finditer(pattern, text, re.MULTILINE))
        if len(found) != 1:
            raise CheckError(f"{len(found)} lines match {pattern}; expected one to annotate")
        start = found[0].start()
        end = text.index("\n", start) + 1
        line = text[start:end]
        head, tail = (f"{note}\n" if note else "" for note in (before, after))
        text = text[:start] + head + line + tail + text[end:]
    return text


def write_model_driver(code: GeneratedCode) -> str:
    """Return the C of a program that steps a model with any input, from every kind of state."""
    prefix = code.source_name.removesuffix(".c")
    return f"""#include "{code.source_name}"
#include "zd_runtime.c"
#include "__fc_builtin.h"
int main(void) {{
    {prefix}_state_t s;
    {prefix}_input_t in;
    int32_t drift[{prefix.upper()}_OUTPUTS];
    Frama_C_make_unknown((char *)&in, sizeof in);
    switch (Frama_C_interval(0, 2)) {{
    case 0: {prefix}_init(&s); break;
    case 1: {prefix}_settle(&s, &in); break;
    default: Frama_C_make_unknown((char *)&s, sizeof s); break;
    }}
    (void){prefix}_step(&s, &in, drift);
    return 0;
}}
"""


def write_runtime_driver(code: GeneratedCode) -> str:
    """Return the C of a program that runs what the models' programs take for granted."""
    prefix = code.source_name.removesuffix(".c")
    return f"""#include "{code.source_name}"
#include "zd_runtime.c"
#include "__fc_builtin.h"
int main(void) {{
    {prefix}_state_t s;
    uint8_t saved[{prefix.upper()}_SAVED_BYTES];
    int32_t t;
    uint32_t words[2];
    Frama_C_make_unknown((char *)&t, sizeof t);
    Frama_C_make_unknown((char *)words, sizeof words);
    switch (Frama_C_interval(0, 2)) {{
    case 0: return zd_tanh_q30(t);
    case 1: return zd_crc32_word(words[0], words[1]) != 0u;
    default: break;
    }}
    Frama_C_make_unknown((char *)saved, sizeof saved);
    (void){prefix}_restore(&s, saved);
    {prefix}_save(&s, saved);
    return 0;
}}
"""


def write_selftest_driver(code: GeneratedCode) -> str:
    """Return the C of a program that runs the self-test."""
    prefix = code.source_name.removesuffix(".c")
    return f"""#include "{code.source_name}"
#include "zd_runtime.c"
int main(void) {{ return (int){prefix}_selftest(); }}
"""


def check_model(code: GeneratedCode, folder: Path) -> EvaResult:
    """Run a model under Eva.

    Args:
        code: the model's C.
        folder: an empty one, for the copies.

    Raises:
        CheckError: Frama-C is not there, does not finish, or refuses the C.
    """
    prefix = code.source_name.removesuffix(".c")
    wanted = [f"{prefix}_{name}" for name in ("init", "settle", "step", "advance")]
    return _run(code, write_model_driver(code), folder, ("zd_tanh_q30", "zd_gru_move"), wanted)


def check_runtime(code: GeneratedCode, folder: Path) -> EvaResult:
    """Run under Eva what `check_model` takes for granted, with the files of any model."""
    prefix = code.source_name.removesuffix(".c")
    wanted = ["zd_tanh_q30", _name_of(code, "zd_crc32_word"), f"{prefix}_restore", f"{prefix}_save"]
    return _run(code, write_runtime_driver(code), folder, (), wanted)


def check_selftest(code: GeneratedCode, folder: Path) -> EvaResult:
    """Run a model's self-test under Eva."""
    specified = ("zd_tanh_q30", "zd_gru_move", _name_of(code, "zd_crc32_word"))
    wanted = [f"{code.source_name.removesuffix('.c')}_selftest"]
    return _run(code, write_selftest_driver(code), folder, specified, wanted)


def _name_of(code: GeneratedCode, name: str) -> str:
    """Return a function's name with the runtime's identity, as the preprocessor has it."""
    found = re.search(
        rf"^#define {name} (\w+)$", render_sources(code)["zd_runtime.h"], re.MULTILINE
    )
    return found[1] if found else name


def _run(
    code: GeneratedCode, driver: str, folder: Path, specified: tuple[str, ...], wanted: list[str]
) -> EvaResult:
    path = find_frama_c()
    if path is None:
        raise CheckError("frama-c is not installed: make setup-frama-c")
    for name, text in annotate(render_sources(code), code.source_name).items():
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "driver.c").write_text(driver, encoding="utf-8")
    prefix = code.source_name.removesuffix(".c")
    precise = f"{prefix}_state_is_sound:0,zd_gru_state_is_sound:0,zd_power:100,zd_read_q30:3000"
    command = [
        path, "-eva", "-eva-precision", "6", "-eva-slevel", "10", "-eva-slevel-function", precise,
        "-eva-interprocedural-splits", "-warn-signed-downcast", "-machdep", "gcc_x86_64",
        f"-cpp-extra-args=-I{folder} -DZD_KERNEL=0",
    ]  # fmt: skip
    if specified:
        command += ["-eva-use-spec", ",".join(specified)]
    try:
        done = subprocess.run(
            [*command, str(folder / "driver.c")],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
            timeout=LIMIT_S,
        )
    except subprocess.TimeoutExpired as error:
        raise CheckError(f"frama-c did not finish {prefix} in {LIMIT_S} s") from error
    if done.returncode != 0 or "alarms generated by the analysis" not in done.stdout.replace(
        "alarm generated", "alarms generated"
    ):
        raise CheckError(f"frama-c refused {prefix}:\n{done.stdout[-2000:]}{done.stderr[-500:]}")
    return read_log(done.stdout, wanted)


def read_log(log: str, wanted: list[str]) -> EvaResult:
    """Return the alarms in what Eva printed, and which of the wanted functions never ended."""
    alarms = re.findall(r"^\[eva:alarm\] ((?:.*)(?:\n  .*)*)", log, re.MULTILINE)
    told = tuple(re.sub(r"\s+", " ", alarm) for alarm in alarms)
    ended = re.findall(r"Values at end of function (\w+):", log)
    return EvaResult(told, tuple(name for name in wanted if name not in ended))


def main() -> int:
    """Print what Eva finds in each golden model; 1 if it finds anything, 2 if it is not there."""
    parser = argparse.ArgumentParser(description="Golden models under Frama-C's Eva.")
    known = sorted(path.name.split(".")[0] for path in GOLDEN.glob("*.model.json"))
    parser.add_argument("models", nargs="*", metavar="MODEL", help=f"of {', '.join(known)}; all")
    names = parser.parse_args().models or known
    if find_frama_c() is None:
        print("frama-c is not installed: make setup-frama-c", file=sys.stderr)
        return 2
    bad = 0
    for name in names:
        code = generate(load_model(GOLDEN / f"{name}.model.json"))
        programs = [("model", check_model)]
        if name == names[0]:
            programs += [("selftest", check_selftest), ("runtime", check_runtime)]
        for what, check in programs:
            with tempfile.TemporaryDirectory() as scratch:
                before = os.times().children_user
                found = check(code, Path(scratch)).list_findings()
                spent = os.times().children_user - before
            print(
                f"{name}, {what}: {len(found)} alarms, {spent:.1f} s",
                *found,
                sep="\n  ",
                flush=True,
            )
            bad += bool(found)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
