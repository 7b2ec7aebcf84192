"""Formulas outside the catalogue on simulated sensors: found, how good, and how often falsely.

    python -m benchmarks.bench_propose [--seeds N] [--without N] [--first-seed N] [--c]
                                       [--file FILE] [--minutes M]
    python -m benchmarks.bench_propose --large

The sensors are those of `formula_cases`, which shares no code with the search. Each has 4 to 8
training runs, an effect of one or two operations that the catalogue lacks, 2 to 10 times the noise,
and two test runs that nothing is chosen by. The marks: the right form, or predictions within a
tenth of the noise on the test runs, in 85 %; error over the floor after adding, median 1.10; a
formula for a complete model or a pure disturbance in at most 3 of 300; 60 CPU s for a search in 8
runs of 20,000 rows with 6 outputs and 5 channels. Where an effect of the catalogue is named
instead, it is added as `add` does and counts by its predictions; how many is printed. *--c* takes
each formula through its file and the integers to C, which is compiled here and has to equal the
reference in every bit. Outcomes are appended to FILE, and those that it has are not run again.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.bench_conditions import bound
from benchmarks.formula_cases import DISTURBANCES, FORMS, Simulated, simulate
from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig, OutputConfig
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.changes import propose_forms
from zerodrift.diagnosis.formula.proposal import FormulaSearch, propose_formula, render_file
from zerodrift.diagnosis.revision import revise_best
from zerodrift.export.compose import compose_integer_model, describe_compensator, encode_inputs
from zerodrift.export.reference import Reference
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.fit import fit_config
from zerodrift.physics.model import PhysicalModel
from zerodrift.tasks.propose import search_formula
from zerodrift.train.prepare import read_settings, stand_alone

WITHIN = 0.1
"""Predictions this close, in units of the noise, are as good as the right form."""
RIGHT = {
    "light - LP(light)": {"(ambient_light - LP(ambient_light, tau_s))"},
    "|T - LP(T)|": {"|T - LP(T, tau_s)|"},
    "(T - a) (humidity - b)": {
        "(T - origin_a) * humidity",
        "T * (humidity - origin_b)",
        "(T - origin_a) * (humidity - origin_b)",
    },
    "max(supply, c)": {"max(supply, threshold)"},
    "delay(ambient_light)": {"delay(ambient_light, delay_s)"},
    "play(humidity)": {"play(humidity, half_width)"},
    "LP((supply - 4 V)^2)": {"LP((supply - origin)^2, tau_s)"},
    "load (LP(humidity) - b)": {"(LP(humidity, tau_s) - origin_a) * load_Fz"},
    "2^(humidity / d)": {"2^(humidity / doubling)"},
    "sqrt(ambient_light)": {"sqrt(ambient_light)"},
    "max(T, body_temperature)": {"max(T, body_temperature)"},
    "(body_temperature - T)^2": {"(T - body_temperature)^2"},
}
"""How `propose` writes each form, names for its numbers."""


@dataclass(frozen=True)
class Scored:
    """One case's end."""

    kind: str
    seed: int
    told: str
    """The formula, or why there is none."""
    right: bool
    apart: float | None
    """RMS difference from the truth on test runs, in units of the noise; None: nothing is named."""
    ratio: float
    """Error over the floor on test runs, with what is named."""
    found: bool
    """Whether it is a formula."""
    cpu_s: float
    checked: bool | None
    """Whether its C equals the reference in every bit; None: not tried."""

    @property
    def is_good(self) -> bool:
        """Whether it has the right form, or predicts as closely."""
        return self.right or (self.apart is not None and self.apart < WITHIN)


def main(quick: bool) -> None:
    """Print every figure; `quick` takes one seed of each form."""
    run_cases(list_cases(1 if quick else 3, 8 if quick else 30, 5000), None, 1e9)
    if not quick:
        time_large()


def list_cases(seeds: int, without: int, first_seed: int) -> Iterator[tuple[str, int]]:
    """Give the kinds and seeds of all cases, those with and without a formula in turn."""
    kinds = ("complete", *DISTURBANCES)
    forms = [(kind, first_seed + 100 * n + k) for n in range(seeds) for k, kind in enumerate(FORMS)]
    others = [(kinds[n % len(kinds)], first_seed + 50_000 + n) for n in range(without)]
    for n in range(max(len(forms), len(others))):
        yield from (cases[n] for cases in (forms, others) if n < len(cases))


def run_cases(
    wanted: Iterator[tuple[str, int]], file: Path | None, minutes: float, *, to_c: bool = False
) -> None:
    """Run what the file does not have yet, as long as there is time; print all."""
    print("simulated sensors; all logs here are simulated")
    done = read_scored(file)
    begin = time.time()
    scored = []
    for kind, seed in wanted:
        one = done.get((kind, seed))
        if one is None:
            if time.time() - begin > 60.0 * minutes:
                continue
            one = score(kind, seed, to_c=to_c)
            if file is not None:
                with file.open("a", encoding="utf-8") as out:
                    out.write(json.dumps(asdict(one)) + "\n")
        scored.append(one)
    tell_forms([one for one in scored if one.kind in FORMS])
    tell_others([one for one in scored if one.kind not in FORMS])


def read_scored(file: Path | None) -> dict[tuple[str, int], Scored]:
    """Return the outcomes that a file has."""
    if file is None or not file.exists():
        return {}
    lines = file.read_text(encoding="utf-8").splitlines()
    return {(one.kind, one.seed): one for one in (Scored(**json.loads(line)) for line in lines)}


def tell_forms(scored: Sequence[Scored]) -> None:
    """Print how the sensors fared that hide a form."""
    if not scored:
        return
    for kind in FORMS:
        mine = [one for one in scored if one.kind == kind]
        good = sum(one.is_good for one in mine)
        missed = [f"{one.seed}: {one.told}" for one in mine if not one.is_good]
        print(f"  {kind:28} {good} of {len(mine)}  {'; '.join(missed)}")
    print(
        f"right form or within {WITHIN:g} of the noise: "
        f"{tell_least(sum(one.is_good for one in scored), len(scored))}"
    )
    print(f"the right form: {tell_least(sum(one.right for one in scored), len(scored))}")
    named = [one for one in scored if one.apart is not None and not one.found]
    good = sum(one.is_good for one in named)
    print(f"an effect of the catalogue named instead: {len(named)}, {good} of them as close")
    ratios = [one.ratio for one in scored]
    print(f"error over floor on test runs: median {np.median(ratios):.3f}, worst {max(ratios):.2f}")
    seconds = [one.cpu_s for one in scored]
    print(f"CPU seconds of a search: median {np.median(seconds):.1f}, most {max(seconds):.1f}")
    tried = [one.checked for one in scored if one.checked is not None]
    if tried:
        print(f"to C, equal to the reference in every bit: {tell_least(sum(tried), len(tried))}")


def tell_others(scored: Sequence[Scored]) -> None:
    """Print how often a formula was found where there is none."""
    if not scored:
        return
    false = [one for one in scored if one.found]
    for one in false:
        print(f"  FALSE {one.kind}, seed {one.seed}: {one.told}")
    most = bound(len(false), len(scored), upper=True)
    print(
        f"a formula where there is none: {len(false)} of {len(scored)} "
        f"(at most {100.0 * most:.1f} % with 95 % confidence)"
    )


def draw_case(kind: str, seed: int) -> Simulated:
    """Return a simulated sensor of a size and a number of runs that the seed draws."""
    rng = np.random.default_rng(seed)
    size, runs = float(np.exp(rng.uniform(np.log(2.0), np.log(10.0)))), int(rng.integers(4, 9))
    return simulate(kind, size, runs, seed)


def take_model(case: Simulated, found: FormulaSearch) -> PhysicalModel:
    """Return the model with what is named: a formula, an effect of the catalogue, or nothing."""
    if found.formula is not None:
        return found.formula.revision.after.model
    catalogue = load_catalogue()
    train = replace(case.dataset, test=())
    if not found.suffices:
        return fit_config(case.config, train, catalogue)
    forms = propose_forms(case.config, train, catalogue, EffectConfig(found.suffices))
    return revise_best(case.config, train, catalogue, forms).after.model


def score(kind: str, seed: int, *, to_c: bool = False) -> Scored:
    """Return what `propose` makes of one simulated sensor.

    Args:
        kind: as `simulate` takes it.
        seed: draws the sensor.
        to_c: whether a formula goes to C, and the C is checked against the reference.
    """
    case = draw_case(kind, seed)
    start = time.process_time()
    found = propose_formula(case.config, case.dataset, load_catalogue())
    cpu_s = time.process_time() - start
    formula = found.formula
    apart, ratio = _compare(case, take_model(case, found))
    if formula is None:
        near = apart if found.suffices else None
        return Scored(kind, seed, found.reason, False, near, ratio, False, cpu_s, None)
    one = formula.expressions[0].write() if len(formula.expressions) == 1 else ""
    right = one in RIGHT.get(kind, set())
    checked = check_c(case, found) if to_c else None
    return Scored(kind, seed, formula.write(), right, apart, ratio, True, cpu_s, checked)


def check_c(case: Simulated, found: FormulaSearch) -> bool:
    """Return whether a formula's file becomes an effect, and that C, equal in every bit.

    The model with the effect, fitted, is turned into integers; its C is compiled for this machine
    and run over the test runs beside the reference.
    """
    assert found.formula is not None
    kind = found.formula.effect.kind
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "effect.py"
        file.write_text(render_file(found.formula), encoding="utf-8")
        catalogue = load_catalogue((file,))
        config = replace(case.config, effects=(*case.config.effects, EffectConfig(kind)))
        physics = fit_config(config, replace(case.dataset, test=()), catalogue)
        alone = stand_alone(config, case.dataset, physics, read_settings(config.network))
        described = describe_compensator(alone, config, case.dataset.train)
        model = compose_integer_model(described, config, case.dataset)
        host = HostModel(model, generate(model), Path(folder) / "c", observe=False)
        equal = []
        for run in case.dataset.test:
            codes = encode_inputs(model, run)
            trace, told = Reference(model).run(codes[None]), host.run(codes)
            equal.append(np.array_equal(trace.drift[0], told.drift))
            equal.append(np.array_equal(trace.flags[0], told.flags))
    return all(equal)


def _compare(case: Simulated, model: PhysicalModel) -> tuple[float, float]:
    """Return how far predictions are from the truth, and errors over the noise, on test runs."""
    apart: list[Array] = []
    left: list[Array] = []
    noise: list[Array] = []
    for run in case.dataset.test:
        prediction, truth = model.predict(run), case.truth[run.name]
        for rows, difference in (
            (apart, prediction - truth),
            (left, run.drift - prediction),
            (noise, run.drift - truth),
        ):
            rows.append(((difference - difference.mean(axis=0)) / case.noise) ** 2)
    rms = [float(np.sqrt(np.concatenate(rows).mean())) for rows in (apart, left, noise)]
    return rms[0], rms[1] / rms[2]


def tell_least(good: int, of: int) -> str:
    """Return a rate with the bound that it exceeds with 95 % confidence (Clopper-Pearson)."""
    least = bound(good, of, upper=False)
    return f"{good} of {of} ({100.0 * good / of:.0f} %; above {100.0 * least:.0f} %)"


def time_large() -> None:
    """Time a search in 8 runs of 20,000 rows with 6 outputs and 5 channels."""
    case = simulate("light - LP(light)", 4.0, 8, 1)
    names = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
    rng = np.random.default_rng(1)

    def stretch(run: Run) -> Run:
        """Return the run with each sample held for 14, and six outputs with loads of their own."""
        rows = 20_000
        place = np.minimum(np.arange(rows) * len(run) // rows, len(run) - 1)
        load = np.repeat(rng.uniform(-50.0, 50.0, (40, 6)), rows // 40, axis=0)
        load *= float(np.ptp(run.reference)) > 0.0
        drift = run.drift[place][:, [0, 0, 0, 1, 1, 1]]
        drift = drift + 0.05 * rng.standard_normal((rows, 6))
        inputs = {name: x[place] for name, x in run.inputs.items()}
        inputs["acceleration_x"] = rng.standard_normal(rows)
        return replace(
            run,
            time_s=run.sample_period_s * np.arange(rows),
            temperature_degC=run.temperature_degC[place],
            measured=load + drift,
            reference=load,
            inputs=inputs,
        )

    data = case.dataset
    large = Dataset(
        train=tuple(stretch(run) for run in data.train),
        test=(),
        dwell=tuple(stretch(run) for run in data.dwell),
        outputs=names,
        units=("N",) * 3 + ("Nm",) * 3,
        full_scale=(200.0,) * 3 + (14.0,) * 3,
    )
    six = zip(names, large.units, large.full_scale, strict=True)
    outputs = tuple(OutputConfig(name, name, f"ref_{name}", unit, full) for name, unit, full in six)
    config = replace(case.config, outputs=outputs)
    start = time.process_time()
    found = propose_formula(config, large, load_catalogue())
    cpu_s = time.process_time() - start
    print(
        f"8 runs x 20,000 rows x 6 outputs x 5 channels: {cpu_s:.0f} CPU s, {found.forms} formulas,"
        f" {found.tried} columns; {found.reason}"
    )
    start = time.process_time()
    search_formula(config, large, load_catalogue())
    print(f"the same with the black boxes: {time.process_time() - start:.0f} CPU s")


def parse(arguments: Sequence[str] | None = None) -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="of each form")
    parser.add_argument("--without", type=int, default=30, help="sensors without a formula")
    parser.add_argument("--first-seed", type=int, default=5000)
    parser.add_argument("--c", action="store_true", help="take each formula to checked C")
    parser.add_argument("--file", type=Path, help="keeps the outcomes")
    parser.add_argument("--minutes", type=float, default=1e9)
    parser.add_argument("--large", action="store_true", help="only the time of a large search")
    options = parser.parse_args(arguments)
    if options.large:
        time_large()
        return
    cases = list_cases(options.seeds, options.without, options.first_seed)
    run_cases(cases, options.file, options.minutes, to_c=options.c)


if __name__ == "__main__":
    parse()
