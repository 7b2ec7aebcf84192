"""The Python face: a project with the commands as methods that return typed results."""

import contextlib
import io
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast, overload

from zerodrift.base.config import Config, EffectConfig
from zerodrift.base.errors import CheckError, InputError
from zerodrift.base.journal import hold_project, settle_project
from zerodrift.base.progress import Progress, show_progress
from zerodrift.base.shown import with_picture
from zerodrift.physics.catalogue import Catalogue
from zerodrift.report.results import (
    AddResult,
    CompareResult,
    DiagnoseResult,
    HistoryResult,
    PlanResult,
    RemoveResult,
    TrainResult,
)
from zerodrift.tasks.project import ProjectFolder
from zerodrift.tasks.trust import remember

if TYPE_CHECKING:
    from typing import Unpack

    import polars as pl
    from plotly.graph_objects import Figure

    from zerodrift.api.frames import BeginningOptions, FrameOptions, Output, PandasFrame
    from zerodrift.dataset.runs import Dataset
    from zerodrift.diagnosis.revision import Revision
    from zerodrift.verify.summary import FirmwareSummary

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
        self._skip_invalid = skip_invalid
        self.sensor = sensor
        settle_project(Path(directory))
        self._folder = ProjectFolder(Path(directory), sensor, skip_invalid)
        self.config: Config = self._folder.config
        self._text = self.config.path.read_bytes()
        remember(self.config.plugin_files)
        self._catalogue: Catalogue = self._folder.catalogue

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
    def dataset(self) -> "Dataset":
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
        from zerodrift.tasks.predictors import compare_project

        with show_progress(Progress, "comparing") as say:
            compared = compare_project(
                self.config, self.dataset, self._catalogue, kind=model, say=say
            )
        comparison = compared.comparison

        def draw(output: str | None = None) -> "Figure":
            from zerodrift.report.figures import draw_comparison

            names = list(comparison.outputs)
            figures = draw_comparison(self.dataset, compared.predictor.predict, comparison)
            return figures[2 * (names.index(output) if output is not None else 0)]

        return with_picture(compared.summarise(), draw)

    def diagnose(self, *, auto: bool = False) -> DiagnoseResult:
        """Return which effect the model lacks; `.plot()` draws the candidates.

        Args:
            auto: add what is missing, without writing it, and diagnose again until nothing is.

        Example:
            >>> verdict = project.diagnose()
            >>> verdict.verdict, verdict.effect
            ('missing', 'thermal_lag')
        """
        from zerodrift.diagnosis.advice import advise
        from zerodrift.tasks.verdict import find_verdict, list_commands, summarise_verdict

        with show_progress(Progress, "diagnosing") as say:
            verdict = find_verdict(self.config, self.dataset, self._catalogue, auto=auto, say=say)
            course = verdict.course
            effects = self.config.effects if course is None else course.effects
            advice = advise(self.config, self.dataset, effects)
        commands = list_commands(self.config.effects, verdict.steps, self._catalogue)
        told = advice.summarise() if advice is not None else None
        found = summarise_verdict(verdict, commands, told, self.directory)

        def draw() -> "Figure":
            from zerodrift.report.figures import draw_candidates

            return draw_candidates(verdict.diagnosis)

        return with_picture(found, draw)

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
        from zerodrift.discovery.plan import HOURS, Question
        from zerodrift.tasks.plan import find_plan, has_logs, read_within

        config = self.config if within is None else read_within(self.config, within)
        dataset = self.dataset if has_logs(config) else None
        wanted = hours if hours is not None else config.experiment.hours or HOURS
        question = Question(wanted, tuple(between), target, budget_s)
        with show_progress(Progress, "planning") as say:
            found = find_plan(config, dataset, self._catalogue, question, say)[1]

        def draw() -> "Figure":
            from zerodrift.report.figures_plan import draw_plan

            return draw_plan(found)

        return with_picture(found, draw)

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
        from zerodrift.diagnosis.revision import summarise_revision
        from zerodrift.tasks.effect_file import open_effect
        from zerodrift.tasks.revise import add_to_project

        if effect is None:
            raise InputError(
                "add: no effect was named; expected the name of one. The verdict names none where "
                "nothing is missing, or nothing that the catalogue knows."
            )
        self._refuse_moved()
        config, catalogue, kind = open_effect(self.config, effect)
        wanted = EffectConfig(kind, dict(hold or {}), {"signal": signal} if signal else {})
        with (
            hold_project(self.directory),
            show_progress(Progress, f"fitting without and with {kind}"),
        ):
            revision, is_kept = add_to_project(config, self.dataset, catalogue, wanted, force=force)
        if not is_kept:
            raise CheckError(
                f"{effect} was not added: {revision.reason}. `force=True` adds it all the same."
            )
        return self._follow(AddResult(**vars(summarise_revision(revision)), added=True), revision)

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
        from zerodrift.diagnosis.revision import summarise_revision
        from zerodrift.tasks.revise import remove_from_project

        self._refuse_moved()
        with (
            hold_project(self.directory),
            show_progress(Progress, f"fitting with and without {effect}"),
        ):
            revision = remove_from_project(
                self.config, self.dataset, self._catalogue, effect, signal
            )
        return self._follow(RemoveResult(**vars(summarise_revision(revision))), revision)

    revision: AddResult | RemoveResult | None = None
    """The change that made this project, with its errors; None for a project that was opened."""

    def history(self) -> HistoryResult:
        """Return the staircase of errors so far; `.plot()` draws it.

        Example:
            >>> [step.step for step in project.add("thermal_lag").history().steps]
            ['start', '+ thermal_lag']
        """
        from zerodrift.diagnosis.history import list_steps
        from zerodrift.tasks.revise import open_history

        steps = list_steps(open_history(self.config)[1])

        def draw() -> "Figure":
            from zerodrift.report.figures import draw_staircase

            return draw_staircase(steps)

        return with_picture(HistoryResult(tuple(step.summarise() for step in steps)), draw)

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
        from zerodrift.tasks.train import TrainRequest, train

        self._refuse_moved()
        with show_progress(Progress) as progress:
            return train(TrainRequest(self._folder, force=force), progress).result

    def firmware(self, *, force: bool = False, uncertainty: bool = True) -> "FirmwareSummary":
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
        from zerodrift.tasks.firmware import FirmwareRequest, make_firmware

        self._refuse_moved()
        request = FirmwareRequest(self._folder, force=force, uncertainty=uncertainty)
        with show_progress(Progress) as progress:
            made = make_firmware(request, progress)
        if made.refusal:
            raise CheckError(f"{made.refusal}\nNothing was written.", made.result)
        return made.result

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
        from zerodrift.tasks.applied_model import open_applied
        from zerodrift.tasks.apply import apply_model

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
                        skip_invalid=self._skip_invalid,
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
        from zerodrift.cli.main import cli

        target = Path(out) if out is not None else self.directory / "report.html"
        words = ["report", "-C", str(self.directory), "-o", str(target)]
        words += [] if diagnose else ["--no-diagnose"]
        words += ["--datasheet"] if datasheet else []
        words += ["--dcc", str(dcc)] if dcc is not None else []
        words += ["--skip-invalid"] if self._skip_invalid else []
        words += ["--sensor", self.sensor] if self.sensor is not None else []
        with contextlib.redirect_stdout(io.StringIO()):
            cli.main(words, standalone_mode=False)
        return target

    def _refuse_moved(self) -> None:
        """Refuse to write where zerodrift.toml is not the one that was opened."""
        if self.config.path.read_bytes() != self._text:
            raise InputError(
                f"{self.config.path}: the folder has moved on since this project was opened; "
                "expected the newest. Go on with what `add` or `remove` returned, or open it again."
            )

    def _follow(self, told: AddResult | RemoveResult, revision: "Revision") -> "Project":
        """Return the project as it is after a change of its effects."""
        follower = Project(self.directory, skip_invalid=self._skip_invalid, sensor=self.sensor)
        follower._scratch = self._scratch
        follower._folder.__dict__["dataset"] = self.dataset

        def draw() -> "Figure":
            from zerodrift.report.figures import draw_revision

            before, after = told.before.rmse_heldout, told.after.rmse_heldout
            return draw_revision(before, after, told.noise_floor)

        follower.revision = with_picture(told, draw)
        return follower

    def __repr__(self) -> str:
        """Return the folder and the model's effects."""
        unit = f", sensor={self.sensor!r}" if self.sensor is not None else ""
        return f"Project({str(self.directory)!r}{unit}): {', '.join(self.effects) or 'no effects'}"
