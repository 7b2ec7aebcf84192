"""What to simulate: the runs, the effects the model is told about, and those that are hidden."""

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from zerodrift.base.errors import InputError, nearest
from zerodrift_lab.twin.disturbances import CATALOGUE, UNLISTED
from zerodrift_lab.twin.elements import ELEMENT_EFFECTS
from zerodrift_lab.twin.sensor import draw_stream
from zerodrift_lab.twin.stimuli import EXERCISES, KINDS

#: Effects of the catalogue that can be hidden, by the catalogue's names.
LISTED_EFFECTS = (
    *CATALOGUE,
    *(name for name in ELEMENT_EFFECTS if name != "heat_path"),
    "adc_saturation",
)
#: Disturbances that the catalogue does not know.
UNLISTED_EFFECTS = (*UNLISTED, "heat_path")
EFFECTS = (*LISTED_EFFECTS, *UNLISTED_EFFECTS)

#: Channels that the logs can hold besides time, temperature and the outputs.
CHANNELS = (
    "supply",
    "humidity",
    "ambient_light",
    "acceleration_x",
    "acceleration_y",
    "acceleration_z",
    "clock",
    "body_temperature",
)

TARES = ("start", "none")
NETWORKS = ("none", "lag_bank", "gru", "lstm", "mlp", "mlp_seq", "tcn")

#: Shape parameters that a user may state, and the range that the generator accepts.
PARAMETERS: dict[str, dict[str, tuple[float, float]]] = {
    "zero_tempco": {"order": (1.0, 3.0)},
    "dark_current": {"doubling_K": (4.0, 40.0)},
    "warm_up": {"tau_s": (1.0, 1e5)},
    "creep": {"tau_s": (1.0, 1e5), "slow_tau_s": (1.0, 1e6), "slow_share": (0.0, 1.0)},
    "load_hysteresis": {"half_width_pct": (0.01, 50.0)},
    "humidity": {"tau_s": (1.0, 1e6)},
    "ageing": {"exponent": (0.1, 3.0)},
    "beat": {
        "period_s": (2.0, 1e6),
        "second_period_s": (2.0, 1e6),
        "phase_rad": (0.0, 6.2832),
    },
    "threshold": {"threshold_degC": (-50.0, 120.0)},
    "thermal_lag": {"tau_s": (0.1, 1e5), "slow_tau_s": (0.1, 1e6), "slow_share": (0.0, 1.0)},
    "thermal_hysteresis": {"half_width_K": (1e-3, 100.0)},
    "clock_delay": {"delay_s": (-60.0, 60.0)},
    "heat_path": {"share": (1e-3, 1.0)},
    "adc_saturation": {"rail_pct": (0.1, 100.0)},
}


@dataclass(frozen=True)
class EffectChoice:
    """One effect of the simulated sensor, as asked for."""

    name: str
    size: float | None = None
    """RMS of what the told model cannot absorb of it, over the noise RMS, pooled over outputs.

    Left out, the recipe's `size` holds.
    """
    parameters: Mapping[str, float] = field(default_factory=dict)
    """Shape parameters to hold; the others are drawn."""


@dataclass(frozen=True)
class Recipe:
    """Everything that decides a simulation; the same recipe gives the same bytes."""

    seed: int = 0
    train: tuple[str, ...] = ("chamber",) * 8
    """Kinds of the runs to train on, each in `stimuli.KINDS`."""
    test: tuple[str, ...] = ()
    """Kinds of the runs to test on; none = leave one run out."""
    dwell: bool = True
    """Whether an isothermal, unloaded, warmed-up dwell is logged too."""
    told: tuple[EffectChoice, ...] = (EffectChoice("zero_tempco"), EffectChoice("dark_current"))
    """Effects of the sensor that zerodrift.toml lists."""
    hidden: tuple[EffectChoice, ...] = ()
    """Effects and disturbances of the sensor that zerodrift.toml does not list."""
    size: float | None = None
    """Size of the hidden effects that state none.

    Left out too, a hidden effect that adds to the outputs gets size 2; one that changes what the
    elements feel (thermal lag, hysteresis, clock delay) acts in full on the paper's drift, a
    converter clips at drawn rails, and the size is what comes out.
    """
    sample_period_s: float = 1.0
    duration_s: float = 3600.0
    """Length of the kinds of run that have no length of their own."""
    noise: float = 1.0
    """Factor on the noise RMS of about one count of the 14-bit converter."""
    tare: str = "start"
    """start: each log is zeroed over its first ten seconds. none: zeros are the sensor's own."""
    channels: tuple[str, ...] = CHANNELS[:-1]
    """Channels that the logs hold; an effect whose channel is missing cannot be tested."""
    exercise: tuple[str, ...] = EXERCISES
    """What chamber runs move besides the temperature."""
    network: str = "none"
    """`[network] kind` in zerodrift.toml."""
    sensor_name: str = "ft40"
    finer: int = 1
    """Factor on the number of integration steps, to check that they are fine enough."""


def parse_choice(text: str) -> EffectChoice:
    """Return the choice that `NAME`, `NAME=SIZE`, `NAME=tau_s:60` or `NAME=2,tau_s:60` says.

    Raises:
        InputError: the text does not have that form.
    """
    name, _, details = text.partition("=")
    size: float | None = None
    parameters: dict[str, float] = {}
    for detail in details.split(",") if details else []:
        key, colon, value = detail.partition(":")
        try:
            if colon:
                parameters[key.strip()] = float(value)
            else:
                size = float(key)
        except ValueError:
            raise InputError(
                f"'{text}': '{detail}' is neither a size nor PARAMETER:VALUE. "
                "Write NAME, NAME=2.5, NAME=tau_s:60 or NAME=2.5,tau_s:60."
            ) from None
    return EffectChoice(name.strip(), size, parameters)


def _expect_known(what: str, found: Iterable[str], known: Iterable[str]) -> None:
    known = tuple(known)
    for name in found:
        if name not in known:
            raise InputError(
                f"twin: no {what} '{name}'{nearest(name, known) or '.'} Known: {', '.join(known)}."
            )


def check_choice(choice: EffectChoice, role: str) -> None:
    """Refuse an effect whose parameters or size are out of range.

    Raises:
        InputError: what was found and what was expected.
    """
    known = PARAMETERS.get(choice.name, {})
    for name, value in choice.parameters.items():
        if name not in known:
            listed = ", ".join(known) or "none"
            raise InputError(
                f"twin: {role} {choice.name} has no parameter '{name}'"
                f"{nearest(name, known) or '.'} "
                f"Its parameters: {listed}."
            )
        low, high = known[name]
        if not low <= value <= high:
            raise InputError(
                f"twin: {role} {choice.name}: {name} is {value:g}; expected {low:g} to {high:g}."
            )
    slow = ("slow_tau_s" in choice.parameters) + ("slow_share" in choice.parameters)
    if choice.name == "thermal_lag" and slow == 1:
        raise InputError(
            f"twin: {role} {choice.name}: slow_tau_s and slow_share belong together; give both."
        )
    if choice.name == "zero_tempco" and choice.parameters.get("order", 1.0) not in (1.0, 2.0, 3.0):
        raise InputError("twin: zero_tempco: order is 1, 2 or 3.")
    if choice.size is not None and not 0.0 < choice.size <= 1e4:
        raise InputError(
            f"twin: {role} {choice.name}: size is {choice.size:g}; expected above 0, up to 10000, "
            "in multiples of the noise RMS."
        )


def check_recipe(recipe: Recipe) -> None:
    """Refuse a recipe that cannot be simulated.

    Raises:
        InputError: an unknown name or a value out of range, with what was expected.
    """
    _expect_known("effect", (c.name for c in (*recipe.told, *recipe.hidden)), EFFECTS)
    _expect_known("effect to tell the model", (c.name for c in recipe.told), LISTED_EFFECTS)
    _expect_known("kind of run", (*recipe.train, *recipe.test), KINDS)
    _expect_known("channel", recipe.channels, CHANNELS)
    _expect_known("exercise", recipe.exercise, EXERCISES)
    _expect_known("tare", (recipe.tare,), TARES)
    _expect_known("kind of network", (recipe.network,), NETWORKS)
    for role, choices in (("told", recipe.told), ("hidden", recipe.hidden)):
        for choice in choices:
            check_choice(choice, role)
    names = [choice.name for choice in (*recipe.told, *recipe.hidden)]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"twin: '{name}' is asked for twice; an effect is either told or hidden, once."
            )
    if not recipe.train:
        raise InputError("twin: no run to train on; ask for one or more.")
    for what, value, low, high in (
        ("sample period in s", recipe.sample_period_s, 0.001, 60.0),
        ("duration in s", recipe.duration_s, 300.0, 1e6),
        ("noise factor", recipe.noise, 1e-3, 1e3),
        ("size", 1.0 if recipe.size is None else recipe.size, 1e-3, 1e4),
        ("finer", recipe.finer, 1, 64),
        ("seed", recipe.seed, 0, 2**63),
    ):
        if not low <= value <= high:
            raise InputError(f"twin: {what} is {value:g}; expected {low:g} to {high:g}.")


def expand_channels(names: Iterable[str]) -> tuple[str, ...]:
    """Return the channels of these names; `acceleration` stands for its three axes.

    Raises:
        InputError: a name is not a channel.
    """
    names = tuple(names)
    _expect_known("channel", names, (*CHANNELS, "acceleration"))
    return tuple(
        channel
        for channel in CHANNELS
        if channel in names or ("acceleration" in names and channel.startswith("acceleration_"))
    )


def draw_mystery(seed: int, count: int, taken: Iterable[EffectChoice]) -> tuple[EffectChoice, ...]:
    """Draw `count` hidden effects of the catalogue, or now and then one that it does not know."""
    rng = draw_stream(seed, "mystery")
    names = {choice.name for choice in taken}
    listed = [name for name in LISTED_EFFECTS if name not in names]
    unlisted = [name for name in UNLISTED_EFFECTS if name not in names]
    drawn: list[EffectChoice] = []
    for _ in range(count):
        pool = unlisted if rng.random() < 0.15 else listed
        name = pool.pop(int(rng.integers(len(pool))))
        drawn.append(EffectChoice(name, size=float(np.exp(rng.uniform(0.0, np.log(6.0))))))
    return tuple(drawn)


def recipe_to_dict(recipe: Recipe) -> dict[str, Any]:
    """Return the recipe as plain data for JSON."""
    plain = dataclasses.asdict(recipe)
    for role in ("told", "hidden"):
        plain[role] = [
            {key: value for key, value in choice.items() if value not in (None, {})}
            for choice in plain[role]
        ]
    return plain


def _read_choice(plain: object, where: str) -> EffectChoice:
    """Return the choice in plain data such as {"name": "creep", "parameters": {"tau_s": 300}}."""
    if isinstance(plain, dict) and isinstance(plain.get("name"), str):
        size, parameters = plain.get("size"), plain.get("parameters", {})
        known = set(plain) <= {"name", "size", "parameters"}
        sized = size is None or isinstance(size, int | float)
        stated = isinstance(parameters, dict) and all(
            isinstance(value, int | float) for value in parameters.values()
        )
        if known and sized and stated:
            return EffectChoice(plain["name"], size, parameters)
    raise InputError(
        f"{where} holds {plain!r}; expected tables of a name, a size (number) and parameters "
        "(numbers by name)."
    )


def recipe_from_dict(plain: Mapping[str, Any], where: str) -> Recipe:
    """Return the recipe in plain data read from JSON; `where` names the file in messages.

    Raises:
        InputError: an unknown key, or a value of the wrong type.
    """
    fields = {f.name: f for f in dataclasses.fields(Recipe)}
    values: dict[str, Any] = {}
    for key, value in plain.items():
        if key not in fields:
            raise InputError(f"{where}: unknown key '{key}'{nearest(key, fields)}")
        default = fields[key].default
        if key in ("told", "hidden"):
            values[key] = tuple(_read_choice(choice, f"{where}: '{key}'") for choice in value)
        elif isinstance(default, tuple) and isinstance(value, list):
            values[key] = tuple(value)
        elif isinstance(default, tuple) or (isinstance(default, str) != isinstance(value, str)):
            raise InputError(f"{where}: '{key}' is {value!r}; expected something like {default!r}.")
        else:
            values[key] = value
    recipe = Recipe(**values)
    check_recipe(recipe)
    return recipe
