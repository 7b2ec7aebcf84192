"""zerodrift.toml as frozen dataclasses; the names in it are the users' contract."""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

from zerodrift.base.calibration_config import CalibrationConfig, read_calibration
from zerodrift.base.column_config import (
    ROW_TIME,
    ClockConfig,
    CodesConfig,
    ConversionConfig,
    TimeConfig,
    check_junctions,
    read_clocks,
    read_column,
    read_quantity,
    read_time,
)
from zerodrift.base.errors import InputError
from zerodrift.base.experiment_config import ExperimentConfig, read_experiment
from zerodrift.base.files import name_kind
from zerodrift.base.fleet_config import (
    BLOCK_KEYS,
    PLACEHOLDER,
    BlockConfig,
    FleetConfig,
    read_block_config,
    read_fleet,
)
from zerodrift.base.toml_table import LARGEST, TomlTable, find_line, index_lines

# Values of the logs that mean that there is none: `missing`, of [logs] or of a column's table.

KEY = "missing"
EXPECTED = 'a list of numbers and texts, such as [-200, "NAN"]'


@dataclass(frozen=True)
class MissingConfig:
    """What a log writes where it has no value."""

    everywhere: tuple[float | str, ...] = ()
    """`[logs] missing`: in all columns but the time."""
    columns: Mapping[str, tuple[float | str, ...]] = field(default_factory=dict)
    """Column -> further ones, from its own table."""

    def list_numbers(self, column: str) -> tuple[float, ...]:
        """Return the numbers that are no value in a column."""
        return tuple(value for value in self._list(column) if not isinstance(value, str))

    def list_texts(self, column: str) -> tuple[str, ...]:
        """Return the texts that are no value in a column."""
        return tuple(value for value in self._list(column) if isinstance(value, str))

    def _list(self, column: str) -> tuple[float | str, ...]:
        return (*self.everywhere, *self.columns.get(column, ()))


def read_missing(table: TomlTable) -> tuple[float | str, ...]:
    """Return the values of a table's key `missing`; empty where it is left out.

    Raises:
        InputError: it is no list of numbers and texts.
    """
    if KEY not in table.values:
        return ()
    found = table.values[KEY]
    if not isinstance(found, list) or not found:
        raise table.expect(KEY, EXPECTED)
    values: list[float | str] = []
    for item in found:
        if isinstance(item, str) and item.strip():
            values.append(item.strip())
            continue
        one = TomlTable(table.file, table.lines, table.key, {KEY: item})
        values.append(one.number(KEY, EXPECTED))
    return tuple(values)


def read_column_missing(table: TomlTable, key: str) -> dict[str, tuple[float | str, ...]]:
    """Return column -> values, where a key holds a column's table with `missing`.

    Raises:
        InputError: as `read_missing`.
    """
    found = table.values.get(key)
    if not isinstance(found, dict) or KEY not in found:
        return {}
    inner = table.table(key, None)
    return {inner.text("column"): read_missing(inner)}


# The keys of `[sensor]` that say when the firmware's steps come.

STEP_KEYS = ("sample_period_s", "log_period_s")
VARIABLE = "variable"
SHORTEST_S, LONGEST_S = 1e-6, 4294.0
"""Of the rows of a variable step's logs: the firmware counts microseconds in 32 bits there."""
ANY_STEP_KINDS = ("none", "lag_bank", "mlp")
"""Networks that carry nothing from sample to sample but low-passes."""


@dataclass(frozen=True)
class StepConfig:
    """When steps come."""

    period_s: float
    """Seconds between two steps; of a variable step, between two rows of the logs."""
    is_variable: bool
    """Whether each step is given the time since the last one."""


def read_step(sensor: TomlTable) -> StepConfig:
    """Return the keys of `[sensor]` on the step.

    Raises:
        InputError: a value of the wrong type or range, or a key that belongs to another.
    """
    if not isinstance(sensor.values.get("sample_period_s"), str):
        if "log_period_s" in sensor.values:
            raise sensor.error(
                "log_period_s",
                f'log_period_s stands beside sample_period_s = "{VARIABLE}" alone; the logs are'
                " brought to sample_period_s. Take it out.",
            )
        return StepConfig(sensor.positive("sample_period_s"), False)
    if sensor.values["sample_period_s"] != VARIABLE:
        raise sensor.expect("sample_period_s", f'a number > 0, or "{VARIABLE}"')
    span = f"the seconds between two rows of the logs, {SHORTEST_S:g} to {LONGEST_S:g}"
    period_s = sensor.number("log_period_s", span)
    if not SHORTEST_S <= period_s <= LONGEST_S:
        raise sensor.expect("log_period_s", span)
    return StepConfig(period_s, True)


def refuse_equal_steps(root: TomlTable, network: str) -> None:
    """Refuse a network whose weights hold only for steps of equal length.

    Raises:
        InputError: names it, and what to use instead.
    """
    if network in ANY_STEP_KINDS:
        return
    table = root.table("network", None, optional=True)
    raise table.error(
        "kind",
        f'"{network}" carries from sample to sample what its weights know for one sample period, or'
        f' may; sample_period_s = "{VARIABLE}" has none. Use kind = "lag_bank" or "none", or state'
        " sample_period_s as a number.",
    )


# zerodrift.toml as frozen dataclasses; the names in it are the users' contract.

FILE_NAME = "zerodrift.toml"
USES = TRAIN, TEST, DWELL = ("train", "test", "dwell")
"""What `[logs]` selects runs for."""
AUTO = "auto"
LOG_KEYS = (
    *("train", "test", "dwell", "where", "period_s", "offset_s", "time", "common", "tared"),
    *("accept", "missing"),
)
OUTPUT_KEYS = ("measured", "reference", "unit", "full_scale")
FORMATS = (1, 2)
"""Of zerodrift.toml: 1, which need not be stated, leaves codes of inputs to each unit's logs."""
DATA_TABLES = ("sensor", "outputs", "inputs", "logs")
MOST = {"starts": 1000, "epochs": 1_000_000}
"""Trainings from different weights, and passes over the logs, that are still meant."""
MODEL_TABLES = (
    *("effect", "network", "quantization", "firmware", "plugins", "fleet", "experiment"),
    "calibration",
)
NETWORK_KINDS = ("lag_bank", "gru", "lstm", "mlp", "mlp_seq", "tcn", "none", AUTO)
CONSTRAINTS = ("contracting", "limited")
"""Keys by which a recurrent network's weights are kept small."""
CHOSEN_BY_AUTO = (
    *("hidden", "memory", "spacing_s", "form", "learning_rate", "lags_s"),
    *CONSTRAINTS,
)
"""Keys that mean nothing beside kind = "auto"."""
RECURRENT_KINDS = ("gru", "lstm")
"""These carry a state, or run over a window."""
WINDOWED_KINDS = ("mlp_seq", "tcn")
"""These see a window of samples; recurrent ones may."""
HIDDEN = {"mlp": 36, "mlp_seq": 36}
"""Units of the kinds whose default is not the GRU's."""
WINDOW = 10
LONGEST_WINDOW = 4096
"""A recurrent network goes through the whole window at every step."""
WEIGHT_FORMATS = ("int16", "int8")
MAX_OUTPUTS = 16
MAX_HIDDEN = 256
GRU_FORMS = ("reset_after", "reset_before")
NETWORK_KEYS = ("kind", "hidden", "memory", "seed", "lags_s")
NETWORK_OPTIONS = (
    *("starts", "epochs", "form", "learning_rate", "spacing_s"),
    *CONSTRAINTS,
)


@dataclass(frozen=True)
class OutputConfig:
    """One quantity that drifts (`[outputs.NAME]`)."""

    name: str
    measured: str
    """Column before compensation, in `unit`."""
    reference: str | float
    """Column, or a number; 0.0 where the file names none."""
    unit: str
    full_scale: float


@dataclass(frozen=True)
class EffectConfig:
    """One `[[effect]]` table: its kind, the parameters held at a value, other options (text)."""

    kind: str
    held: Mapping[str, float] = field(default_factory=dict)
    """Parameters written in the table: held, not fitted."""
    options: Mapping[str, str] = field(default_factory=dict)
    """Text options such as `signal = "body_temperature"`."""
    line: int = 0
    """Line in zerodrift.toml, for messages."""


@dataclass(frozen=True)
class NetworkConfig:
    """`[network]`: what learns the part of the drift that the physical model leaves."""

    kind: str = "none"
    """lag_bank | gru | lstm | mlp | mlp_seq | tcn | none | auto."""
    hidden: int = 16
    memory: str | int = "stream"
    """"stream", or the window's length in samples."""
    seed: int = 0
    options: Mapping[str, float | int | str | bool] = field(default_factory=dict)
    """Any further documented key, for example `starts`, `epochs`, `form`."""
    lags_s: tuple[float, ...] = ()
    """Time constants of the lag bank that the network sees; empty = the trainer's own choice."""


@dataclass(frozen=True)
class Config:
    """A whole zerodrift.toml, checked."""

    path: Path
    """The zerodrift.toml itself; relative names in it are relative to its folder."""
    sensor_name: str
    time_column: str
    temperature_column: str
    sample_period_s: float
    """Seconds between two steps; of a variable step, between two rows of the logs."""
    outputs: tuple[OutputConfig, ...]
    inputs: Mapping[str, str]
    """Channel name -> column."""
    train_logs: tuple[str, ...]
    test_logs: tuple[str, ...]
    dwell_logs: tuple[str, ...]
    effects: tuple[EffectConfig, ...]
    network: NetworkConfig
    weights: str
    """int16 | int8."""
    firmware_out: Path
    """Absolute folder for the generated C."""
    plugin_files: tuple[Path, ...]
    where: Mapping[str, str] = field(default_factory=dict)
    """`[logs] where`: column -> the value that a row must have there to be read."""
    accept: tuple[str, ...] = ()
    """`[logs] accept`: notes on wrong data that the user takes on, each "RUN: KIND"."""
    missing: MissingConfig = field(default_factory=MissingConfig)
    """Values that mean that there is none: of all columns, and of single ones."""
    tared: bool | None = None
    """`[logs] tared`: whether each run is zeroed by itself; None ("auto"): decided from the
    logs."""
    unit_build: Path | None = None
    """Of a unit of a fleet: the folder of its model; None: build/."""
    firmware_prefix: str = ""
    """What the C's names begin with, `{sensor}` standing for a fleet's sensor; empty: its name."""
    firmware_guard: bool = False
    """Whether the C keeps a checksum over its state."""
    firmware_tare: bool = False
    """Whether the C can count the drift from a moment on."""
    block: BlockConfig = field(default_factory=BlockConfig)
    """`[firmware]`: whether the coefficients are in a block, and the block's fields."""
    fleet: FleetConfig = field(default_factory=FleetConfig)
    """`[fleet]`: for `zerodrift fleet` alone."""
    experiment: ExperimentConfig = field(default_factory=ExperimentConfig)
    """`[experiment]`: for `zerodrift plan` alone."""
    calibration: CalibrationConfig = field(default_factory=CalibrationConfig)
    """`[calibration]`: for certificates alone."""
    time: TimeConfig = field(default_factory=TimeConfig)
    """How the times of `time_column` are written."""
    clocks: ClockConfig = field(default_factory=ClockConfig)
    """What `[logs]` states about the clocks of single logs."""
    temperature_codes: CodesConfig = field(default_factory=CodesConfig)
    """The codes of the thermometer that the chip is given."""
    input_codes: Mapping[str, CodesConfig] = field(default_factory=dict)
    """Channel name -> its codes that the chip is given."""
    conversions: Mapping[str, ConversionConfig] = field(default_factory=dict)
    """Column -> how its logged values become the quantity."""
    variable_step: bool = False
    """`sample_period_s = "variable"`: whether each step is given the time since the last one."""
    format: int = 1
    """Format of zerodrift.toml. From 2 on no LSB follows from a unit's logs."""

    @property
    def directory(self) -> Path:
        """The project directory: where zerodrift.toml lies."""
        return self.path.parent

    @property
    def build_directory(self) -> Path:
        """`build/` in the project directory: fitted values, checkpoints, artefacts.

        Of a unit of a fleet, its own folder there.
        """
        return self.unit_build or self.directory / "build"


def load_config(path_or_directory: Path) -> Config:
    """Read and check a zerodrift.toml, given the file or the directory it lies in.

    Raises:
        InputError: the file is missing, is not TOML, has an unknown key, or a value of the wrong
            type or range; the message names the line.
    """
    given = Path(path_or_directory)
    path = given / FILE_NAME if given.is_dir() else given
    if not path.exists():
        raise InputError(
            f"{path}: there is no such file. `zerodrift init LOG...` writes a {FILE_NAME} guessed "
            "from your logs; `-C DIR` names the directory it lies in."
        )
    if not path.is_file():
        # Opening a named pipe would block for ever.
        raise InputError(
            f"{path}: is {name_kind(path)}; expected a file, the project's configuration. Remove "
            f"it, and run `zerodrift init LOG...`, or name another directory by -C."
        )
    try:
        # The byte order mark that some editors write is not part of the text.
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        line = path.read_bytes()[: error.start].count(b"\n") + 1
        raise InputError(
            f"{path}:{line}: byte 0x{error.object[error.start]:02x} is not UTF-8; expected UTF-8 "
            "text. Save the file as UTF-8."
        ) from error
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); expected a file that this user may read."
        ) from error
    return parse_config(text, path.absolute())


def parse_config(text: str, path: Path) -> Config:
    """Check the text of a zerodrift.toml that lies (or would lie) at `path`.

    Raises:
        InputError: as `load_config`.
    """
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(_describe_syntax_error(path, str(error))) from error
    except (ValueError, RecursionError) as error:  # a number of thousands of digits, deep nesting
        raise InputError(
            f"{path}: cannot be read ({str(error).split(';')[0]}); expected a {FILE_NAME} of plain "
            "tables, numbers and text. Correct the value."
        ) from error
    root = TomlTable(path, index_lines(text), (), values)
    root.refuse_unknown((*DATA_TABLES, *MODEL_TABLES, "format"))
    sensor = root.table("sensor", ("name", "time", "temperature", *STEP_KEYS))
    step = read_step(sensor)
    logs = root.table("logs", LOG_KEYS)
    quantization = root.table("quantization", ("weights",), optional=True)
    firmware = root.table(
        "firmware", ("out", "prefix", "guard", "tare", *BLOCK_KEYS), optional=True
    )
    outputs, converted_outputs = _read_outputs(root)
    inputs = root.table("inputs", None, optional=True)
    clocks = read_clocks(logs)
    time = TimeConfig((ROW_TIME,))
    if "time" in sensor.values or not clocks.periods_s:
        time = read_time(sensor, "time")
    temperature_column, temperature_codes, temperature_by = read_column(sensor, "temperature")
    columns = {name: read_column(inputs, name) for name in inputs.values}
    conversions = [(temperature_column, temperature_by)]
    conversions += [(column, by) for column, _, by in columns.values()]
    own = [(sensor, "temperature", temperature_codes.by or temperature_by)]
    own += [(inputs, name, codes.by or by) for name, (_, codes, by) in columns.items()]
    own += [(table, key, by) for table, key, _, by in converted_outputs]
    check_junctions(inputs, own)
    conversions += [(column, by) for _, _, column, by in converted_outputs]
    config = Config(
        path=path,
        sensor_name=sensor.text("name"),
        time_column=time.name,
        time=time,
        clocks=clocks,
        temperature_column=temperature_column,
        sample_period_s=step.period_s,
        variable_step=step.is_variable,
        outputs=outputs,
        inputs={name: column for name, (column, _, _) in columns.items()},
        train_logs=_read_selectors(logs, "train"),
        test_logs=_read_selectors(logs, "test"),
        dwell_logs=_read_selectors(logs, "dwell"),
        effects=_read_effects(root),
        network=_read_network(root.table("network", None, optional=True)),
        weights=quantization.choice("weights", WEIGHT_FORMATS, "int16"),
        firmware_out=path.parent
        / (firmware.text("out") if "out" in firmware.values else "firmware"),
        firmware_prefix=_read_prefix(firmware),
        firmware_guard=firmware.flag("guard"),
        firmware_tare=firmware.flag("tare"),
        block=read_block_config(firmware),
        plugin_files=_read_plugins(root),
        where=_read_where(logs),
        accept=_read_accepted(logs),
        missing=_read_all_missing(root, logs),
        tared=_read_tared(logs),
        fleet=read_fleet(
            root.table("fleet", None, optional=True), tuple(output.name for output in outputs)
        ),
        experiment=read_experiment(
            root.table("experiment", None, optional=True),
            tuple(output.name for output in outputs),
            tuple(inputs.values),
        ),
        calibration=read_calibration(root.table("calibration", None, optional=True)),
        temperature_codes=temperature_codes,
        input_codes={name: codes for name, (_, codes, _) in columns.items()},
        conversions={column: by for column, by in conversions if by is not None},
        format=_read_format(root),
    )
    if step.is_variable:
        refuse_equal_steps(root, config.network.kind)
    _refuse_shared_columns(config, root)
    _refuse_file_as_build(config)
    return config


def locate_key(path: Path, *key: str) -> str:
    """Return `zerodrift.toml:LINE` for a key, or the path alone when the file cannot be read."""
    try:
        if not path.is_file():
            return str(path)
        lines = _index_lines(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError):
        return str(path)
    return f"{path}:{find_line(lines, key)}"


@lru_cache(maxsize=4)
def _index_lines(text: str) -> Mapping[tuple[str | int, ...], int]:
    """Return `index_lines`, cached for a text that a whole fleet shares."""
    return MappingProxyType(index_lines(text))


def _describe_syntax_error(path: Path, message: str) -> str:
    """Turn tomllib's `... (at line 3, column 5)` into `file:3: ...`."""
    match = re.search(r"\(at line (\d+), column (\d+)\)", message)
    what = re.sub(r"\s*\(at .*\)$", "", message)
    place = f"{path}:{match.group(1)}" if match else str(path)
    return f"{place}: not valid TOML: {what}. Text needs quotes, tables are written [name]."


def _read_format(root: TomlTable) -> int:
    """Read the file's format; files without the key are of format 1."""
    found = root.values.get("format", FORMATS[0])
    if isinstance(found, bool) or not isinstance(found, int) or found not in FORMATS:
        raise root.error(
            "format",
            f"format is {found!r}; expected {' or '.join(map(str, FORMATS))}, the formats that this"
            " zerodrift knows. Install a newer one, or correct it.",
        )
    return found


def _read_selectors(logs: TomlTable, use: str) -> tuple[str, ...]:
    """Read a list of selectors; a list within it is one log of several files."""
    found = logs.values.get(use)
    if isinstance(found, list) and any(isinstance(item, list) for item in found):
        lists = [item if isinstance(item, list) else [item] for item in found]
        tables = (TomlTable(logs.file, logs.lines, logs.key, {use: item}) for item in lists)
        return tuple(" + ".join(table.texts(use)) for table in tables)
    return logs.texts(use, optional=use != "train")


def _read_outputs(
    root: TomlTable,
) -> tuple[tuple[OutputConfig, ...], list[tuple[TomlTable, str, str, ConversionConfig | None]]]:
    """Read the outputs, and the conversions of their columns: table, key, column, conversion."""
    tables = root.table("outputs", None)
    if not 1 <= len(tables.values) <= MAX_OUTPUTS:
        raise tables.error(
            None,
            f"{len(tables.values)} outputs found; expected 1 to {MAX_OUTPUTS} tables "
            "[outputs.NAME], one per quantity that drifts.",
        )
    outputs = []
    conversions: list[tuple[TomlTable, str, str, ConversionConfig | None]] = []
    for name in tables.values:
        table = tables.table(name, OUTPUT_KEYS)
        unit = table.text("unit")
        measured, by = read_quantity(table, "measured", unit)
        conversions.append((table, "measured", measured, by))
        reference: str | float = 0.0
        if isinstance(table.values.get("reference"), str | dict):
            reference, by = read_quantity(table, "reference", unit)
            conversions.append((table, "reference", reference, by))
        elif "reference" in table.values:
            reference = table.number("reference", "a column's name in quotes, or a number")
        outputs.append(
            OutputConfig(
                name,
                measured,
                reference,
                unit,
                table.positive("full_scale"),
            )
        )
    return tuple(outputs), conversions


def _read_effects(root: TomlTable) -> tuple[EffectConfig, ...]:
    """Read the `[[effect]]` tables; the catalogue checks kinds and parameters."""
    found = root.values.get("effect", [])
    if not isinstance(found, list) or not all(isinstance(item, dict) for item in found):
        raise root.expect("effect", "tables in double brackets, written [[effect]]")
    effects = []
    for position, values in enumerate(found):
        table = TomlTable(root.file, root.lines, ("effect", position), values)
        held: dict[str, float] = {}
        options: dict[str, str] = {}
        for key, value in values.items():
            if key == "kind":
                continue
            if isinstance(value, str):
                options[key] = table.text(key)
            else:
                held[key] = table.number(key, "a number (held at it) or text (an option)")
        effects.append(EffectConfig(table.text("kind"), held, options, table.line()))
    return tuple(effects)


def _read_network(table: TomlTable) -> NetworkConfig:
    table.refuse_unknown(NETWORK_KEYS + NETWORK_OPTIONS)
    default = NetworkConfig()
    if table.values and "kind" not in table.values:
        raise table.expect("kind", f"one of {', '.join(NETWORK_KINDS)}")
    memory: str | int = default.memory
    if "memory" in table.values and table.values["memory"] != "stream":
        if isinstance(table.values["memory"], str):
            raise table.expect("memory", f"'stream' or a window of 2 to {LONGEST_WINDOW} samples")
        memory = table.integer("memory", 2, LONGEST_WINDOW)
    options: dict[str, float | int | str | bool] = {}
    for key in ("starts", "epochs"):
        if key in table.values:
            options[key] = table.integer(key, 1, MOST[key])
    if "form" in table.values:
        options["form"] = table.choice("form", GRU_FORMS, "")
    for key in ("learning_rate", "spacing_s"):
        if key in table.values:
            options[key] = table.positive(key)
    kind = table.choice("kind", NETWORK_KINDS, default.kind)
    for key in CHOSEN_BY_AUTO if kind == AUTO else ():
        if key in table.values:
            raise table.error(key, f'kind = "auto" chooses that by itself; leave `{key}` out.')
    for key, what in zip(CONSTRAINTS, ("it forgets", "its answer has limits"), strict=True):
        if not table.flag(key):
            continue
        if kind not in RECURRENT_KINDS:
            raise table.error(
                key,
                f"only a GRU or LSTM is trained so that {what}, and `kind` is '{kind}';"
                ' leave it out, or write kind = "gru".',
            )
        options[key] = True
    if kind in WINDOWED_KINDS and memory == "stream":
        memory = WINDOW
    if memory != "stream" and kind not in (*WINDOWED_KINDS, *RECURRENT_KINDS):
        raise table.error(
            "memory",
            f"'{kind}' sees no past samples, so a window means nothing; leave `memory` out.",
        )
    usual = HIDDEN.get(kind, default.hidden)
    return NetworkConfig(
        kind=kind,
        hidden=table.integer("hidden", 1, MAX_HIDDEN) if "hidden" in table.values else usual,
        memory=memory,
        seed=table.integer("seed", 0) if "seed" in table.values else default.seed,
        options=options,
        lags_s=_read_lags(table),
    )


def _read_lags(table: TomlTable) -> tuple[float, ...]:
    lags = table.values.get("lags_s", [])
    expected = "a list of numbers > 0, in seconds"
    if not isinstance(lags, list):
        raise table.expect("lags_s", expected)
    for lag in lags:
        if isinstance(lag, bool) or not isinstance(lag, int | float) or not 0 < lag < LARGEST:
            raise table.expect("lags_s", expected)
    return tuple(float(lag) for lag in lags)


def _read_plugins(root: TomlTable) -> tuple[Path, ...]:
    table = root.table("plugins", ("files",), optional=True)
    files = []
    for name in table.texts("files", optional=not table.values):
        file = root.file.parent / name
        if not file.is_file():
            raise table.error("files", f"plugin '{name}' is not a file; expected it at {file}.")
        files.append(file)
    return tuple(files)


def _read_prefix(table: TomlTable) -> str:
    if "prefix" not in table.values:
        return ""
    prefix = table.text("prefix")
    if re.search(r"[{}]", prefix.replace(PLACEHOLDER, "")):
        raise table.expect("prefix", f"text in which {PLACEHOLDER} alone stands in braces")
    return prefix


def _read_where(logs: TomlTable) -> dict[str, str]:
    """Read the row filter; a whole number is compared by its digits, as the log writes it."""
    table = logs.table("where", None, optional=True)
    for column, value in table.values.items():
        if isinstance(value, bool) or not isinstance(value, str | int):
            raise table.expect(column, "text in quotes or a whole number")
    return {column: str(value) for column, value in table.values.items()}


def _read_accepted(table: TomlTable) -> tuple[str, ...]:
    """Read `[logs] accept`: the notes on wrong data, "RUN: KIND", that the user takes on."""
    if table.values.get("accept") == []:
        return ()
    entries = table.texts("accept", optional=True)
    for entry in entries:
        run, colon, kind = entry.rpartition(":")
        if not (colon and run.strip() and kind.strip()):
            raise table.error(
                "accept",
                f"{table.label('accept')} holds '{entry}'; expected \"RUN: KIND\", such as "
                '"train_3: gain". `zerodrift compare` prints both of every note.',
            )
    return entries


def _read_all_missing(root: TomlTable, logs: TomlTable) -> MissingConfig:
    """Read `missing` of [logs] and of the columns' tables."""
    sensor, inputs = root.table("sensor", None), root.table("inputs", None, optional=True)
    places = [(sensor, "temperature"), *((inputs, name) for name in inputs.values)]
    outputs = root.table("outputs", None)
    for name in outputs.values:
        places += [(outputs.table(name, None), key) for key in ("measured", "reference")]
    columns: dict[str, tuple[float | str, ...]] = {}
    for table, key in places:
        columns |= read_column_missing(table, key)
    return MissingConfig(read_missing(logs), columns)


def _read_tared(logs: TomlTable) -> bool | None:
    """Read whether runs are zeroed one by one; None for "auto", and where the key is missing."""
    value = logs.values.get("tared", AUTO)
    if value == AUTO:
        return None
    if not isinstance(value, bool):
        raise logs.expect("tared", f'true, false or "{AUTO}"')
    return value


def _refuse_file_as_build(config: Config) -> None:
    """Refuse a file where the folders have to be that the commands write into."""
    for folder in (config.build_directory, config.firmware_out):
        if folder.exists() and not folder.is_dir():
            raise InputError(
                f"{folder}: is a file; expected a folder, or nothing, where zerodrift keeps what it"
                " makes. Move the file away or give it another name."
            )


def _refuse_shared_columns(config: Config, root: TomlTable) -> None:
    """Refuse a column in two roles: most likely a table was copied and not edited."""
    sensor = root.table("sensor", None)
    roles = {config.time_column: sensor.label("time")}
    uses = [(sensor, "temperature", config.temperature_column)]
    outputs = root.table("outputs", None)
    uses += [
        (outputs.table(output.name, None), "measured", output.measured) for output in config.outputs
    ]
    for table, key, column in uses:
        if column in roles:
            raise table.error(
                key,
                f"column '{column}' is both {roles[column]} and {table.label(key)}; "
                "expected a column of its own for each.",
            )
        roles[column] = table.label(key)
    for table, _, _ in uses[1:]:
        if table.values.get("reference") == table.values["measured"]:
            raise table.error(
                "reference",
                f"{table.label('reference')} is the measured column itself, so that the drift "
                "would be 0; expected the column of the true value, a number, or no reference.",
            )
