"""The Python face: a project with the commands as methods that return typed results."""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast, overload

from zerodrift.base.config import Config
from zerodrift.base.errors import CheckError, InputError
from zerodrift.base.journal import settle_project
from zerodrift.base.progress import Progress, show_progress
from zerodrift.base.shown import with_picture
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.history import Step
from zerodrift.field.summary import MonitorResult, NeighbourResult, RegistryResult
from zerodrift.fleet.joint_summary import FleetDiagnosis
from zerodrift.fleet.summary import FleetSummary
from zerodrift.report.pictures import (
    draw_change,
    draw_comparison,
    draw_programme,
    draw_ranking,
    draw_stairs,
)
from zerodrift.report.results import (
    AddResult,
    BlockResult,
    CalibrateResult,
    CertificateResult,
    CompareResult,
    DiagnoseResult,
    DiffResult,
    DoctorResult,
    EffectResult,
    EffectsResult,
    ExportResult,
    HistoryResult,
    PackageResult,
    PlanResult,
    ProofResult,
    ProposeResult,
    RecordResult,
    RemoveResult,
    TrainResult,
)
from zerodrift.report.svg import Picture
from zerodrift.tasks.block import show_blocks
from zerodrift.tasks.calibrate import CalibrateRequest, calibrate
from zerodrift.tasks.compare import CompareRequest, compare
from zerodrift.tasks.diagnose import DiagnoseRequest, diagnose
from zerodrift.tasks.diff import DiffRequest, diff
from zerodrift.tasks.doctor import examine
from zerodrift.tasks.effects import EffectsRequest, list_effects
from zerodrift.tasks.export import ExportRequest, export
from zerodrift.tasks.firmware import FirmwareRequest, make_firmware
from zerodrift.tasks.fleet import FleetRequest, calibrate_fleet
from zerodrift.tasks.init import InitRequest, begin
from zerodrift.tasks.monitor import MonitorRequest, monitor_unit
from zerodrift.tasks.neighbour import NeighbourRequest, write_neighbour
from zerodrift.tasks.package import PackageRequest, write_package
from zerodrift.tasks.plan import PlanRequest, plan
from zerodrift.tasks.project import ProjectFolder, is_fleet
from zerodrift.tasks.propose import ProposeRequest, propose
from zerodrift.tasks.recording import RecordRequest, record
from zerodrift.tasks.registry import RegistryPlace, list_standings
from zerodrift.tasks.report import ReportRequest, report
from zerodrift.tasks.revise import (
    AddRequest,
    HistoryRequest,
    RemoveRequest,
    add,
    remove,
    show_history,
)
from zerodrift.tasks.train import TrainRequest, train
from zerodrift.tasks.trust import remember
from zerodrift.tasks.verify import VerifyRequest, check_folder, prove, verify
from zerodrift.verify.summary import FirmwareSummary, VerifySummary
from zerodrift.workbench.run import WorkbenchRequest, run_workbench

if TYPE_CHECKING:
    from typing import Unpack

    import polars as pl

    from zerodrift.api.frames import BeginningOptions, FrameOptions, Output, PandasFrame

Request = TypeVar("Request")
Outcome = TypeVar("Outcome")
Pandas = TypeVar("Pandas", bound="PandasFrame")


class Project:
    """A sensor's logs and its model, as they were when it was opened.

    A method returns what the command of the same name prints with `--json`; a notebook shows it as
    a table, and `.plot()` returns a Plotly figure where there is one. `add` and `remove` write
    zerodrift.toml and return the new project; the old one still compares and diagnoses, but no
    longer writes.

    Args:
        directory: the folder with zerodrift.toml.
        skip_invalid: drop invalid rows of the logs instead of raising.
        sensor: a unit of a fleet: its logs, its model and its C, as `--sensor` has them.

    Raises:
        InputError: zerodrift.toml or a log is missing or wrong; the same messages as the commands'.

    Example:
        >>> zd.Project(folder)
        Project('...'): zero_tempco
        >>> zd.Project(folder / "nowhere")
        Traceback (most recent call last):
        zerodrift.base.errors.InputError: ...
    """

    def __init__(
        self, directory: str | Path, *, skip_invalid: bool = False, sensor: str | None = None
    ) -> None:
        self._scratch: tempfile.TemporaryDirectory[str] | None = None
        settle_project(Path(directory))
        self._folder = ProjectFolder(Path(directory), sensor, skip_invalid)
        self.config: Config = self._folder.config
        self._text = self.config.path.read_bytes()
        remember(self.config.plugin_files)
        _ = self._folder.catalogue  # a wrong file of effects is told now

    @classmethod
    def from_frames(
        cls,
        frames: "Mapping[str, pl.DataFrame | pl.LazyFrame | PandasFrame]",
        *,
        time: str,
        temperature: str,
        outputs: "Mapping[str, str | Output]",
        **options: "Unpack[FrameOptions]",
    ) -> "Project":
        """Return a project whose logs are data frames, of pandas or Polars.

        Args:
            frames: run -> its rows; a run is one uninterrupted recording.
            time: column of the times: seconds, or any datetime.
            temperature: column of the chip's thermometer, in degC.
            outputs: quantity -> its column, or an `Output` with reference, unit and full scale.
            **options: `inputs` (name -> column), `test` and `dwell` (names of runs), `effects` (of
                the first model; zero_tempco), `network` ("lag_bank"), `sample_period_s` (the
                frames' median interval), `name` ("sensor"), and `path`, where the project is kept;
                left out, it is in a temporary folder that lasts as long as the project is in use.

        Raises:
            InputError: a column is missing, or a frame holds values that a log must not have.
            TypeError: an option is not one of these.

        Example:
            >>> frames["run0"].columns  # seconds, degC, N
            ['t', 'T', 'fz_N']
            >>> project = zd.Project.from_frames(
            ...     frames, time="t", temperature="T", outputs={"Fz": "fz_N"}, network="none"
            ... )
            >>> project.effects, project.config.outputs[0].unit
            (('zero_tempco',), 'N')
        """
        from zerodrift.api.frames import Beginning, FrameColumns, Output, to_polars, write_project

        path, inputs = options.get("path"), options.get("inputs", {})
        scratch = None
        if path is None:
            scratch = tempfile.TemporaryDirectory(prefix="zerodrift-")
            path = scratch.name
        told = {
            name: output if isinstance(output, Output) else Output(output)
            for name, output in outputs.items()
        }
        columns = FrameColumns(time, temperature, told, dict(inputs))
        rest = {name: value for name, value in options.items() if name not in ("path", "inputs")}
        begin = Beginning(**cast("BeginningOptions", rest))
        write_project(Path(path), {n: to_polars(n, f) for n, f in frames.items()}, columns, begin)
        project = cls(path)
        project._scratch = scratch
        return project

    @classmethod
    def init(
        cls,
        *logs: str | Path,
        directory: str | Path = ".",
        force: bool = False,
        period_s: float | None = None,
    ) -> "Project":
        """Write a zerodrift.toml guessed from logs, and return the project.

        Args:
            *logs: files or folders, seen from the current directory or from `directory`.
            directory: where the project begins.
            force: overwrite an existing zerodrift.toml.
            period_s: interval between rows, for logs without times.

        Raises:
            InputError: there is a zerodrift.toml already, or the logs cannot be read.

        Example:
            >>> begun = zd.Project.init("logs", directory=folder, force=True)
            >>> begun.config.outputs[0].measured
            'fz_N'
        """
        begin(InitRequest(Path(directory), tuple(map(Path, logs)), force, period_s))
        return cls(directory)

    @property
    def sensor(self) -> str | None:
        """The unit of a fleet that this is; None for a sensor of its own.

        Example:
            >>> project.sensor is None
            True
        """
        return self._folder.sensor

    @property
    def directory(self) -> Path:
        """The folder of zerodrift.toml.

        Example:
            >>> project.directory == folder
            True
        """
        return self.config.directory

    @property
    def effects(self) -> tuple[str, ...]:
        """The effects of the model, by name.

        Example:
            >>> project.effects
            ('zero_tempco',)
        """
        return tuple(effect.kind for effect in self.config.effects)

    @property
    def dataset(self) -> Dataset:
        """The runs: time [n] s, temperature [n] degC, drift [n, K] in the outputs' units.

        Raises:
            InputError: a log is missing or damaged, or holds impossible values.

        Example:
            >>> run = project.dataset.train[0]
            >>> run.drift.shape, run.temperature_degC.shape
            ((500, 1), (500,))
        """
        with show_progress(Progress, "reading logs"):
            return self._folder.dataset

    def compare(self, model: str | None = None) -> CompareResult:
        """Return the comparison of model and measurements; `.plot(output)` draws one output.

        Args:
            model: physics | network | integer | c; None: the most complete there is.

        Raises:
            InputError: the model asked for was not trained or built yet.

        Example:
            >>> found = project.compare()
            >>> error = found.outputs["Fz"]
            >>> error.unit, error.noise_floor < error.rmse_heldout < error.rmse_uncompensated
            ('N', True)
        """
        compared = _run(compare, CompareRequest(self._folder, model))
        comparison = compared.comparison

        def draw(output: str | None = None) -> Picture:
            names = list(comparison.outputs)
            drawn = draw_comparison(self.dataset, compared.predictor.predict, comparison)
            return drawn[2 * (names.index(output) if output is not None else 0)]

        return with_picture(compared.summarise(), draw)

    def diagnose(self, *, auto: bool = False) -> DiagnoseResult:
        """Return which effect the model lacks; `.plot()` draws the candidates.

        Of a fleet it is asked of one unit, `sensor=`; `diagnose_fleet` speaks of the design.

        Args:
            auto: add what is missing, without writing it, and diagnose again until nothing is.

        Example:
            >>> verdict = project.diagnose()
            >>> verdict.verdict, verdict.effect
            ('missing', 'thermal_lag')
        """
        diagnosed = _run(diagnose, DiagnoseRequest(self._folder, auto))
        if isinstance(diagnosed, FleetDiagnosis):
            raise InputError(
                f"{self.config.path}: is a fleet's; expected one unit, `Project(folder,"
                " sensor=NAME)`. `diagnose_fleet` says what all units lack."
            )

        return with_picture(
            diagnosed.summarise(self.directory),
            lambda: draw_ranking(diagnosed.verdict.diagnosis),
        )

    def diagnose_fleet(self) -> FleetDiagnosis:
        """Return what the design of a fleet lacks, by all of its units together.

        Raises:
            InputError: the project is no fleet's.

        Example:
            >>> project.diagnose_fleet()
            Traceback (most recent call last):
            zerodrift.base.errors.InputError: ...
        """
        if self.sensor is not None or not is_fleet(self.config):
            raise InputError(
                f"{self.config.path}: is one sensor's; expected a fleet, whose [fleet] or [logs]"
                " name the folders of its units. `diagnose` says what this one lacks."
            )
        found = _run(diagnose, DiagnoseRequest(self._folder))
        assert isinstance(found, FleetDiagnosis)
        return found

    def catalogue(self) -> EffectsResult:
        """Return the catalogue of effects, the project's own with them.

        Example:
            >>> kinds = [effect.kind for effect in project.catalogue().effects]
            >>> "thermal_lag" in kinds, "creep" in kinds
            (True, True)
        """
        found = _run(list_effects, EffectsRequest(self._folder)).result
        assert isinstance(found, EffectsResult)
        return found

    def effect(self, name: str) -> EffectResult:
        """Return everything declared about an effect.

        Args:
            name: of the effect.

        Raises:
            InputError: there is none of that name.

        Example:
            >>> {p.name: p.unit for p in project.effect("thermal_lag").parameters}["tau_s"]
            's'
        """
        found = _run(list_effects, EffectsRequest(self._folder, name)).result
        assert isinstance(found, EffectResult)
        return found

    def propose(self, file: str | Path | None = None, *, black_box: bool = True) -> ProposeResult:
        """Return a formula for what no effect of the catalogue explains, or that there is none.

        Args:
            file: where it is written as a file of effects, which `add` takes.
            black_box: whether a lag bank and a GRU are tried on the same runs.

        Raises:
            InputError: the file is there and holds something else.

        Example:
            >>> found = project.propose(black_box=False)
            >>> found.found, found.written is None
            (True, True)
        """
        request = ProposeRequest(self._folder, None if file is None else Path(file), black_box)
        found = _run(propose, request)
        request.require_written(found)
        return found

    def plan(
        self,
        hours: float | None = None,
        *,
        between: Sequence[str] = (),
        target: float | None = None,
        within: str | None = None,
        budget_s: float = 60.0,
    ) -> PlanResult:
        """Return the next experiment; `.plot()` draws its programme.

        Args:
            hours: how long it may take; None: [experiment] hours, or 8.
            between: effects to distinguish; empty: those that are undecided.
            target: share of full scale from which on an effect has to be named.
            within: limits beside those of [experiment], as the command takes them.
            budget_s: processor time for the search, in s.

        Raises:
            InputError: limits that contradict each other, or nothing left to distinguish.

        Example:
            >>> wanted = ["thermal_lag", "thermal_gradient"]
            >>> planned = project.plan(hours=4, between=wanted, budget_s=1.0)
            >>> planned.hours <= 4.0 and len(planned.programme) > 0
            True
        """
        request = PlanRequest(self._folder, hours, tuple(between), target, budget_s, within=within)
        found = _run(plan, request).result

        return with_picture(found, lambda: draw_programme(found))

    def add(
        self,
        effect: str | None,
        *,
        hold: Mapping[str, float] | None = None,
        signal: str = "",
        force: bool = False,
    ) -> "Project":
        """Add an effect to zerodrift.toml, refit, and return the new project.

        The change of the errors is in the new project's `revision`.

        Args:
            effect: its name, such as `diagnose().effect`, or a file of one effect of your own.
            hold: parameter -> the value it is held at.
            signal: the thermometer that a thermal effect follows; "" for the chip's.
            force: add it even if runs left out are not predicted better.

        Raises:
            CheckError: runs left out are not predicted better; nothing was written.
            InputError: no effect was named, it is unknown, or zerodrift.toml has changed since.

        Example:
            >>> better = project.add("thermal_lag")
            >>> better.effects, project.effects
            (('zero_tempco', 'thermal_lag'), ('zero_tempco',))
            >>> better.revision.helps
            True
        """
        if effect is None:
            raise InputError(
                "add: no effect was named; expected the name of one. The verdict names none where "
                "nothing is missing, or nothing that the catalogue knows."
            )
        self._refuse_moved()
        options = {"signal": signal} if signal else {}
        found = _run(add, AddRequest(self._folder, effect, dict(hold or {}), options, force))
        if not found.result.added:
            raise CheckError(
                f"{effect} was not added: {found.revision.reason}. `force=True` adds it all the"
                " same.",
                found.result,
            )
        return self._follow(found.result)

    def remove(self, effect: str, *, signal: str = "") -> "Project":
        """Remove an effect from zerodrift.toml, refit, and return the new project.

        Args:
            effect: its name.
            signal: of which thermometer, where the model has it for several.

        Raises:
            InputError: the model has no such effect, or zerodrift.toml has changed since.

        Example:
            >>> plain = project.add("thermal_lag").remove("thermal_lag")
            >>> plain.effects
            ('zero_tempco',)
        """
        self._refuse_moved()
        return self._follow(_run(remove, RemoveRequest(self._folder, effect, signal)).result)

    revision: AddResult | RemoveResult | None = None
    """The change that made this project, with its errors; None for a project that was opened."""

    def history(self) -> HistoryResult:
        """Return the staircase of errors so far; `.plot()` draws it.

        Example:
            >>> [step.step for step in project.add("thermal_lag").history().steps]
            ['start', '+ thermal_lag']
        """
        steps = show_history(HistoryRequest(self._folder)).steps
        return _draw_steps(steps)

    def restore(self, step: int) -> "Project":
        """Write the effects of a step of the history back, and return the new project.

        Args:
            step: its number, from 0, as `history` lists them.

        Raises:
            InputError: there is no such step, or zerodrift.toml has changed since.

        Example:
            >>> project.add("thermal_lag").restore(0).effects
            ('zero_tempco',)
        """
        self._refuse_moved()
        show_history(HistoryRequest(self._folder, restore=step))
        return self._follow(None)

    def train(self, *, force: bool = False) -> TrainResult:
        """Fit the effects, then train the network on the rest; checkpoints go to build/.

        Args:
            force: train on logs in which wrong data are found.

        Raises:
            CheckError: wrong data are found in the logs.

        Example:
            >>> trained = project.train()
            >>> list(trained.outputs)
            ['Fz']
        """
        self._refuse_moved()
        return _run(train, TrainRequest(self._folder, force=force)).result

    def export(self, *, force: bool = False) -> ExportResult:
        """Write float ONNX, integer model, integer ONNX, golden vectors and certificate to build/.

        Args:
            force: train on logs in which wrong data are found.

        Raises:
            CheckError: wrong data are found in the logs, or a bound does not hold.

        Example:
            >>> built.export().bounds_proven > 0
            True
        """
        self._refuse_moved()
        return _run(export, ExportRequest(self._folder, force))

    def firmware(self, *, force: bool = False, uncertainty: bool = True) -> FirmwareSummary:
        """Train if needed, quantize, generate C, check it bit for bit, and write it.

        Args:
            force: write it even if logs or gate refuse it; header and manifest then say so.
            uncertainty: also fit, or train, without some of the runs, to find the uncertainty.

        Raises:
            CheckError: wrong data are found in the logs, the gate refuses the firmware, or a bit
                differs; nothing was written.

        Example:
            >>> firmware = built.firmware()
            >>> firmware.bit_exact, "host" in firmware.backends
            (True, True)
        """
        self._refuse_moved()
        made = _run(make_firmware, FirmwareRequest(self._folder, force, uncertainty))
        if made.refusal:
            raise CheckError(f"{made.refusal}\nNothing was written.", made.result)
        return made.result

    def verify(self, *, required: Sequence[str] = ()) -> VerifySummary:
        """Build and run what lies in the firmware folder, and hold it against the model.

        Args:
            required: what must have been checked, such as a core.

        Raises:
            InputError: there is no firmware, or C that zerodrift did not write.

        Example:
            >>> found = built.verify()
            >>> found.bit_exact, found.failures
            (True, ())
        """
        return _run(verify, VerifyRequest(self._folder, tuple(required))).summarise()

    def check_certificate(self) -> CertificateResult:
        """Derive every bound of the firmware's certificate again, from the C alone.

        Raises:
            InputError: there is no certificate.

        Example:
            >>> built.check_certificate().certificate
            'holds'
        """
        return _run(check_folder, VerifyRequest(self._folder))

    def prove(self, elf: str | Path | None = None) -> ProofResult:
        """Return what is proven of the firmware's C, part by part.

        Args:
            elf: a program whose kernels in assembly are proven with the folder's.

        Raises:
            InputError: there is no firmware, or its coefficients lie in a block.

        Example:
            >>> built.prove().proven
            True
        """
        request = VerifyRequest(self._folder, elf=None if elf is None else Path(elf))
        return _run(prove, request)

    def fleet(self, *, force: bool = False, out: str | Path | None = None) -> FleetSummary:
        """Calibrate all sensors of one design: fit, train, generate, check, and judge.

        Args:
            force: write units that the gate refuses.
            out: the firmware folder, in place of that of [firmware] out.

        Raises:
            InputError: the project is no fleet's.

        Example:
            >>> project.fleet()
            Traceback (most recent call last):
            zerodrift.base.errors.InputError: ...
        """
        self._refuse_moved()
        place = None if out is None else Path(out)
        return _run(calibrate_fleet, FleetRequest(self._folder, force=force, out=place)).result

    def calibrate(
        self,
        *logs: str,
        channels: Sequence[str] = (),
        references: Sequence[str] = (),
        squares: bool = False,
        files: Sequence[str | Path] = (),
    ) -> CalibrateResult:
        """Find the matrix that turns converter codes into loads, by least squares.

        Args:
            *logs: files, folders or globs, seen from the project's folder.
            channels: columns of codes; none: adc_1 to adc_6.
            references: columns of reference loads; none: all that begin with ref_.
            squares: use the squares of the codes too.
            files: .toml, .json or .h files to be written.

        Raises:
            InputError: no log matches, or the weights leave a direction out.

        Example:
            >>> project.calibrate("nowhere.csv")
            Traceback (most recent call last):
            zerodrift.base.errors.InputError: ...
        """
        request = CalibrateRequest(
            self._folder,
            logs,
            tuple(channels),
            tuple(references),
            squares,
            files=tuple(map(Path, files)),
        )
        return _run(calibrate, request).result

    def record(self, source: str, out: str | Path, *, seconds: float | None = None) -> RecordResult:
        """Record a log until the source ends; return what it covers.

        Args:
            source: as the command takes it, such as "serial:/dev/ttyUSB0@115200".
            out: the log to be written.
            seconds: after which it ends; None: with the source.

        Raises:
            InputError: there is no such source.

        Example:
            >>> project.record("nowhere:0", folder / "new.csv")
            Traceback (most recent call last):
            zerodrift.base.errors.InputError: ...
        """
        return record(RecordRequest(self._folder, source, Path(out), seconds=seconds))

    def monitor(
        self,
        *logs: str,
        loads: Mapping[str, float] | None = None,
        alarms_per_unit_month: float = 0.01,
        reset: bool = False,
    ) -> MonitorResult:
        """Hold the model of the last firmware against new logs of its unit.

        Args:
            *logs: as [logs] names them.
            loads: output -> its true value in these logs.
            alarms_per_unit_month: false alarms, all outputs together.
            reset: forget what was seen.

        Raises:
            InputError: no firmware was built, or a log cannot be read.

        Example:
            >>> project.monitor("nowhere.csv")
            Traceback (most recent call last):
            zerodrift.base.errors.InputError: ...
        """
        known = tuple(f"{name}={value!r}" for name, value in (loads or {}).items())
        request = MonitorRequest(
            self._folder,
            logs,
            loads=known,
            alarms_per_unit_month=alarms_per_unit_month,
            reset=reset,
        )
        return _run(monitor_unit, request)

    def block(self, *files: str | Path, design: str | Path | None = None) -> BlockResult:
        """Return what units' blocks of coefficients hold, each of them sound.

        Args:
            *files: .bin, .hex or .json.
            design: their design.json; None: beside each, or one or two folders above.

        Raises:
            InputError: one was cut, damaged or made for another program.

        Example:
            >>> project.block(folder / "zerodrift.toml")
            Traceback (most recent call last):
            zerodrift.base.errors.InputError: ...
        """
        return show_blocks(tuple(map(Path, files)), None if design is None else Path(design))

    def registry(self) -> RegistryResult:
        """Return the units of the registry beside zerodrift.toml.

        Raises:
            InputError: there is no registry.

        Example:
            >>> project.registry()
            Traceback (most recent call last):
            zerodrift.base.errors.InputError: ...
        """
        standings = list_standings(RegistryPlace(self.directory))
        return RegistryResult(tuple(one.unit for one in standings))

    def doctor(self) -> DoctorResult:
        """Return what this machine has and lacks, and the project's state.

        Example:
            >>> {item.group for item in project.doctor().items} >= {"packages"}
            True
        """
        return examine(self.directory)

    @overload
    def apply(
        self, frame: "str | Path | pl.DataFrame | pl.LazyFrame", *, model: str = "integer"
    ) -> "pl.DataFrame": ...

    @overload
    def apply(self, frame: "Pandas", *, model: str = "integer") -> "Pandas": ...

    def apply(
        self,
        frame: "str | Path | pl.DataFrame | pl.LazyFrame | Pandas",
        *,
        model: str = "integer",
    ) -> "pl.DataFrame | Pandas":
        """Return a frame with the answers of the last firmware for its rows.

        Adds OUTPUT_drift, OUTPUT_compensated and OUTPUT_uncertainty (k = 2), in the output's unit,
        and the chip's flags.

        Args:
            frame: of pandas or Polars, or the path of a log; needs no reference.
            model: integer | float.

        Returns:
            A frame of the kind that was given; of Polars for a path.

        Raises:
            InputError: no firmware was built yet, or a column is missing.

        Example:
            >>> applied = built.apply(frames["run0"])
            >>> applied.columns[3:]
            ['Fz_drift', 'Fz_compensated', 'Fz_uncertainty', 'flags']
        """
        import polars as pl

        from zerodrift.api.frames import to_polars
        from zerodrift.tasks.apply import apply_model, open_applied

        opened = open_applied(self.config, model, load_logs=lambda: self.dataset)
        with tempfile.TemporaryDirectory(prefix="zerodrift-") as scratch:
            log, out = Path(scratch) / "frame.parquet", Path(scratch) / "applied.parquet"
            if isinstance(frame, (str, Path)):
                log = Path(frame)
            else:
                to_polars("frame", frame).write_parquet(log)
            try:
                with show_progress(Progress, "applying") as say:
                    apply_model(
                        self.config,
                        opened.model,
                        [(log, out)],
                        uncertainty=opened.uncertainty,
                        predict_float=opened.predict_float,
                        skip_invalid=self._folder.skip_invalid,
                        say=say,
                    )
            except InputError as error:
                if log.parent != Path(scratch):
                    raise
                raise InputError(str(error).replace(str(log), "the frame")) from error
            applied = pl.read_parquet(out)
        if isinstance(frame, (str, Path, pl.DataFrame, pl.LazyFrame)):
            return applied
        added = [name for name in applied.columns if name not in frame.columns]
        added = [name for name in added if name not in frame.index.names]
        return frame.assign(**{name: applied[name].to_numpy() for name in added})

    def diff(
        self,
        old: "str | Path | Project",
        *logs: str | Path,
        limit_pct_fs: float | None = None,
    ) -> DiffResult:
        """Return what changed from another model to this one, and by how much the drifts differ.

        Args:
            old: a project, a firmware folder or a model.json.
            *logs: over which they are compared; none: the calibrated range that both have.
            limit_pct_fs: share of full scale, in percent, that no drift may differ by.

        Raises:
            InputError: a model or a log cannot be read, or outputs or inputs are not the same.

        Example:
            >>> built.diff(built).same
            True
        """
        place = old.directory if isinstance(old, Project) else Path(old)
        request = DiffRequest(
            place,
            self.directory,
            tuple(map(Path, logs)),
            limit_pct_fs=limit_pct_fs,
            skip_invalid=self._folder.skip_invalid,
        )
        return _run(diff, request)

    def package(self, kind: str) -> PackageResult:
        """Write the C of the last firmware as a package; return what it holds.

        Args:
            kind: cmake | zephyr | arduino | platformio | esp-idf | pico | python | ros2.

        Raises:
            InputError: no firmware was built.
            CheckError: a file of it was changed, or it is stale.

        Example:
            >>> built.package("cmake").package
            'cmake'
        """
        self._refuse_moved()
        return _run(write_package, PackageRequest(self._folder, kind)).result

    def neighbour(
        self,
        kind: str,
        out: str | Path,
        *,
        outputs: Sequence[str] = (),
        device: int | None = None,
        order: int | None = None,
    ) -> NeighbourResult:
        """Write the model of the last firmware as another program takes it; return what is lost.

        Args:
            kind: px4 | ardupilot | chrony | polynomial.
            out: the file to be written.
            outputs: in the order of the program's axes; none: all.
            device: number of the sensor in that program; None: its first.
            order: of `polynomial`.

        Raises:
            InputError: no firmware was built, or the program does not take an output or its unit.

        Example:
            >>> told = built.neighbour("polynomial", folder / "fz.csv", order=2)
            >>> (folder / "fz.csv").exists()
            True
        """
        request = NeighbourRequest(self._folder, kind, (), tuple(outputs), device, order, Path(out))
        return _run(write_neighbour, request).result

    def report(
        self,
        out: str | Path | None = None,
        *,
        diagnose: bool = True,
        datasheet: bool = False,
        dcc: str | Path | None = None,
    ) -> Path:
        """Write the report, one HTML file that opens offline; return its path.

        Args:
            out: where; by default report.html in the project's folder.
            diagnose: whether to diagnose for it.
            datasheet: whether it has TK0, TKC, creep, hysteresis, repeatability and uncertainty.
            dcc: where the digital calibration certificate goes; None: there is none.

        Example:
            >>> project.report(diagnose=False).name
            'report.html'
        """
        request = ReportRequest(
            self._folder,
            out=None if out is None else Path(out),
            datasheet=datasheet,
            dcc=None if dcc is None else Path(dcc),
            diagnose=diagnose,
        )
        return _run(report, request).files[0]

    def workbench(self, *, port: int = 0, browser: bool = True) -> None:
        """Serve the page on this project, on 127.0.0.1, until it is interrupted.

        Args:
            port: 0 for any that is free.
            browser: whether a browser is opened on it; its address is printed.

        Raises:
            InputError: another workbench is open on the folder.

        Example:
            >>> project.workbench()  # doctest: +SKIP
        """
        folder = self._folder
        request = WorkbenchRequest(
            folder.directory, folder.sensor, folder.skip_invalid, port, browser
        )
        run_workbench(request, print)

    def _refuse_moved(self) -> None:
        """Refuse to write where zerodrift.toml is not the one that was opened."""
        if self.config.path.read_bytes() != self._text:
            raise InputError(
                f"{self.config.path}: the folder has moved on since this project was opened; "
                "expected the newest. Go on with what `add` or `remove` returned, or open it again."
            )

    def _follow(self, told: AddResult | RemoveResult | None) -> "Project":
        """Return the project as it is after a change of its effects."""
        skip_invalid = self._folder.skip_invalid
        follower = Project(self.directory, skip_invalid=skip_invalid, sensor=self.sensor)
        follower._scratch = self._scratch
        if "dataset" in vars(self._folder):
            vars(follower._folder)["dataset"] = self._folder.dataset
        if told is None:
            return follower

        before, after = told.before.rmse_heldout, told.after.rmse_heldout
        follower.revision = with_picture(told, lambda: draw_change(before, after, told.noise_floor))
        return follower

    def __repr__(self) -> str:
        """Return the folder and the model's effects."""
        unit = f", sensor={self.sensor!r}" if self.sensor is not None else ""
        return f"Project({str(self.directory)!r}{unit}): {', '.join(self.effects) or 'no effects'}"


def _run(task: Callable[[Request, Progress], Outcome], request: Request) -> Outcome:
    """Return what a task finds; in a notebook the cell says what is being done."""
    with show_progress(Progress) as progress:
        return task(request, progress)


def _draw_steps(steps: Sequence[Step]) -> HistoryResult:
    summary = HistoryResult(tuple(step.summarise() for step in steps))
    return with_picture(summary, lambda: draw_stairs(steps))
