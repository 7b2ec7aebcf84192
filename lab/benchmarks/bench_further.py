"""The cheapest programme for further units: the error it promises, and the one that comes.

    python -m benchmarks.bench_further [--designs N] [--first-seed N]

For each design of the twin (a straight zero shift and a thermal lag of its own): unit 1 has four
chamber logs; `plan --units 999` says how few hours a further unit needs to a target, drawn between
a tenth of the noise floor and all of it. That programme is done to a second unit, which shares the
lag's time constant and nothing else; its model, with unit 1's fitted time constant held, predicts a
chamber log that nothing was chosen by. Printed are hours, the promised error and the true one:
model less the drift without noise, each without its mean. All logs are simulated.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.planned_sensors import LIMITS, LOOKED_AT, PERIOD_S, keep_outputs, record_plan
from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig, parse_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.floor import measure_floor
from zerodrift.discovery.plan import Question
from zerodrift.discovery.precise import PlannedPrecisely, plan_precisely
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.fit import fit, fit_config
from zerodrift_lab.twin.project import render_config, to_dataset
from zerodrift_lab.twin.recipe import EffectChoice, Recipe
from zerodrift_lab.twin.sensor import OUTPUTS
from zerodrift_lab.twin.simulate import Simulation, simulate

BUDGET_S = 10.0
FURTHER = 999
EFFECTS = (EffectConfig("zero_tempco"), EffectConfig("thermal_lag"))


def make_unit(seed: int, tau_s: float, runs: int) -> Simulation:
    """Return a unit of a design with so many hours of chamber logs, and one to be tried on."""
    straight = EffectChoice("zero_tempco", None, {"order": 1.0})
    told = (straight, EffectChoice("thermal_lag", None, {"tau_s": tau_s}))
    recipe = Recipe(
        seed=seed,
        train=("chamber",) * runs,
        test=("chamber",),
        told=told,
        sample_period_s=PERIOD_S,
    )
    return simulate(recipe)


def take_outputs(dataset: Dataset) -> Dataset:
    """Return the logs of the outputs that are looked at, test logs too."""
    kept = keep_outputs(dataset)
    tests = keep_outputs(replace(dataset, train=dataset.test)).train
    return replace(kept, test=tests)


def try_design(seed: int) -> tuple[float, float, float, float] | None:
    """Return hours, and over the noise floor target, promised and true error; None: no plan."""
    rng = np.random.default_rng(seed)
    tau_s, size = float(rng.uniform(30.0, 300.0)), float(np.exp(rng.uniform(np.log(0.1), 0.0)))
    first = make_unit(seed, tau_s, 4)
    head = render_config(first).split("\n[[effect]]\n")[0] + "\n"
    for name in set(OUTPUTS) - set(LOOKED_AT):
        before, _, after = head.partition(f"[outputs.{name}]\n")
        head = before + after.partition("\n\n")[2]
    effects = "".join(f'[[effect]]\nkind = "{effect.kind}"\n' for effect in EFFECTS)
    config = parse_config(head + effects + LIMITS, Path("/bench/zerodrift.toml"))
    dataset = take_outputs(to_dataset(first))
    floor = measure_floor(dataset).rms
    target = size * float(np.max(floor / np.array(dataset.full_scale)))
    question = Question(8.0, target=target, budget_s=BUDGET_S, units=FURTHER)
    question = replace(question, profile=dataset.test[0].name)
    catalogue = load_catalogue()
    try:
        planned = plan_precisely(config, dataset, catalogue, question)
    except InputError:
        return None
    model = fit_config(config, replace(dataset, test=()), catalogue)
    (lag,) = [f.term for f in model.terms if f.term.effect.kind == "thermal_lag"]
    second = make_unit(seed + 500_000, tau_s, 1)
    true = measure_true(second, planned, dict(lag.values))
    aimed = target * np.array(dataset.full_scale)
    promised = np.array([planned.errors[name] for name in LOOKED_AT])
    worst = int(np.argmax(promised / aimed))
    shares = [float((x / floor)[worst]) for x in (aimed, promised, true)]
    return planned.programme.hours, shares[0], shares[1], shares[2]


def measure_true(unit: Simulation, planned: PlannedPrecisely, held: dict[str, float]) -> Array:
    """Return [K] the true error of a further unit's model on the log that it is tried on."""
    logs = keep_outputs(record_plan(unit, planned))
    effects = (EFFECTS[0], EffectConfig("thermal_lag", held))
    model = fit(
        effects,
        logs.train,
        outputs=logs.outputs,
        units=logs.units,
        full_scale=logs.full_scale,
        catalogue=load_catalogue(),
    )
    dataset = take_outputs(to_dataset(unit))
    (simulated,) = unit.select("test")
    kept = [OUTPUTS.index(name) for name in LOOKED_AT]
    error = model.predict(dataset.test[0]) - simulated.drift[:, kept]
    return np.asarray((error - error.mean(axis=0)).std(axis=0))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--designs", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=100)
    options = parser.parse_args(arguments)
    print("simulated units; errors over the noise floor")
    found = []
    for n in range(options.designs):
        one = try_design(options.first_seed + n)
        if one is None:
            print(f"  design {n}: no programme of a day reaches the target", flush=True)
            continue
        found.append(one)
        print(
            f"  design {n}: {one[0]:.2f} h, target {one[1]:.2f}, promised {one[2]:.3f}, "
            f"true {one[3]:.3f}",
            flush=True,
        )
    if found:
        ratio: Array = np.array([one[3] / one[2] for one in found])
        within = sum(one[3] <= one[1] for one in found)
        print(
            f"true over promised: RMS {np.sqrt(np.mean(ratio**2)):.2f}, median "
            f"{np.median(ratio):.2f}, {ratio.min():.2f} to {ratio.max():.2f}; within the target "
            f"{within} of {len(found)}"
        )


if __name__ == "__main__":
    main()
