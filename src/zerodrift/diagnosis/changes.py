"""Changes of a model's effects, checked before anything is fitted or written."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from zerodrift.base.config import Config, EffectConfig
from zerodrift.base.errors import InputError, nearest
from zerodrift.dataset.runs import Dataset
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.effect import Effect, Values
from zerodrift.physics.signals import explain_missing, plan_signals
from zerodrift.physics.terms import CHIP, start_term

ADD, CHANGE, REMOVE = "add", "change", "remove"


@dataclass(frozen=True)
class Change:
    """One effect more, or less, or with other parameters held."""

    action: str
    """add | change | remove."""
    effect: EffectConfig
    """As it is after the change; for a removal, as it was."""
    effects: tuple[EffectConfig, ...]
    """All effects of the model after the change."""
    place: int
    """Position of the effect among those of zerodrift.toml; for an addition, past the last."""
    is_richer: bool = False
    """Whether it adds an effect in a form that is asked for only where no plain one helps."""


def name_effect(effect: EffectConfig) -> str:
    """Return the effect's kind, with its thermometer where it is not the chip's."""
    signal = effect.options.get("signal", CHIP)
    return f"{effect.kind}[{signal}]" if signal else effect.kind


@dataclass(frozen=True)
class AddCommand:
    """The command that adds an effect."""

    kind: str
    options: tuple[str, ...]

    def write(self, directory: Path = Path()) -> str:
        """Return it as a shell takes it.

        Args:
            directory: of the project, as the user gave it.
        """
        words = shlex.join(("zerodrift", "add", self.kind, *self.options))
        return f"{words}{name_directory(directory)}"


def name_directory(directory: Path) -> str:
    """Return the option that names the project, as a shell takes it."""
    return "" if directory == Path() else f" -C {shlex.quote(str(directory))}"


def propose_command(
    effects: Sequence[EffectConfig], effect: Effect, parameters: Mapping[str, float]
) -> AddCommand:
    """Return the command that adds an effect in the form that was found, or makes it richer.

    Args:
        effects: the model's `[[effect]]` tables.
        effect: what is missing.
        parameters: its values as found; choices among them are held, fitted values are not.
    """
    present = next((e for e in effects if name_effect(e) == effect.kind), None)
    held = {
        p.name: parameters[p.name] for p in effect.parameters if p.choices and p.name in parameters
    }
    if present is not None:
        held = {name: value for name, value in held.items() if present.held.get(name) != value}
    holds = (("--hold", f"{name}={value:g}") for name, value in held.items())
    return AddCommand(effect.kind, tuple(word for pair in holds for word in pair))


def propose_addition(
    config: Config, dataset: Dataset, catalogue: Catalogue, effect: EffectConfig
) -> Change:
    """Return the change that adds an effect, or that holds other values in one that is there.

    Raises:
        InputError: the effect is unknown, is there already as it is asked for, needs a signal that
            the logs lack, or cannot have the values or options given.
    """
    names = [name_effect(present) for present in config.effects]
    place = len(names)
    action = ADD
    if name_effect(effect) in names:
        place = names.index(name_effect(effect))
        present = config.effects[place]
        if all(present.held.get(name) == value for name, value in effect.held.items()):
            raise InputError(
                f"{config.path}:{present.line}: effect '{names[place]}' is in the model already; "
                "expected one that is not, or --hold with another value. `zerodrift diagnose` "
                "names what is still missing."
            )
        action, effect = CHANGE, replace(present, held={**present.held, **effect.held})
    term = start_term(catalogue, replace(effect, line=0))
    plan = plan_signals(dataset.train, dataset.outputs, dataset.full_scale)
    missing = explain_missing(term.effect, plan, term.signal)
    if missing:
        needs = ", ".join(need.replace("|", " or ") for need in term.effect.needs)
        raise InputError(
            f"{config.path}: effect '{effect.kind}' cannot be added: {missing}. It needs {needs}; "
            "log the channel and name its column in [inputs], or the true load as a reference in "
            "[outputs]."
        )
    effects = (*config.effects[:place], effect, *config.effects[place + 1 :])
    return Change(action, effect, effects, place)


def propose_forms(
    config: Config, dataset: Dataset, catalogue: Catalogue, effect: EffectConfig
) -> tuple[Change, ...]:
    """Return the changes that `add` chooses from, simplest first.

    These are the forms that the catalogue lists for an effect, the richer ones last and marked, or
    for one that is there already its richer ones. A user who holds a value has chosen.

    Raises:
        InputError: as `propose_addition`; an effect that is there already has no richer form.
    """
    if effect.held or effect.kind not in catalogue:
        return (propose_addition(config, dataset, catalogue, effect),)
    declared = catalogue[effect.kind]
    names = [name_effect(present) for present in config.effects]
    if name_effect(effect) not in names:
        runs = len({run.group for run in dataset.train})
        plain_forms = declared.list_plain(runs)
        plain, richer = (
            _list_forms(declared, f) for f in (plain_forms, declared.list_richer(runs))
        )
        return tuple(
            replace(
                propose_addition(config, dataset, catalogue, replace(effect, held=form)),
                is_richer=i >= len(plain),
            )
            for i, form in enumerate((*plain, *richer))
        )
    present = config.effects[names.index(name_effect(effect))]
    values = start_term(catalogue, replace(present, line=0)).values
    forms_known = declared.forms
    fitting = [
        i
        for i, form in enumerate(forms_known)
        if all(values[name] == value for name, value in form.items())
    ]
    # Without a richer form the refusal below says that the effect is there.
    forms = [dict(form) for form in forms_known[fitting[-1] + 1 :] if fitting] or [{}]
    return tuple(
        propose_addition(config, dataset, catalogue, replace(effect, held=form)) for form in forms
    )


def _list_forms(effect: Effect, forms: Sequence[Values]) -> list[dict[str, float]]:
    """Return what is held in each of some forms of an effect, without what is its default."""
    defaults = {p.name: p.default for p in effect.parameters}
    return [
        {name: value for name, value in form.items() if value != defaults[name]} for form in forms
    ]


def propose_removal(config: Config, kind: str, signal: str = CHIP) -> Change:
    """Return the change that removes an effect.

    Args:
        config: the project.
        kind: the effect's name, also as `kind[signal]`.
        signal: its thermometer, where the same kind stands there for several.

    Raises:
        InputError: the model has no such effect, or several.
    """
    names = [name_effect(effect) for effect in config.effects]
    wanted = f"{kind}[{signal}]" if signal else kind
    places = [i for i, name in enumerate(names) if name == wanted]
    if not places and not signal:
        places = [i for i, effect in enumerate(config.effects) if effect.kind == kind]
    if not places:
        raise InputError(
            f"{config.path}: effect '{wanted}' is not in the model{nearest(wanted, names) or '.'} "
            f"It has: {', '.join(names) or 'no effect'}."
        )
    if len(places) > 1:
        raise InputError(
            f"{config.path}: effect '{kind}' is in the model for several thermometers; name one of "
            f"{', '.join(names[i] for i in places)}."
        )
    place = places[0]
    left = (*config.effects[:place], *config.effects[place + 1 :])
    return Change(REMOVE, config.effects[place], left, place)


def extend_model(
    effects: Sequence[EffectConfig],
    catalogue: Catalogue,
    kind: str,
    parameters: Mapping[str, float],
) -> tuple[EffectConfig, ...]:
    """Return the tables with an effect added, or its richer form put in place.

    Args:
        effects: the `[[effect]]` tables.
        catalogue: the known effects.
        kind: the effect's name.
        parameters: its values as found; choices among them are held, fitted values are not.
    """
    choices = {
        p.name: parameters[p.name]
        for p in catalogue[kind].parameters
        if p.choices and p.name in parameters
    }
    changed = [
        replace(config, held={**config.held, **choices}) if config.kind == kind else config
        for config in effects
    ]
    if any(config.kind == kind for config in effects):
        return tuple(changed)
    return (*changed, EffectConfig(kind, choices))


def list_extensions(
    effects: Sequence[EffectConfig],
    catalogue: Catalogue,
    kind: str,
    parameters: Mapping[str, float],
    runs: int = 1,
) -> tuple[tuple[EffectConfig, ...], ...]:
    """Return the models that `add` chooses from if it is asked for what was found, simplest first.

    One where choices are held, or where an effect becomes richer; else one for each form that the
    catalogue lists for so many runs. Other arguments as of `extend_model`.
    """
    found = extend_model(effects, catalogue, kind, parameters)
    if found[-1].held or len(found) == len(effects):
        return (found,)
    forms = _list_forms(catalogue[kind], catalogue[kind].list_plain(runs)) or [{}]
    return tuple((*effects, EffectConfig(kind, form)) for form in forms)
