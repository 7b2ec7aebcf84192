"""`zerodrift twin`: writes simulated logs of the six-axis sensor, hidden effects on request."""

from dataclasses import dataclass
from pathlib import Path

import click

from zerodrift.base.errors import InputError
from zerodrift.base.records import to_dict
from zerodrift.cli.common import as_request, json_option, print_json
from zerodrift.tasks.trust import claim
from zerodrift_lab.commands.loop import describe_loop, run_loop
from zerodrift_lab.commands.six_axis import (
    CampaignRequest,
    describe_campaign,
    record_campaign,
    refuse_foreign_options,
    summarise_campaign,
)
from zerodrift_lab.twin import Recipe, parse_choice, simulate, write_logs
from zerodrift_lab.twin.example import RECIPE_FILE, ensure_example_logs
from zerodrift_lab.twin.logs import write_project
from zerodrift_lab.twin.recipe import (
    CHANNELS,
    LISTED_EFFECTS,
    NETWORKS,
    PARAMETERS,
    TARES,
    UNLISTED_EFFECTS,
    EffectChoice,
    draw_mystery,
    expand_channels,
)
from zerodrift_lab.twin.sensor import OUTPUTS, UNITS
from zerodrift_lab.twin.simulate import Simulation
from zerodrift_lab.twin.six_axis import list_protocols
from zerodrift_lab.twin.six_axis.files import LEVELS, render_files
from zerodrift_lab.twin.stimuli import EXERCISES, KINDS


def list_effects() -> str:
    """Return what can be hidden, with the parameters that can be stated."""
    lines = ["Effects of the catalogue:"]
    for heading, names in (("", LISTED_EFFECTS), ("Not in the catalogue:", UNLISTED_EFFECTS)):
        lines += [heading] if heading else []
        for name in sorted(names):
            ranges = PARAMETERS.get(name, {})
            stated = ", ".join(f"{key} {low:g}..{high:g}" for key, (low, high) in ranges.items())
            lines.append(f"  {name:<20}{stated}".rstrip())
    return "\n".join(lines)


def split_list(text: str) -> tuple[str, ...]:
    """Return the items of a comma-separated list; `none` and nothing are empty."""
    if text.strip() in ("", "none"):
        return ()
    return tuple(item.strip() for item in text.split(","))


def _is_given(context: click.Context, name: str) -> bool:
    """Return whether the user gave this option."""
    return context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE


def parse_choices(texts: tuple[str, ...]) -> tuple[EffectChoice, ...]:
    """Return the effects asked for; the single word `none` is no effect."""
    return () if texts == ("none",) else tuple(parse_choice(text) for text in texts)


def describe_written(simulation: Simulation, directory: Path, files: list[str]) -> str:
    """Return what was written, without a word about what is hidden."""
    recipe = simulation.recipe
    lines = [f"Simulated logs, seed {recipe.seed}, in {directory}:"]
    for run in simulation.runs:
        temperature = run.temperature_degC
        lasts_s = run.time_s.size * recipe.sample_period_s
        lines.append(
            f"  logs/{run.name + '.csv':<22}{run.use:<6}{lasts_s:7.0f} s"
            f"  {temperature.min():6.1f} to {temperature.max():5.1f} degC"
        )
    told = ", ".join(choice.name for choice in recipe.told) or "nothing"
    lines.append(f"zerodrift.toml tells the model: {told}.")
    lines.append("truth.json holds what the sensor does in fact; look only when you have decided.")
    lines.append(f"{len(files)} files. Next: zerodrift compare -C {directory}")
    return "\n".join(lines)


def summarise_written(
    simulation: Simulation, directory: Path, files: list[str]
) -> dict[str, object]:
    """Return the same as JSON values."""
    recipe = simulation.recipe
    return {
        "simulated": True,
        "directory": str(directory),
        "seed": recipe.seed,
        "files": files,
        "runs": {run.name: run.use for run in simulation.runs},
        "told": [choice.name for choice in recipe.told],
        "noise_rms": dict(zip(OUTPUTS, simulation.noise_rms.tolist(), strict=True)),
        "units": dict(zip(OUTPUTS, UNITS, strict=True)),
    }


def write_example(directory: Path, *, as_json: bool) -> None:
    """Write the simulated logs of a bundled example and say whether they were there.

    Raises:
        InputError: the directory is none of an example.
    """
    if not (directory / RECIPE_FILE).is_file():
        raise InputError(
            f"{directory / RECIPE_FILE}: there is no such file; expected the recipe of an example's"
            " simulated logs. Leave --example out to simulate others."
        )
    written = ensure_example_logs(directory)
    if as_json:
        print_json({"simulated": True, "directory": str(directory), "written": written})
    elif written:
        click.echo(f"wrote the example's simulated logs into {directory / 'logs'}")


@dataclass(frozen=True)
class TwinOptions:
    """What the command line says; the options' help explains each."""

    runs: int
    kinds: str
    test: str
    dwell: bool
    told: tuple[str, ...]
    hidden: tuple[str, ...]
    mystery: int
    size: float | None
    seed: int
    period: float
    duration: float
    noise: float
    tare: str
    missing: str
    body_thermometer: bool
    still: str
    network: str
    force: bool
    example: bool
    list_only: bool
    six_axis: bool
    protocols: tuple[str, ...]
    level: str
    specimen: int
    loop: float | None


@click.command(
    epilog="Effect: NAME, NAME=SIZE, NAME=tau_s:60 or NAME=2.5,tau_s:60. "
    "See `zerodrift twin --list` for names and parameters."
)
@click.option(
    "-C",
    "--out",
    "directory",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path(),
    help="Directory to write into; made if missing.",
)
@click.option(
    "--runs", type=click.IntRange(1, 200), default=8, show_default=True, help="Training runs."
)
@click.option(
    "--kinds",
    default="chamber",
    show_default=True,
    help=f"Kinds that the training runs take in turn: {', '.join(KINDS)}.",
)
@click.option(
    "--test",
    default="chamber,heating,cooling,walking",
    show_default=True,
    help="Kinds of the test runs; none = leave one run out.",
)
@click.option("--dwell/--no-dwell", default=True, help="Log an isothermal, unloaded dwell too.")
@click.option("--told", multiple=True, help="Effect that zerodrift.toml lists; none = no effect.")
@click.option("--hidden", multiple=True, help="Effect that zerodrift.toml does not list.")
@click.option(
    "--mystery",
    type=click.IntRange(0, 4),
    default=0,
    help="Hide that many effects drawn by the seed, without naming them.",
)
@click.option(
    "--size",
    type=float,
    default=None,
    help="RMS of each hidden effect beyond the model of --told, over the noise RMS.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--period", type=float, default=1.0, show_default=True, help="Seconds per sample.")
@click.option(
    "--duration", type=float, default=3600.0, show_default=True, help="Seconds per chamber run."
)
@click.option("--noise", type=float, default=1.0, show_default=True, help="Factor on the noise.")
@click.option(
    "--tare",
    type=click.Choice(TARES),
    default="start",
    show_default=True,
    help="Zero every log over its first ten seconds, or not (six-axis: none).",
)
@click.option(
    "--missing", default="", help=f"Channels that are not logged: {', '.join(CHANNELS[:-1])}."
)
@click.option("--body-thermometer", is_flag=True, help="Log a second thermometer on the body.")
@click.option("--still", default="", help=f"What runs do not move: {', '.join(EXERCISES)}.")
@click.option(
    "--network",
    type=click.Choice(NETWORKS),
    default="none",
    show_default=True,
    help="[network] kind to write.",
)
@click.option("--force", is_flag=True, help="Overwrite an earlier simulation.")
@click.option(
    "--example",
    is_flag=True,
    help="Write the logs of the twin.json in that directory, unless they are there.",
)
@click.option("--list", "list_only", is_flag=True, help="List what can be hidden, and stop.")
@click.option(
    "--six-axis", is_flag=True, help="The deeper twin: photo-couplers, thirteen thermal nodes."
)
@click.option(
    "--protocol",
    "protocols",
    multiple=True,
    metavar="FILE|NAME",
    help="Six-axis: protocol of the training runs, bundled or your own; repeat it.",
)
@click.option(
    "--level",
    type=click.Choice(LEVELS),
    default="force",
    show_default=True,
    help="Six-axis: raw forces, converter codes, or forces and CAN frames.",
)
@click.option(
    "--sensor",
    "specimen",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Six-axis: which simulated sensor.",
)
@click.option(
    "--loop",
    type=click.FloatRange(0.5, 1000.0),
    metavar="HOURS",
    help="Plan, record, diagnose and add until nothing is missing or so many hours are spent; "
    "writes nothing.",
)
@json_option
@click.pass_context
@as_request(TwinOptions)
def command(context: click.Context, directory: Path, as_json: bool, request: TwinOptions) -> None:
    """Write simulated logs of the six-axis sensor, and a zerodrift.toml that knows only a part.

    The truth lies beside them in truth.json, which no command reads.
    """
    given = {name for name in context.params if _is_given(context, name)}
    if request.list_only:
        click.echo(list_effects())
        click.echo("Protocols of --six-axis: " + ", ".join(list_protocols()))
        return
    if request.example:
        refuse_foreign_options(given - {"example"})
        write_example(directory, as_json=as_json)
        return
    if request.loop is not None:
        if request.six_axis:
            raise InputError("twin: --loop is for the plain twin; leave --six-axis out.")
        from zerodrift.cli.console import show_progress

        with show_progress("simulating logs") as say:
            looped = run_loop(ask_recipe(request), request.loop, say)
        if as_json:
            print_json({"simulated": True, **to_dict(looped)})
        else:
            click.echo(describe_loop(looped))
        return
    if request.six_axis:
        refuse_foreign_options(given)
        campaign = record_campaign(ask_campaign(request, given))
        files = render_files(campaign, request.level, list_channels(request))
        made = write_project(files, directory, overwrite=request.force)
        claim(directory)
        names = [path.relative_to(directory).as_posix() for path in made]
        if as_json:
            print_json(summarise_campaign(campaign, directory, names))
        else:
            click.echo(describe_campaign(campaign, directory, names, request.level))
        return
    if own := given & {"protocols", "level", "specimen"}:
        option = {"protocols": "--protocol", "level": "--level", "specimen": "--sensor"}[min(own)]
        raise InputError(f"twin: {option} belongs to the six-axis twin; add --six-axis.")
    simulation = simulate(ask_recipe(request))
    written = write_logs(simulation, directory, overwrite=request.force)
    names = [path.relative_to(directory).as_posix() for path in written]
    if as_json:
        print_json(summarise_written(simulation, directory, names))
    else:
        click.echo(describe_written(simulation, directory, names))


def list_channels(options: TwinOptions) -> tuple[str, ...]:
    """Return the channels that are logged."""
    left_out = expand_channels(split_list(options.missing))
    logged = CHANNELS if options.body_thermometer else CHANNELS[:-1]
    return tuple(name for name in logged if name not in left_out)


def ask_campaign(options: TwinOptions, given: set[str]) -> CampaignRequest:
    """Return what is to be recorded of a six-axis specimen; `given` names the options given."""
    return CampaignRequest(
        specimen=options.specimen,
        protocols=options.protocols,
        runs=options.runs if "runs" in given else None,
        test=split_list(options.test),
        dwell=options.dwell,
        hidden=parse_choices(options.hidden),
        seed=options.seed,
        period_s=options.period,
        noise=options.noise,
        tare=options.tare if "tare" in given else "none",
        level=options.level,
    )


def ask_recipe(options: TwinOptions) -> Recipe:
    """Return what is to be simulated.

    Raises:
        InputError: an option names what there is not.
    """
    cycle = split_list(options.kinds)
    if not cycle:
        raise InputError(f"twin: --kinds names no kind of run. Known: {', '.join(KINDS)}.")
    told = parse_choices(options.told) if options.told else Recipe().told
    hidden = parse_choices(options.hidden)
    channels = list_channels(options)
    unmoved = split_list(options.still)
    for name in unmoved:
        if name not in EXERCISES:
            raise InputError(f"twin: --still {name}: known are {', '.join(EXERCISES)}.")
    return Recipe(
        seed=options.seed,
        train=tuple(cycle[number % len(cycle)] for number in range(options.runs)),
        test=split_list(options.test),
        dwell=options.dwell,
        told=told,
        hidden=hidden + draw_mystery(options.seed, options.mystery, (*told, *hidden)),
        size=options.size,
        sample_period_s=options.period,
        duration_s=options.duration,
        noise=options.noise,
        tare=options.tare,
        channels=channels,
        exercise=tuple(name for name in EXERCISES if name not in unmoved),
        network=options.network,
    )
