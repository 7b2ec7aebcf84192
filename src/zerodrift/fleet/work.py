"""A few sensors from logs to checked C, in one process; a failure of one does not stop the
others.
"""

import json
import pickle
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import ParamSpec, TypeVar

import numpy as np

from zerodrift.base.config import Config
from zerodrift.base.errors import CheckError, ZerodriftError
from zerodrift.base.files import explain_refusal, refuse_foreign
from zerodrift.base.fleet_config import SHARED_RUNTIME
from zerodrift.base.records import render_sealed, to_dict
from zerodrift.c_runtime.compilers import find_compiler, list_runtime
from zerodrift.c_runtime.host import HostModel, build_host_batch
from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.floor import measure_floor
from zerodrift.diagnosis.held_out import TEST_LOGS, HeldOut, hold_out
from zerodrift.diagnosis.referee import explain_refusals, find_refusals
from zerodrift.diagnosis.run_errors import collect_errors, pool_rmse
from zerodrift.export.compose import compose_quantized, describe_compensator
from zerodrift.export.error_bound import ErrorBound, bound_errors
from zerodrift.export.fine_tune import load_or_tune
from zerodrift.export.float_model import FloatModel
from zerodrift.export.integer_model import FORCED, IntegerModel
from zerodrift.fleet.result import (
    OutputResult,
    ParameterResult,
    SensorOutcome,
    SensorResult,
    save_result,
)
from zerodrift.fleet.sensors import Design, configure_sensor
from zerodrift.fleet.summary import EffectValues, SensorConfiguration
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.physics.model import PhysicalModel
from zerodrift.train.compensator import Compensator
from zerodrift.train.prepare import Handling
from zerodrift.train.refits import Original
from zerodrift.train.scores import Trained
from zerodrift.train.training import train_together
from zerodrift.verify.certificate import FILE_NAME as CERTIFICATE
from zerodrift.verify.chip_error import ChipReplay
from zerodrift.verify.firmware import certify_checked, list_sequences
from zerodrift.verify.gate import GateVerdict, judge_firmware
from zerodrift.verify.host_check import check_host, check_starts
from zerodrift.verify.left_out import (
    LeftOut,
    choose_judge,
    leave_out,
    leave_out_together,
    takes_epochs,
)
from zerodrift.verify.manifest import FILE_NAME as MANIFEST
from zerodrift.verify.manifest import write_manifest
from zerodrift.verify.summary import Statement, state_notes
from zerodrift.verify.uncertainty import FILE_NAME as UNCERTAINTY
from zerodrift.verify.uncertainty import measure_firmware

# One sensor's errors held out, beside its noise floor, and the values it is compared by.


@dataclass(frozen=True)
class Figures:
    """Errors of one sensor by output, and what they mean."""

    outputs: dict[str, OutputResult]
    held_out: str
    floor: str


def assess(
    trained: Trained,
    dataset: Dataset,
    replay: ChipReplay | None = None,
) -> Figures:
    """Return the held-out errors of a sensor.

    Args:
        trained: its compensator, and the errors that training measured.
        dataset: its logs.
        replay: the firmware over the test runs, or the training runs where there are none; None
            without firmware.
    """
    compensator = trained.compensator
    tared, usable = compensator.tared, compensator.physics.find_usable
    runs = [*dataset.train, *dataset.test]
    floor = measure_floor(dataset)
    scores = trained.scores
    held_out = _hold_out(compensator, dataset)
    if held_out is None:
        rmse, none = scores.held_out.compensated, scores.held_out.uncompensated
        method = scores.explanation
    else:
        predictions = held_out.predictions
        zeros = {name: np.zeros_like(p) for name, p in predictions.items()}
        rmse, none = (
            pool_rmse(list(collect_errors(runs, p, tared, usable).values()))
            for p in (predictions, zeros)
        )
        method = held_out.explain()
    outputs = {
        name: OutputResult(
            dataset.units[k], float(none[k]), float(rmse[k]), None, float(floor.rms[k])
        )
        for k, name in enumerate(dataset.outputs)
    }
    if replay is not None:
        outputs = add_firmware(outputs, compensator, dataset, replay)
    return Figures(outputs, method, floor.source)


def add_firmware(
    outputs: Mapping[str, OutputResult],
    compensator: Compensator,
    dataset: Dataset,
    replay: ChipReplay,
) -> dict[str, OutputResult]:
    """Return the errors of a sensor with those of its firmware beside them.

    Args:
        outputs: by name, without firmware.
        compensator: the sensor's.
        dataset: its logs.
        replay: the firmware over the test runs, or the training runs where there are none.
    """
    of_integer: list[float | None] = [None] * len(dataset.outputs)
    if dataset.test:
        integer = {replayed.run.name: replayed.chip for replayed in replay.runs}
        tared, usable = compensator.tared, compensator.physics.find_usable
        errors = collect_errors(dataset.test, integer, tared, usable)
        of_integer = [float(x) for x in pool_rmse(list(errors.values()))]
    return {
        name: replace(outputs[name], rmse_integer=own, chip_error=asdict(causes))
        for name, own, causes in zip(dataset.outputs, of_integer, replay.split(), strict=True)
    }


def _hold_out(compensator: Compensator, dataset: Dataset) -> HeldOut | None:
    """Return held-out predictions; None where only training itself could make them."""
    if dataset.test:
        predictions = {run.name: compensator.predict(run) for run in dataset.test}
        return HeldOut(TEST_LOGS, predictions)
    if compensator.front_end is not None:
        return None
    return hold_out(compensator.physics, dataset)


def describe_parameters(compensator: Compensator) -> dict[str, ParameterResult]:
    """Return the fitted values by which sensors of one design are compared.

    A choice, such as an order, and a value held by the user are the design's and not among them.
    """
    physics = compensator.physics
    found = {}
    for fitted in physics.terms:
        for parameter in fitted.term.free:
            name = parameter.name
            found[f"{fitted.term.name}.{name}"] = ParameterResult(
                float(fitted.term.values[name]),
                float(fitted.std_errors.get(name, 0.0)),
                parameter.unit,
                parameter.scale == "log",
            )
    for j, feature in enumerate(physics.feature_names):
        for k, output in enumerate(physics.outputs):
            found[f"{output} {feature}"] = ParameterResult(
                float(physics.coefficients[j, k]),
                float(physics.std_errors[j, k]),
                _divide(physics.units[k], physics.feature_units[j]),
            )
    return found


def _divide(unit: str, by: str) -> str:
    """Return the unit of a coefficient."""
    if by in ("", "1"):
        return unit
    return f"{unit}/{by}" if by.isalnum() else f"{unit}/({by})"


# What the first pass over a fleet with blocks leaves for the second, beside the units' files.


@dataclass(frozen=True)
class Spooled:
    """What would have to be read or computed again."""

    mark: str
    """Of the design and of the unit's logs."""
    dataset: Dataset
    left_out: LeftOut | None
    model: IntegerModel | None = None
    """In its own format; None: it has to be loaded."""


def spool(folder: Path | None, sensor: str, content: Spooled) -> None:
    """Keep what the second pass needs, if this process can reach a place with room for it."""
    if folder is None or not folder.is_dir():
        return
    path = folder / f"{sensor}.pickle"
    try:
        path.write_bytes(pickle.dumps(content, protocol=5))
    except OSError:  # the second pass reads the logs again
        path.unlink(missing_ok=True)


def unspool(
    design: Design, config: Config, sensor: str, compensator: Compensator, mark: str
) -> Spooled:
    """Return what was kept of a unit; where nothing was, logs are read and runs left out again.

    Args:
        design: has the spool, a folder of this run that nobody else can write to.
        config: the unit's.
        sensor: its name.
        compensator: what was fitted to its training runs.
        mark: of the design and of its logs.
    """
    path = None if design.spool is None else design.spool / f"{sensor}.pickle"
    if path is not None and path.is_file():
        kept: Spooled = pickle.loads(path.read_bytes())  # noqa: S301 - this run's own file
        if kept.mark == mark:
            return kept
    dataset = load_dataset(config, design.skip_invalid)
    if not takes_epochs(compensator):
        return Spooled(mark, dataset, leave_out_quickly(design, config, dataset, compensator))
    found = None
    if design.uncertainty:
        handling = Handling(device=design.device)
        (found,) = leave_out_together([Original(config, dataset, compensator)], handling)
    return Spooled(mark, dataset, found if isinstance(found, LeftOut) else None)


def leave_out_quickly(
    design: Design, config: Config, dataset: Dataset, compensator: Compensator
) -> LeftOut | None:
    """Return what models say of training runs that they did not learn from, of what is fitted.

    The gate asks for it where there are no test logs, the uncertainty always.
    """
    wanted = replace(dataset, test=()) if design.uncertainty else dataset
    return leave_out(config, wanted, compensator)


# Units that are worked on one after the other in one process, and the comparison of their bits.

UNFORESEEN = (ArithmeticError, LookupError, OSError, RuntimeError, TypeError, ValueError)
"""What a sensor's logs might raise that nobody thought of: told in its name, others go on."""
RANDOM_STEPS = 5000
"""Drawn inputs beside the logs: noise, jumps, the rails, a walk, a dwell."""
START_STEPS = 4
"""Each sequence is begun on its own for these steps, from rest and from cold; then all of them run
one after the other, which gives the state jumps to live through as well."""
P = ParamSpec("P")
T = TypeVar("T")


class UnitBatch:
    """The sensors of a batch; one that fails leaves it with its message."""

    def __init__(self, sensors: Sequence[str]) -> None:
        self.sensors = sensors
        self.outcomes: dict[str, SensorOutcome] = {}

    def attempt(
        self, sensor: str, work: Callable[P, T], *args: P.args, **named: P.kwargs
    ) -> T | None:
        """Return what `work` returns, or None once its failure is noted."""
        try:
            return work(*args, **named)
        except ZerodriftError as error:
            self.fail(sensor, str(error))
        except UNFORESEEN as error:
            self.fail(sensor, explain_unforeseen(error))
        return None

    def fail(self, sensor: str, message: str) -> None:
        """Note why a sensor has no result."""
        self.outcomes[sensor] = SensorOutcome(sensor, None, message)

    def list(self) -> list[SensorOutcome]:
        """Return the outcomes in the sensors' order."""
        return [self.outcomes[sensor] for sensor in self.sensors]


def explain_unforeseen(error: Exception) -> str:
    """Return the message for an error that is none of zerodrift's own."""
    told = explain_refusal(error) if isinstance(error, OSError) else None
    return told or f"unforeseen {type(error).__name__}: {error}. Please report it."


def check_bits(host: HostModel, dataset: Dataset) -> int:
    """Return the steps at which the C was equal to the reference: drift, flags and states.

    Raises:
        CheckError: they differ, or the model's own self-test fails.
    """
    sequences = list_sequences(host.model, dataset, random_steps=RANDOM_STEPS)
    everything = np.concatenate(list(sequences.values()))
    vectors = 0
    for outcome in (
        check_starts(host, sequences, START_STEPS, settled=True),
        check_starts(host, sequences, START_STEPS, settled=False),
        check_host(host, everything, settled=True),
    ):
        if outcome.mismatch is not None:
            raise CheckError(
                f"the C differs from the reference: {outcome.mismatch}."
                " Nothing written for this sensor."
            )
        vectors += outcome.steps
    if host.selftest() != 0:
        raise CheckError("the generated self-test fails on this host. Nothing written.")
    return vectors


# A few sensors from logs to checked C, in one process; a failure of one does not stop the others.

PARAMETERS, MODEL = "parameters.json", "model.json"


@dataclass
class _Job:
    """One sensor on its way."""

    sensor: str
    config: Config
    mark: str
    dataset: Dataset
    trained: Trained | None = None
    described: FloatModel | None = None
    model: IntegerModel | None = None
    bound: ErrorBound | None = None
    code: GeneratedCode | None = None
    left_out: LeftOut | None = None
    notes: list[str] = field(default_factory=list)
    against: tuple[Statement, ...] = ()
    """What was found against its logs, and overridden."""


def work_on(design: Design, sensors: Sequence[str]) -> list[SensorOutcome]:
    """Return the outcomes of these sensors; each one's files are written when it is complete.

    Args:
        design: what they share.
        sensors: their names.
    """
    catalogue = load_catalogue(design.config.plugin_files)
    batch = UnitBatch(sensors)
    jobs = []
    for sensor in sensors:
        job = batch.attempt(sensor, _open, design, sensor)
        if job is not None:
            jobs.append(job)
    jobs = _train(design, jobs, batch, catalogue)
    if design.firmware:
        _build(design, jobs, batch)
    else:
        for job in jobs:
            batch.attempt(job.sensor, _finish, design, job, batch, None)
    return batch.list()


def _open(design: Design, sensor: str) -> _Job:
    """Read one sensor's logs."""
    config = configure_sensor(design.config, sensor)
    dataset = load_dataset(config, design.skip_invalid)
    notes = [design.tell(note) for note in dataset.notes]
    against = refuse_unit_data(design, config, dataset)
    return _Job(sensor, config, design.mark_sensor(config), dataset, notes=notes, against=against)


def refuse_unit_data(design: Design, config: Config, dataset: Dataset) -> tuple[Statement, ...]:
    """Return what was found against a unit's logs, if that is overridden.

    Raises:
        CheckError: wrong data are found, and nothing takes them on.
    """
    found = find_refusals(config, dataset, one_of_many=True)
    if found and not design.force:
        raise CheckError(explain_refusals(found, config))
    return state_notes(found)


def _train(
    design: Design, jobs: Sequence[_Job], batch: UnitBatch, catalogue: Catalogue
) -> list[_Job]:
    """Fit and train all sensors; networks of the same kind together."""
    problems = [(design.place(job.config, job.sensor), job.dataset) for job in jobs]
    done = []
    for job, trained in zip(
        jobs, train_together(problems, catalogue, device=design.device), strict=True
    ):
        if isinstance(trained, Trained):
            job.trained = trained
            done.append(job)
        else:
            known = isinstance(trained, ZerodriftError)
            batch.fail(job.sensor, str(trained) if known else explain_unforeseen(trained))
    return done


def _build(design: Design, jobs: Sequence[_Job], batch: UnitBatch) -> None:
    """Quantize, generate, compile all at once, check each, and write those that hold."""
    ready = [j for j in jobs if batch.attempt(j.sensor, _generate, design, j)]
    if not ready:
        return
    _train_again(design, ready)
    if design.in_block:
        for job in ready:
            batch.attempt(job.sensor, _set_aside, design, job, batch)
        return
    with tempfile.TemporaryDirectory(prefix="zerodrift-fleet-") as scratch:
        hosts = _compile(ready, Path(scratch), batch)
        for job, host in hosts:
            batch.attempt(job.sensor, _finish, design, job, batch, host, Path(scratch))


def _set_aside(design: Design, job: _Job, batch: UnitBatch) -> None:
    """Write what does not need the one program; `block_work` goes on once there is one."""
    assert job.trained is not None
    _leave_out(design, job, job.trained.compensator)
    _finish(design, job, batch, None)
    spool(design.spool, job.sensor, Spooled(job.mark, job.dataset, job.left_out, job.model))


def _train_again(design: Design, jobs: Sequence[_Job]) -> None:
    """Train each sensor's network again without some of its runs, all of them in step."""
    own = [job for job in jobs if job.trained and takes_epochs(job.trained.compensator)]
    if not (design.uncertainty and own):
        return
    originals = [Original(j.config, j.dataset, j.trained.compensator) for j in own if j.trained]
    answers = leave_out_together(originals, Handling(device=design.device))
    for job, found in zip(own, answers, strict=True):
        if isinstance(found, LeftOut):
            job.left_out = found
        else:
            job.notes.append(f"no uncertainty is stated: {found}")


def _leave_out(design: Design, job: _Job, compensator: Compensator) -> None:
    """Note what models say of the training runs that they did not learn from, where it is quick."""
    if not takes_epochs(compensator):
        job.left_out = leave_out_quickly(design, job.config, job.dataset, compensator)


def _generate(design: Design, job: _Job) -> bool:
    assert job.trained is not None
    place = design.place(job.config, job.sensor)
    runs = job.dataset.train
    job.described = describe_compensator(job.trained.compensator, place, runs)
    tuned = load_or_tune(job.described, place, runs)
    quantized = compose_quantized(tuned, place, job.dataset)
    job.model = quantized.model
    if not design.in_block:  # with blocks no sensor has C of its own
        job.bound = bound_errors(quantized)
        job.code = generate(job.model)
    return True


def _compile(jobs: Sequence[_Job], scratch: Path, batch: UnitBatch) -> list[tuple[_Job, HostModel]]:
    """Return the jobs with their host builds; should they not compile together, then apart."""
    models = [job.model for job in jobs if job.model is not None]
    codes = [job.code for job in jobs if job.code is not None]
    try:
        hosts = build_host_batch(models, codes, scratch / "all")
    except CheckError:
        found = []
        for number, (job, model, code) in enumerate(zip(jobs, models, codes, strict=True)):
            folder = scratch / f"alone_{number}"
            host = batch.attempt(job.sensor, HostModel, model, code, folder, observe=False)
            if host is not None:
                found.append((job, host))
        return found
    return list(zip(jobs, hosts, strict=True))


def _finish(
    design: Design, job: _Job, batch: UnitBatch, host: HostModel | None, scratch: Path | None = None
) -> None:
    """Check one sensor's C, measure its errors, and write its files; the result comes last."""
    assert job.trained is not None
    compensator = job.trained.compensator
    vectors = 0
    verdict, replay = None, None
    certificate = ""
    if host is not None and scratch is not None:
        assert job.model is not None and job.code is not None and job.described is not None
        vectors = check_bits(host, job.dataset)
        certificate = _certify(job, scratch)
        _leave_out(design, job, compensator)
        judge = choose_judge(job.left_out, job.dataset)
        verdict, replay = judge_firmware(job.described, host, job.dataset, judge)
        verdict = replace(verdict, refused=(*job.against, *verdict.refused))
        if verdict.refused and design.force:
            certificate = _mark_forced(job, [s.text for s in verdict.refused], scratch)
    figures = assess(job.trained, job.dataset, replay)
    result = SensorResult(
        sensor=job.sensor,
        mark=job.mark,
        held_out=figures.held_out,
        floor=figures.floor,
        outputs=figures.outputs,
        parameters=describe_parameters(compensator),
        temperature_degC=compensator.calibration.temperature_degC,
        network=compensator.network is not None,
        notes=(*job.notes, *compensator.notes),
        vectors=vectors,
        model_hash=job.model.hash if job.model is not None else "",
        refused=tuple(s.text for s in verdict.refused) if verdict is not None else (),
        forced=verdict is not None and not verdict.passes and design.force,
        warnings=tuple(s.text for s in verdict.warnings) if verdict is not None else (),
    )
    files = _render(design, job, result, certificate)
    is_written = result.forced or not result.refused
    if verdict is not None and replay is not None and is_written:
        files[design.build_folder(job.sensor) / UNCERTAINTY] = _measure(
            design, job, verdict, replay, [o.noise_floor for o in result.outputs.values()]
        )
    batch.outcomes[job.sensor] = SensorOutcome(
        job.sensor,
        save_result(design.build_folder(job.sensor), design.directory, result, files),
        model=job.model if design.in_block else None,
    )


def _measure(
    design: Design, job: _Job, verdict: GateVerdict, replay: ChipReplay, floor: Sequence[float]
) -> bytes | None:
    """Return what is kept of the uncertainty of a sensor's compensated values, if it is known."""
    if job.left_out is None or not design.uncertainty:
        return None
    assert job.described is not None and job.model is not None
    rounding = [error.rounding for error in verdict.chip_error]
    measured = measure_firmware(
        job.described, job.model, job.dataset, job.left_out, rounding, replay, floor
    )
    return render_sealed(to_dict(measured))


def _mark_forced(job: _Job, reasons: Sequence[str], scratch: Path) -> str:
    """Write into a sensor's model and C what the gate found against it; return the certificate."""
    assert job.model is not None
    job.model = replace(job.model, notes={**job.model.notes, FORCED: "\n".join(reasons)})
    job.code = generate(job.model)
    return _certify(job, scratch)


def _certify(job: _Job, scratch: Path) -> str:
    """Return a sensor's certificate, derived again from the C.

    Raises:
        CheckError: a claim does not hold.
    """
    assert job.model is not None and job.code is not None and job.bound is not None
    certificate, _, job.bound = certify_checked(job.model, job.code, job.bound, scratch)
    return certificate


def _render(
    design: Design, job: _Job, result: SensorResult, certificate: str
) -> dict[Path, bytes | None]:
    """Return a sensor's files; None for those that are removed.

    Of a sensor that the gate refused, those below build/ alone, unless it is forced.

    Raises:
        InputError: a file that zerodrift did not write stands in the place of one.
    """
    assert job.trained is not None
    compensator = replace(job.trained.compensator, trained_from=job.mark)
    build = design.build_folder(job.sensor)
    files = compensator.render(build)
    described = describe_sensor(design, result, compensator.physics)
    text = json.dumps(to_dict(described), indent=1) + "\n"
    files[build / PARAMETERS] = text.encode()
    is_written = result.forced or not result.refused
    if job.model is not None and is_written:
        files[build / MODEL] = job.model.to_text().encode()
    if job.code is not None and job.model is not None and is_written:
        out = design.firmware_folder(job.sensor)
        firmware = {
            PARAMETERS: text.encode(),
            job.code.header_name: job.code.header.encode(),
            job.code.source_name: job.code.source.encode(),
            CERTIFICATE: certificate.encode(),
        }
        refuse_foreign((out / name for name in (*firmware, MANIFEST)), out)
        files |= {out / name: content for name, content in firmware.items()}
        runtime = list_runtime(job.code.header, job.code.source)
        shared = {f"../{SHARED_RUNTIME}/{name}": t.encode() for name, t in runtime.items()}
        own = {name: content for name in (MODEL,) if (content := files[build / name])}
        files[out / MANIFEST] = write_manifest(
            job.config,
            job.model.hash,
            firmware | shared,
            own,
            _describe_compiler(),
            forced=result.refused,
        ).encode()
    return files


@cache
def _describe_compiler() -> str:
    return find_compiler().describe()


def describe_sensor(
    design: Design, result: SensorResult, physics: PhysicalModel
) -> SensorConfiguration:
    """Return the sensor's configuration: what distinguishes it from the others, for records."""
    return SensorConfiguration(
        sensor=result.sensor,
        design=design.config.sensor_name,
        model_hash=result.model_hash,
        sample_period_s=design.config.sample_period_s,
        effects=tuple(EffectValues(t.kind, t.term.values, t.std_errors) for t in physics.terms),
        outputs=physics.outputs,
        units=physics.units,
        features=physics.feature_names,
        coefficients=tuple(map(tuple, physics.coefficients.tolist())),
        network=result.network,
        calibrated_temperature_degC=result.temperature_degC,
        errors=result.outputs,
        held_out=result.held_out,
        notes=result.notes,
    )
