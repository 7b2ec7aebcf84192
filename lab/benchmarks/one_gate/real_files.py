"""Real logs and a few written for it, each labelled before anything was run on it.

The labels are from the authors' notes and from looking at the curves. `right`: nothing in the log
is wrong. `wrong`: a log is not what the project says of it. `open`: the author himself doubts the
measurement; whatever is said is printed and not counted. `nothing`: there is no output in the log.
The files lie beside the repository (../shared/data) and are not part of it.
"""

import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.one_gate.drive import Answer, ask
from benchmarks.one_gate.results import Row, scratch

DATA = Path(__file__).resolve().parents[4] / "shared" / "data"
RIGHT, WRONG, OPEN, NOTHING = "right", "wrong", "open", "nothing"


@dataclass(frozen=True)
class Project:
    """Some logs as one project.

    Attributes:
        name: of the project.
        label: right, wrong, open or nothing.
        why: what is wrong or doubtful; what the label rests on.
        logs: (path below DATA, name in the project); a folder is copied whole.
        toml: zerodrift.toml; "" = what `init` guesses, without a network.
        init: further words for `init`.
        words: for `wrong`, of which one must stand in an entry's kind or text.
        run: for `wrong`, part of the name of the run that must be named; "" = any.
    """

    name: str
    label: str
    why: str
    logs: tuple[tuple[str, str], ...]
    toml: str = ""
    init: tuple[str, ...] = ()
    words: str = ""
    run: str = ""


def _write_toml(
    logs: Sequence[str],
    output: str,
    *,
    sensor: Sequence[str],
    effects: Sequence[str] = ("zero_tempco",),
    log_keys: Sequence[str] = (),
) -> str:
    """Return a zerodrift.toml; `output` is lines of [outputs.y], parted by semicolons."""
    lines = ["format = 2", "[sensor]", 'name = "bench"', *sensor, "", "[outputs.y]"]
    lines += [line.strip() for line in output.split(";")]
    lines += ["", "[logs]", *log_keys, f"train = {[*logs]!r}"]
    for effect in effects:
        lines += ["", "[[effect]]", f'kind = "{effect}"']
    return "\n".join([*lines, "", "[network]", 'kind = "none"', ""])


OVEN = ('time = "time_s"', 'temperature = "oven_temperature_degC"')
PPM = 'measured = "drift_ppm"; unit = "ppm"; full_scale = 1000'
LAGGING = ("zero_tempco", "thermal_lag")


def _from_table(
    name: str, file: str, runs: Sequence[int], label: str, why: str, period_s: float
) -> Project:
    toml = _write_toml(
        [f"{file}#run{n}" for n in runs],
        PPM,
        sensor=(*OVEN, f"sample_period_s = {period_s:g}"),
        effects=LAGGING,
    )
    return Project(name, label, why, ((file, file),), toml)


TEMPCOS = "as_logged/20180309-r-tempcos"
FOILS = "as_logged/20180115-vhp202z"
REFERENCES = "as_logged/20171208-svrt-logging"
METER = "as_logged/20180117-hp34401a-tempco"
HANDHELD = "as_logged/20170603-resistor-tempco-datalog-1"
CHAMBER = "as_logged/20180505-dmm-chamber"


def _tempcos(
    name: str, runs: Sequence[int], label: str, why: str, words: str = "", run: str = ""
) -> Project:
    logs = tuple((f"{TEMPCOS}/run{n}/tempco.csv", f"run{n}.csv") for n in runs)
    toml = _write_toml(
        [f"run{n}.csv" for n in runs],
        'measured = "PPM"; unit = "ppm"; full_scale = 1000',
        sensor=('time = "Timestamp"', 'temperature = "Oven (C)"', "sample_period_s = 5"),
        effects=LAGGING,
    )
    return Project(name, label, why, logs, toml, words=words, run=run)


def _foils(name: str, runs: Sequence[str], label: str, why: str) -> Project:
    logs = tuple((f"{FOILS}/{run}/tempco.csv", f"{run}.csv") for run in runs)
    toml = _write_toml(
        [f"{run}.csv" for run in runs],
        'measured = "ppm"; unit = "ppm"; full_scale = 100',
        sensor=('temperature = "temp_c"', "sample_period_s = 10"),
        effects=LAGGING,
        log_keys=("period_s = 1",),
    )
    return Project(name, label, why, logs, toml)


def _meter(name: str, runs: Sequence[str], why: str, words: str) -> Project:
    logs = tuple((f"{METER}/{run}/out.csv", f"{run}.csv") for run in runs)
    toml = _write_toml(
        [f"{run}.csv" for run in runs],
        'measured = "lm399"; unit = "uV"; full_scale = 10000000',
        sensor=('time = "timestamp"', 'temperature = "temp_c"', "sample_period_s = 10"),
    )
    return Project(name, WRONG, why, logs, toml, words=words)


JUMPS = r"jump|offset|zero|\bstep|shift"
ANOTHER = r"(another|other|different).(sensor|unit|device)|gain|sign"
GENRAD, VHD = "resistor_genrad2k_oven_ramps.csv", "resistor_vhd200_oven_ramps.csv"
WORLD = "world"
UNSTABLE = "the reference is unstable, says its author; the log itself is what the meter read"
GARBAGE = "'garbage result', says the author: noise of a bad joint, of the mains or of the range"
SOIL = "world/13-proportional-outputs"
PROJECTS: tuple[Project, ...] = (
    _from_table("genrad R1", GENRAD, (1, 2), RIGHT, "one resistor, twice", 5),
    _from_table("genrad R1 to R3", GENRAD, (1, 2, 3, 4), RIGHT, "alike within 12 %", 5),
    Project(
        "genrad with run 5",
        WRONG,
        "run 5 has a copper wire in series: another device",
        ((GENRAD, GENRAD),),
        _write_toml(
            [f"{GENRAD}#run{n}" for n in (1, 2, 3, 4, 5)],
            PPM,
            sensor=(*OVEN, "sample_period_s = 5"),
            effects=LAGGING,
        ),
        words=ANOTHER,
        run="run5",
    ),
    _from_table("vhd200 divider 2, 1k", VHD, (9, 10), RIGHT, "one element, twice", 10),
    _from_table("vhd200 divider 2, 12.5k", VHD, (11, 12, 13), RIGHT, "one element, thrice", 10),
    _from_table("vhd200 divider 1, 1k", VHD, (15,), RIGHT, "one element", 10),
    _from_table("vhd200 divider 1, 12.5k", VHD, (16,), RIGHT, "one element", 10),
    _from_table("vhd200 divider 3, 1k", VHD, (17,), RIGHT, "one element", 10),
    _from_table("vhd200 divider 3, 12.5k", VHD, (18,), RIGHT, "one element", 10),
    _from_table(
        "vhd200, all nine runs",
        VHD,
        (9, 10, 11, 12, 13, 15, 16, 17, 18),
        OPEN,
        "six elements as one sensor; none of the runs stands alone",
        10,
    ),
    Project(
        "load cell",
        RIGHT,
        "22 kg for 40 hours; a lag and a slow trend",
        (("loadcell_h40a_22kg.csv", "log.csv"),),
        _write_toml(
            ["log.csv"],
            'measured = "weight_kg"; reference = "static_load_nominal_kg"; unit = "kg";'
            " full_scale = 150",
            sensor=(
                'time = "time_s"',
                'temperature = "temperature_degC"',
                "sample_period_s = 300",
            ),
            effects=LAGGING,
        ),
    ),
    Project("load cell, init", RIGHT, "the same", (("loadcell_h40a_22kg.csv", "log.csv"),)),
    _tempcos("2k runs 1, 2", (1, 2), RIGHT, "one resistor, twice"),
    _tempcos("2k run 3", (3,), RIGHT, "one resistor"),
    _tempcos("2k run 4", (4,), RIGHT, "one resistor"),
    _tempcos("2k run 5", (5,), RIGHT, "compensated by copper; alone it is a device as any"),
    _tempcos("2k run 6", (6,), RIGHT, "held at 25 degC for an hour"),
    _tempcos("2k runs 7, 8", (7, 8), RIGHT, "held at 25 degC, another linearising resistor"),
    _tempcos(
        "2k runs 1 to 5",
        (1, 2, 3, 4, 5),
        WRONG,
        "run 5 has a copper wire in series: another device",
        words=ANOTHER,
        run="run5",
    ),
    _foils("foil 1", ("run1-9k9850-1", "run2-9k9850-1"), RIGHT, "one resistor, twice"),
    _foils("foil 2", ("run3-9k9850-2",), RIGHT, "its first step was cut off by the author"),
    _foils("foil 3", ("run4-9k9850-3", "run5-9k9850-3"), RIGHT, "one resistor, at two speeds"),
    _foils("foil 19k 1", ("run6-19k970-1",), OPEN, GARBAGE),
    _foils("foil 19k 2", ("run7-19k970-2", "run8-19k970-2", "run9-19k970-2"), OPEN, GARBAGE),
    *(
        Project(
            f"reference {folder}",
            OPEN if "svrt" in folder else RIGHT,
            UNSTABLE if "svrt" in folder else "a reference overnight",
            ((f"{REFERENCES}/{folder}", "logs/run"),),
        )
        for folder in (
            "1512730462-svrt",
            "1512747712-lm399-p15",
            "1512781220-svrt",
            "1512782821-svrt-reseat",
            "1512853381-AD587-bare",
            "1512886351-svrt-no-tempco",
            "1512947800-svrt-reflowed",
            "1512954857-svrt-no-tape",
        )
    ),
    _meter("meter, fridge", ("run1-fridge",), "the zero jumps as the meter is moved", JUMPS),
    _meter("meter, balcony", ("run2-balcony",), "the zero jumps as the meter is moved", JUMPS),
    _meter(
        "meter, both",
        ("run1-fridge", "run2-balcony"),
        "one run in V, the other in uV",
        r"gain|factor|scale|unit|times|" + JUMPS,
    ),
    *(
        Project(f"hand-held {run}", RIGHT, "a coarse meter", ((f"{HANDHELD}/{run}", "logs/run"),))
        for run in (
            "run-1-5pct",
            "run-2-5pct",
            "run-3-ebay-1pct",
            "run-4-ebay-1pct",
            "run-5-rnmf",
            "run-6-mfp",
            "run-7-ptf56z",
        )
    ),
    *(
        Project(
            f"thermistor run {n}",
            NOTHING,
            "a thermometer and no output",
            ((f"{CHAMBER}/run{n}/log.csv", "log.csv"),),
        )
        for n in range(1, 8)
    ),
    Project(
        "box",
        NOTHING,
        "two thermometers in two units and humidity, no output",
        (("as_logged/20220816-34401a-in-a-box-pid/log-1660625814.csv", "log.csv"),),
    ),
    Project("T is temperature", RIGHT, "", ((f"{WORLD}/01-T-is-temperature/a.csv", "a.csv"),)),
    Project(
        "banner, cold",
        RIGHT,
        "a banner and ragged rows",
        ((f"{WORLD}/02-terminal-banner/BMI_270_cold_test_.csv", "cold.csv"),),
        init=("--period-s", "0.1"),
    ),
    Project(
        "banner, hot",
        RIGHT,
        "a banner and a torn first row",
        ((f"{WORLD}/02-terminal-banner/BMI_270_hot_head.csv", "hot.csv"),),
        init=("--period-s", "0.1"),
    ),
    Project(
        "air quality, -200 not stated",
        WRONG,
        "-200 stands for no value, in thermometer and output alike",
        ((f"{WORLD}/05-missing-marker/AirQualityUCI_head.csv", "logs/AirQualityUCI.csv"),),
        f"{WORLD}/05-missing-marker/zerodrift.toml",
        words=r"-200|sentinel|marker|missing|no value",
    ),
    Project(
        "counter of millis",
        RIGHT,
        "two runs, the second from the reset on",
        ((f"{WORLD}/06-millis-reset/logs/log.csv", "logs/log.csv"),),
        f"{WORLD}/06-millis-reset/zerodrift.toml",
    ),
    Project(
        "counter of millis, init",
        RIGHT,
        "the same",
        ((f"{WORLD}/06-millis-reset/logs/log.csv", "log.csv"),),
    ),
    Project("long form", RIGHT, "", ((f"{WORLD}/08-long-form/logs/history.csv", "history.csv"),)),
    Project(
        "soaks",
        RIGHT,
        "six temperatures, a turn-on offset each",
        ((f"{WORLD}/10-soaks/logs", "logs"),),
        f"{WORLD}/10-soaks/zerodrift.toml",
    ),
    Project(
        "soil power sensor",
        RIGHT,
        "a reading proportional to what is measured, loads in steps",
        ((f"{SOIL}/logs", "logs"),),
        f"{SOIL}/zerodrift_crosstalk.toml",
    ),
    Project(
        "oscillator",
        RIGHT,
        "nearly nothing but an offset: the gate may stop it",
        ((f"{WORLD}/14-offset-only/gpsdo.short_head.csv", "logs/gpsdo.short.csv"),),
        f"{WORLD}/14-offset-only/zerodrift.toml",
    ),
)
"""Every log of ../shared/data, in one project or more."""


def place(project: Project, folder: Path) -> Answer | None:
    """Make the project in a folder; returns what `init` said where it did not succeed.

    Raises:
        FileNotFoundError: the logs are not at hand.
    """
    for source, name in project.logs:
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if (DATA / source).is_dir():
            shutil.copytree(DATA / source, target)
        else:
            shutil.copyfile(DATA / source, target)
    made = folder / "zerodrift.toml"
    if not project.toml:
        names = [name for _, name in project.logs]
        said = ask(folder, "init", *(str(folder / name) for name in names), *project.init)
        if said.code != 0:
            return said
        text = made.read_text(encoding="utf-8")
    elif project.toml.endswith(".toml"):
        text = (DATA / project.toml).read_text(encoding="utf-8")
    else:
        text = project.toml
    text = re.sub(r'(\[network\][^\[]*?kind = )"\w+"', r'\1"none"', text)  # physics only, for speed
    made.write_text(text, encoding="utf-8")
    return None


def examine(name: str, seed: int) -> Row:
    """Make a project, run `compare` and `firmware`, and return what they say."""
    project = next(one for one in PROJECTS if one.name == name)
    with scratch() as folder:
        failed = place(project, folder)
        if failed is not None:
            return {
                "outcome": "init gives none",
                "entries": [],
                "notes": [],
                "message": failed.message,
            }
        compare, firmware = ask(folder, "compare"), ask(folder, "firmware")
    entries = firmware.list_entries("refused")
    data = [entry for entry in entries if entry.of_data]
    outcome = {0: "written", 2: "when read (exit code 2)"}.get(firmware.code, "crashed")
    if firmware.code == 1:
        outcome = "stopped as wrong data" if data else "stopped by the gate"
    fits = [
        entry
        for entry in data
        if project.run in entry.run
        and re.search(project.words, f"{entry.kind} {entry.text}".replace("_", " "), re.I)
    ]
    return {
        "outcome": outcome,
        "named": project.label == WRONG and bool(fits),
        "entries": [vars(entry) for entry in entries],
        "notes": [vars(entry) for entry in compare.list_entries("notes")],
        "message": firmware.message[:400],
    }


def tell(rows: list[Row]) -> None:
    """Print what is said of each project, and how often the label was met."""
    by_name = {project.name: project for project in PROJECTS}
    for row in rows:
        project = by_name[row["kind"]]
        named = ", fault and run named" if row.get("named") else ""
        print(f"{project.label:8s} {project.name}: {row['outcome']}{named}")
        if project.why:
            print(f"    ({project.why})")
        for entry in (row["entries"] or row["notes"])[:3]:
            print(f"    {entry['run']} {entry['column']} {entry['kind']}: {entry['text'][:160]}")
        if "(" in row["outcome"] or row["outcome"] in ("crashed", "init gives none"):
            print(f"    {row['message'][:240]}")

    def count(label: str, *outcomes: str) -> str:
        mine = [row for row in rows if by_name[row["kind"]].label == label]
        return f"{sum(row['outcome'] in outcomes for row in mine)} of {len(mine)}"

    wrong = [row for row in rows if by_name[row["kind"]].label == WRONG]
    print(f"right, stopped as wrong data: {count(RIGHT, 'stopped as wrong data')}")
    print(f"right, stopped by the gate: {count(RIGHT, 'stopped by the gate')}")
    print(f"right, not read: {count(RIGHT, 'when read (exit code 2)', 'init gives none')}")
    print(f"wrong, not stopped: {count(WRONG, 'written')}")
    print(f"wrong, fault and run named: {sum(bool(r['named']) for r in wrong)} of {len(wrong)}")
    print(f"no output, firmware written all the same: {count(NOTHING, 'written')}")
    print(f"crashed: {sum(row['outcome'] == 'crashed' for row in rows)} of {len(rows)}")
    print(f"{sum(row['cpu_s'] for row in rows):.0f} s of processor time")
