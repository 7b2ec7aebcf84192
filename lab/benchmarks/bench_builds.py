"""The C in real builds: RAM on an ATmega328P, stack by compiler, the guard of the state."""

import importlib.util
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from zerodrift.base.config import EffectConfig, NetworkConfig, load_config
from zerodrift.c_runtime.compilers import Compiler
from zerodrift.c_runtime.cores import GCC_CORES, find_cross_compilers
from zerodrift.c_runtime.footprint import measure_footprint
from zerodrift.c_runtime.host import write_sources
from zerodrift.codegen.generate import generate
from zerodrift.dataset.load import load_dataset
from zerodrift.export.compose import compose_integer_model, describe_compensator
from zerodrift.export.integer_model import FLAG_DAMAGED, IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.train.training import train
from zerodrift.verify.vectors import draw_sequences
from zerodrift_lab.twin.example import ensure_example_logs

ROOT = Path(__file__).parents[2]
MODELS = ("ordinary", "front_end", "effects", "windowed")
PHYSICS = (
    ("zero_tempco",),
    ("zero_tempco", "dark_current", "thermal_lag", "thermal_hysteresis", "warm_up", "creep"),
)
AVR = Compiler("avr-gcc", ("avr-gcc", "-mmcu=atmega328p"))
AVR_MAIN = """
#include "{p}.h"
volatile int16_t reading;
volatile int32_t answer;
int main(void) {{
    {p}_state_t state;
    {p}_input_t in = {{0}};
    int32_t drift[{P}_OUTPUTS];
    {p}_settle(&state, &in);
    for (;;) {{
        in.{channel} = reading;
        (void){p}_step(&state, &in, drift);
        answer = drift[0];
    }}
}}
"""


def main(quick: bool) -> None:
    """Print RAM on an 8-bit core, stack by compiler, and what the guard sees and costs."""
    names = MODELS[:1] if quick else MODELS
    print_avr()
    print_stacks(names)
    print_guard(names)


def print_avr() -> None:
    """Print data, bss and state of examples/ft40 without a network on an ATmega328P."""
    if shutil.which("avr-gcc") is None:
        print("ATmega328P: no avr-gcc; `make setup-qemu` installs it")
        return
    for kinds in PHYSICS:
        print_avr_of(fit_physics(kinds), " + ".join(kinds))


def print_avr_of(model: IntegerModel, title: str) -> None:
    """Print what one physical model takes of an ATmega328P."""
    code = generate(model)
    for flags in (("-Os",), ("-Os", "-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections")):
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch)
            write_sources(code, folder)
            text = AVR_MAIN.format(
                p=code.prefix, P=code.prefix.upper(), channel=model.channels[0].name
            )
            (folder / "main.c").write_text(text, encoding="utf-8")
            (folder / "state.c").write_text(
                f'#include "{code.header_name}"\n{code.prefix}_state_t state;\n', encoding="utf-8"
            )
            sources = [str(folder / n) for n in ("main.c", code.source_name, "zd_runtime.c")]
            AVR.run(["-std=c99", *flags, *sources, "-o", str(folder / "main.elf")])
            AVR.run(
                [
                    "-std=c99",
                    "-fno-common",
                    "-c",
                    str(folder / "state.c"),
                    "-o",
                    f"{folder}/state.o",
                ]
            )
            program, state = read_sizes(folder / "main.elf"), read_sizes(folder / "state.o")
        ram = program.data + program.bss + state.bss
        print(
            f"ATmega328P, {title}, {' '.join(flags)}: flash {program.text + program.data} B,"
            f" data {program.data} + bss {program.bss} + one state {state.bss} = {ram} B of 2048"
        )


@dataclass(frozen=True)
class Sizes:
    """Sections of an ELF in bytes."""

    text: int
    data: int
    bss: int


def read_sizes(path: Path) -> Sizes:
    """Return what `avr-size` says."""
    done = subprocess.run(["avr-size", str(path)], capture_output=True, text=True, check=True)
    return Sizes(*(int(n) for n in done.stdout.splitlines()[1].split()[:3]))


def fit_physics(kinds: tuple[str, ...]) -> IntegerModel:
    """Return effects alone, fitted to the example's logs, as integers."""
    with tempfile.TemporaryDirectory() as scratch:
        project = Path(scratch) / "ft40"
        project.mkdir()
        for name in ("twin.json", "zerodrift.toml"):
            shutil.copy(ROOT / "examples" / "ft40" / name, project)
        ensure_example_logs(project)
        effects = tuple(EffectConfig(kind) for kind in kinds)
        nothing = NetworkConfig(kind="none")
        config = replace(load_config(project), network=nothing, effects=effects)
        dataset = load_dataset(config)
        config.build_directory.mkdir(exist_ok=True)
        described = describe_compensator(train(config, dataset).compensator, config, dataset.train)
        return compose_integer_model(described, config, dataset)


def print_stacks(names: tuple[str, ...]) -> None:
    """Print the stack of each function by core and compiler, compiled for size."""
    for name in names:
        code = generate(load(name))
        for core in GCC_CORES:
            for compiler in find_cross_compilers(core):
                size = measure_footprint(code, core, compiler=compiler.name)
                stacks = ", ".join(f"{entry} {stack}" for entry, stack in size.stacks)
                told = f"{compiler.name} {' '.join(size.flags)}"
                print(f"stack {name:10} {core:14} {told:8} {stacks}")


def print_guard(names: tuple[str, ...]) -> None:
    """Print flips of the live state that change a drift without a flag, and the guard's cost."""
    if importlib.util.find_spec("unicorn") is None:
        print("guard: no emulator; `pip install unicorn`")
        return
    for name in names:
        for guarded in (False, True):
            flips = list(flip_every_bit(replace(load(name), guarded=guarded)))
            silent = sum(flip == "silent" for flip in flips)
            flagged = sum(flip == "flagged" for flip in flips)
            print(
                f"guard {'on ' if guarded else 'off'} {name:10} cortex-m4: {silent} of {len(flips)}"
                f" flips change the next drifts without a flag, {flagged} are flagged"
            )
        for compiler in find_cross_compilers("cortex-m4"):
            for flags in ("-O2", "-Os"):
                cost, words = measure_cost(load(name), compiler, flags)
                print(
                    f"guard cost {name:10} cortex-m4 {compiler.name} {flags}: {cost} instructions a"
                    f" step for {words:g} words of state, of {4 * words + 60:g}"
                )


def flip_every_bit(model: IntegerModel) -> Iterator[str]:
    """Yield for every bit of a live state what its flip does to ten steps on a Cortex-M4."""
    from zerodrift.c_runtime.emulator import EmulatedModel

    codes = draw_sequences(model, 400)["noise"][:20]
    with tempfile.TemporaryDirectory() as scratch:
        chip = EmulatedModel(model, generate(model), "cortex-m4", Path(scratch))
        whole, flags = chip.run(codes)
        chip.run(codes[:10])
        kept = chip.read_memory("chip_state")
        for bit in range(8 * len(kept)):
            chip.write_memory("chip_state", kept)
            chip.flip_bit("chip_state", bit)
            drift, told = chip.run(codes[10:], restart=False)
            if (told & FLAG_DAMAGED).any():
                yield "flagged"
            else:
                same = np.array_equal(drift, whole[10:]) or (told != flags[10:]).any()
                yield "harmless" if same else "silent"


def measure_cost(model: IntegerModel, compiler: Compiler, flags: str) -> tuple[int, float]:
    """Return the guard's instructions per step, and the words of the guarded state."""
    from zerodrift.c_runtime.emulator import EmulatedModel

    codes = draw_sequences(model, 50)["noise"][:3]
    counts, words = [], 0.0
    for guarded in (False, True):
        form = replace(model, guarded=guarded)
        with tempfile.TemporaryDirectory() as scratch:
            code = generate(form)
            chip = EmulatedModel(form, code, "cortex-m4", Path(scratch), (flags,), compiler)
            counts.append(max(chip.count_instructions(codes)))
            words = len(chip.read_memory("chip_state")) / 4
    return counts[1] - counts[0], words


def load(name: str) -> IntegerModel:
    """Return a golden model."""
    return load_model(ROOT / "tests" / "golden" / f"{name}.model.json")


if __name__ == "__main__":
    main(quick=False)
