"""Further thermometers: whether the drift that a model leaves follows one of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from zerodrift.base.config import Config, EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.dataset.units import read_unit
from zerodrift.diagnosis.changes import AddCommand, name_effect, propose_forms
from zerodrift.diagnosis.judgement import measure_overall
from zerodrift.diagnosis.revision import revise_best
from zerodrift.physics.catalogue import Catalogue

KIND = "zero_tempco"
"""The effect that is tried with each thermometer: of all that drifts with temperature the first."""


@dataclass(frozen=True)
class OtherThermometer:
    """An input that the drift follows, beside the chip's own thermometer."""

    signal: str
    """Its name in [inputs]."""
    rmse_left_out_ratio: float
    """RMSE on data held out, with `KIND` following it over that of the model as it is, geometric
    mean over the outputs."""
    reason: str
    """What it gains, in a sentence."""
    command: AddCommand
    """What adds it."""


def list_thermometers(config: Config) -> list[str]:
    """Return the inputs that are temperatures, by their name or by their column's unit."""
    return [
        name
        for name, column in config.inputs.items()
        if "temperature" in name or read_unit(column) in ("degC", "K")
    ]


def try_thermometers(
    config: Config, effects: Sequence[EffectConfig], dataset: Dataset, catalogue: Catalogue
) -> list[OtherThermometer]:
    """Return the thermometers that a zero shift follows with a held-out gain, the best first.

    Args:
        config: the project.
        effects: the model's effects, which need not be those of the file.
        dataset: its runs.
        catalogue: the known effects.
    """
    config = replace(config, effects=tuple(effects))
    present = {name_effect(effect) for effect in effects}
    found = []
    for signal in list_thermometers(config):
        wanted = EffectConfig(KIND, options={"signal": signal})
        if name_effect(wanted) in present or KIND not in catalogue:
            continue
        changes = propose_forms(config, dataset, catalogue, wanted)
        revision = revise_best(config, dataset, catalogue, changes)
        if revision.helps:
            command = AddCommand(KIND, ("--set", f"signal={signal}"))
            ratio = measure_overall(revision.before, revision.after)
            found.append(OtherThermometer(signal, ratio, revision.reason, command))
    return sorted(found, key=lambda one: one.rmse_left_out_ratio)
