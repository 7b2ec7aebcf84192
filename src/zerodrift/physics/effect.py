"""What an effect is, and where effects are declared: built-in, installed, a user's own."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Generic, Protocol, TypeVar

from zerodrift.base.errors import InputError, nearest
from zerodrift.operations.backend import Operations

# What an effect is: named parameters, the signals it needs, and its definition in operations.
#
# An effect is written once, against `Operations`, and is thereby simulated, fitted, explained,
# quantized and generated as C. Built-in effects and a user's own are declared alike.

S = TypeVar("S")

Arrivals = tuple[tuple[str, int], ...]
"""(run, +1 where it came to its first temperature from above, -1 from below); others: at rest."""

Values = Mapping[str, float]
"""Parameter name -> value, in the parameter's unit."""

FEWEST_RUNS = 4
"""Runs from which on whole runs are the evidence; fewer are cut into pieces."""


@dataclass(frozen=True)
class Parameter:
    """One number of an effect: fitted unless the user holds it, or a choice with a default.

    Example:
        >>> tau = Parameter("tau_s", "s", lower=1.0, upper=3000.0, typical=(10.0, 300.0))
        >>> tau.scale, tau.default
        ('log', None)
    """

    name: str
    """With its unit at the end: tau_s, half_width_K."""
    unit: str
    lower: float
    """The fit never goes below; at this bound the fit says so."""
    upper: float
    typical: tuple[float, float]
    """Range in which hardware is mostly found; the fit starts from here."""
    scale: str = "log"
    """log | linear: how the range is searched."""
    source: str = ""
    """Where the typical range comes from."""
    default: float | None = None
    """None: fitted. Else held at this value unless the user writes another."""
    choices: tuple[float, ...] = ()
    """Allowed values of a choice, such as the order of a polynomial; empty for a real number."""
    meaning: str = ""
    """One phrase for the catalogue."""
    is_setting: bool = False
    """Whether it says how the effect is computed, not what the sensor is: fitted like the others,
    but any value of it is as credible as any other."""
    when: Values = field(default_factory=dict)
    """The choices under which this parameter exists at all."""
    slack_in: str = ""
    """The signal that this is the half-width of a play of, `load` or `temperature`: a narrower one
    than the signal's noise smooths, and shows no hysteresis."""


@dataclass(frozen=True)
class Feature(Generic[S]):
    """One column of the linear model: drift_k = ... + A[j, k] * signal.

    Example:
        >>> Feature("T squared", [1.0, 4.0], "K2").unit
        'K2'
    """

    name: str
    signal: S
    unit: str = "1"
    """Unit of the signal; the coefficient has the output's unit per this."""
    output: str | None = None
    """The only output that sees this feature; None: all do."""


@dataclass(frozen=True)
class Signals(Generic[S]):
    """The signals that an effect may read, each [n]; all of them exist on the chip."""

    temperature_degC: S
    """The thermometer chosen by the effect's `signal`, after lag and hysteresis of the element."""
    elapsed_s: S
    """Time since power-on, the start of the run."""
    clock_s: S
    """Absolute time where there is a clock, else the time since power-on."""
    load: Mapping[str, S]
    """Output name -> true load; on the chip, the compensated load. Empty without references."""
    saturated: Mapping[str, S]
    """Output name -> 1 while its converter stands at a rail, else 0; for outputs that ever do."""
    channels: Mapping[str, S]
    """Other inputs by name: supply, humidity, ..."""
    outputs: tuple[str, ...]
    full_scale: Mapping[str, float]
    """Output name -> full scale in its unit."""
    reference_temperature_degC: float
    """T0, where zero shift is counted from."""
    arrivals: Callable[["Arrivals"], S] | None = None
    """In a fit: from where each run came to its first temperature -> `arrival_K`."""
    arrival_K: S | None = None
    """A spike at each run's first sample, up where the temperature came from above; zero after it.
    None: every run begins at rest, as the chip does."""


class Build(Protocol):
    """An effect's features, in the type that the operations calculate with."""

    def __call__(
        self, ops: Operations[S], signals: Signals[S], p: Values, /
    ) -> Sequence[Feature[S]]:
        """Return the columns that the effect adds."""
        ...


class Rewrite(Protocol):
    """An effect's change of the signals, in the type that the operations calculate with."""

    def __call__(self, ops: Operations[S], signals: Signals[S], p: Values, /) -> Signals[S]:
        """Return the signals that all effects see from now on."""
        ...


def add_nothing(ops: Operations[S], signals: Signals[S], p: Values) -> Sequence[Feature[S]]:
    """Return no features: the effect only changes what the others see."""
    return ()


@dataclass(frozen=True)
class Effect:
    """A physical effect: its definition, its parameters and what a user should know about it.

    Example:
        >>> def build(ops, signals, p):
        ...     return [Feature("T late", ops.lowpass(signals.temperature_degC, p["tau_s"]), "K")]
        >>> tau = Parameter("tau_s", "s", lower=1.0, upper=3000.0, typical=(10.0, 300.0))
        >>> Effect("late", "a late element", build, parameters=(tau,)).parameter("tau_s").unit
        's'
    """

    kind: str
    """The name in zerodrift.toml."""
    title: str
    """The field's term."""
    build: Build = add_nothing
    """(ops, signals, p) -> the features that the effect adds to the linear model."""
    rewrite: Rewrite | None = None
    """(ops, signals, p) -> the signals that all effects see from now on; None: leaves them."""
    tidy: Callable[[Values], Values] | None = None
    """values -> equal values as people write them, such as the slower time constant last."""
    sets_aside: bool = False
    """Whether samples at a converter's rail are set aside, since they do not show the drift."""
    parameters: tuple[Parameter, ...] = ()
    needs: tuple[str, ...] = ()
    """temperature, load, saturated, elapsed, clock or inputs' names; `a|b` asks for one of them."""
    physics: str = ""
    """A paragraph: what happens in the hardware."""
    equation: str = ""
    fingerprint: str = ""
    """What it looks like in the residual."""
    provoke: str = ""
    """The experiment that shows it best."""
    cure: str = ""
    """What to do about it in hardware."""
    source: str = ""
    variants: tuple[Values, ...] = ({},)
    """Choices that the diagnosis tries, simplest first; the first one is the default."""
    run_variants: tuple[Values, ...] = ()
    """More of them, tried at once where there are FEWEST_RUNS runs or more, and with fewer as
    upgrades: pieces of one run do not tell them from the plain ones."""
    upgrades: tuple[Values, ...] = ()
    """Richer choices, tried where the plain ones explain too little, or once the effect is in the
    model."""
    file: str = ""
    """The user's file it was declared in; empty for a built-in."""

    @property
    def forms(self) -> tuple[Values, ...]:
        """All choices that the catalogue lists, simplest first."""
        return (*self.variants, *self.run_variants, *self.upgrades)

    def list_plain(self, runs: int) -> tuple[Values, ...]:
        """Return the choices that are tried at once on so many runs, simplest first."""
        return (*self.variants, *self.run_variants) if runs >= FEWEST_RUNS else self.variants

    def list_richer(self, runs: int) -> tuple[Values, ...]:
        """Return the other choices."""
        return self.forms[len(self.list_plain(runs)) :]

    def parameter(self, name: str) -> Parameter:
        """Return the parameter `name`.

        Raises:
            InputError: there is none.
        """
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        known = [parameter.name for parameter in self.parameters]
        raise InputError(
            f"effect '{self.kind}' has no parameter '{name}'{nearest(name, known) or '.'} "
            f"It has: {', '.join(known) or 'none'}."
        )

    @property
    def remembers_temperature(self) -> bool:
        """Whether what a run begins with depends on temperatures before it, for ever."""
        return any(parameter.slack_in == "temperature" for parameter in self.parameters)

    @property
    def is_thermal(self) -> bool:
        """Whether it sees a thermometer, so that `signal = "..."` may choose another one."""
        return "temperature" in self.needs


# Where effects are declared: built-ins, installed packages and users' files call `register`.

READING_ORDER = (
    *("zero_tempco", "dark_current", "span_tempco", "thermal_lag", "thermal_gradient", "warm_up"),
    *("thermal_hysteresis", "creep", "load_hysteresis", "load_nonlinearity", "crosstalk"),
    *("supply_sensitivity", "excitation_heating", "humidity", "ambient_light"),
    *("barometric_pressure", "inertial_load", "turn_on_bias", "ageing"),
    *("clock_delay", "adc_saturation"),
)
"""The order of the catalogue for readers; that of the modules is the order of acting."""


@dataclass(frozen=True)
class Catalogue(Mapping[str, Effect]):
    """Effects by name, in the order in which rewriting effects act on the signals."""

    effects: Mapping[str, Effect] = field(default_factory=dict)

    def __getitem__(self, kind: str) -> Effect:
        if kind not in self.effects:
            raise InputError(
                f"no effect '{kind}'{nearest(kind, self.effects) or '.'} "
                f"The catalogue has: {', '.join(self.effects)}."
            )
        return self.effects[kind]

    def __iter__(self) -> Iterator[str]:
        return iter(self.effects)

    def __len__(self) -> int:
        return len(self.effects)

    def __contains__(self, kind: object) -> bool:
        return kind in self.effects

    def listed(self) -> list[Effect]:
        """Return the effects in the order in which people look for them, a user's own last."""
        known = [self.effects[kind] for kind in READING_ORDER if kind in self.effects]
        return known + [e for kind, e in self.effects.items() if kind not in READING_ORDER]


registered: dict[str, Effect] = {}
"""Built-in effects and those of installed packages."""
_declaring: list[tuple[str, dict[str, Effect]]] = []
"""The file being loaded and where its effects go, innermost last."""


def register(effect: Effect) -> Effect:
    """Make an effect known; built-ins and users' files call the same function.

    Raises:
        InputError: the name is taken by another declaration, or the declaration is not usable.

    Example:
        >>> register(Effect("no name", "its kind is no plain name"))
        Traceback (most recent call last):
        zerodrift.base.errors.InputError: ...
    """
    where, known = _declaring[-1] if _declaring else (_find_origin(effect), registered)
    effect = replace(effect, file=where)
    _check_declaration(effect)
    other = known.get(effect.kind)
    if other is not None and other.file != where:
        raise InputError(
            f"{where or 'built-in'}: effect '{effect.kind}' is already declared in "
            f"{other.file or 'the built-in catalogue'}; give it another name."
        )
    known[effect.kind] = effect
    return effect


def _find_origin(effect: Effect) -> str:
    """Return where an effect outside of a user's file stands: a module; empty for a built-in."""
    module = (effect.rewrite or effect.build).__module__
    return "" if module.partition(".")[0] == "zerodrift" else f"module {module}"


@contextmanager
def declare(where: str, known: dict[str, Effect]) -> Iterator[None]:
    """Within this context, `register` adds effects to `known`, noting where they stand."""
    _declaring.append((where, known))
    try:
        yield
    finally:
        _declaring.pop()


def _check_declaration(effect: Effect) -> None:
    """Refuse a declaration that could not be fitted, saying why."""
    where = f"{effect.file or 'built-in'}: effect '{effect.kind}'"
    if not effect.kind.isidentifier():
        raise InputError(f"{where}: the kind must be a plain name such as 'led_ageing'.")
    for parameter in effect.parameters:
        low, high = parameter.typical
        if not parameter.lower <= low <= high <= parameter.upper:
            raise InputError(
                f"{where}: parameter '{parameter.name}' has bounds {parameter.lower:g} .. "
                f"{parameter.upper:g} and typical range {low:g} .. {high:g}; "
                "expected lower <= typical <= upper."
            )
        if parameter.scale not in ("log", "linear"):
            raise InputError(
                f"{where}: parameter '{parameter.name}' has scale '{parameter.scale}'; "
                "expected log or linear."
            )
        if parameter.scale == "log" and parameter.lower <= 0 and not parameter.choices:
            raise InputError(
                f"{where}: parameter '{parameter.name}' is searched on a log scale, so its lower "
                f"bound must be above 0; it is {parameter.lower:g}."
            )
    for variant in effect.forms:
        for name in variant:
            effect.parameter(name)
