"""Effects switched on in a specimen beyond its own physics: the twin's catalogue of disturbances.

Those that add to the outputs are turned into codes by the calibration matrix, so that the
converter's noise, steps and rails act on them as on everything else.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import InputError, nearest
from zerodrift_lab.twin.conditions import Conditions
from zerodrift_lab.twin.disturbances import DISTURBANCES, draw_coefficients
from zerodrift_lab.twin.elements import Elements
from zerodrift_lab.twin.heat import HeatHistory
from zerodrift_lab.twin.hysteresis import play
from zerodrift_lab.twin.integrate import relax
from zerodrift_lab.twin.recipe import EFFECTS, EffectChoice, check_choice
from zerodrift_lab.twin.six_axis.heat import NODE
from zerodrift_lab.twin.six_axis.optics import ADC_CODES, SIDE_A
from zerodrift_lab.twin.six_axis.specimen import Hidden, Sensor
from zerodrift_lab.twin.six_axis.timeline import Timeline
from zerodrift_lab.twin.strength import draw_parameters

Array = NDArray[np.float64]

DEFAULT_SIZE = 2.0
RAILS_PERCENT = (5.0, 7.0)
"""Where the rails are drawn: at about a fifth of full scale, as heavy as test weights are."""
COUPLERS = (NODE["couplers_a"], NODE["couplers_b"])


def _find(effects: Iterable[Hidden], name: str) -> Hidden | None:
    return next((hidden for hidden in effects if hidden.name == name), None)


def feel(effects: Sequence[Hidden], fine_nodes: Array, step_s: float, every: int) -> Array:
    """Return the temperatures [n, 13] that optics and structure follow at the logged instants.

    `fine_nodes` [fine n, 13] are the true ones. Lag, hysteresis and delay act on all of them.
    """
    felt = fine_nodes
    path = _find(effects, "heat_path")
    if path is not None:
        share = path.parameters["share"]
        felt = felt.copy()
        for column in COUPLERS:
            beams = fine_nodes[:, NODE["beams"]]
            felt[:, column] = (1.0 - share) * felt[:, column] + share * beams
    delay = _find(effects, "clock_delay")
    if delay is not None:
        time_s = np.arange(felt.shape[0]) * step_s
        moment_s = time_s - delay.parameters["delay_s"]
        felt = np.stack([np.interp(moment_s, time_s, column) for column in felt.T], axis=1)
    lag = _find(effects, "thermal_lag")
    if lag is not None:
        slow = lag.parameters.get("slow_share", 0.0)
        lagged = (1.0 - slow) * relax(felt, lag.parameters["tau_s"], step_s)
        if slow:
            lagged = lagged + slow * relax(felt, lag.parameters["slow_tau_s"], step_s)
        felt = lagged
    hysteresis = _find(effects, "thermal_hysteresis")
    if hysteresis is not None:
        half_width = hysteresis.parameters["half_width_K"]
        felt = np.stack([play(column, half_width) for column in felt.T], axis=1)
    return felt[::every]


def clip_codes(effects: Sequence[Hidden], codes: Array) -> Array:
    """Return the codes [n, 6] as an early converter stage with its own rails passes them."""
    saturation = _find(effects, "adc_saturation")
    if saturation is None:
        return codes
    half = ADC_CODES / 2
    reach = saturation.parameters["rail_pct"] / 100.0 * half
    return np.clip(codes, half - reach, half + reach)


def add_effects(
    sensor: Sensor,
    timeline: Timeline,
    key: str,
    fine_nodes: Array,
    felt: Array,
    every: int,
    period_s: float,
    clock_start_s: float,
) -> Array:
    """Return what the additive effects add to the codes [n, 6] of one run."""
    total = np.zeros((felt.shape[0], 6))
    if all(hidden.coefficients is None for hidden in sensor.effects):
        return total
    run, elements = describe_run(
        sensor, timeline, key, fine_nodes, felt, every, period_s, clock_start_s
    )
    for hidden in sensor.effects:
        total += contribute(hidden, run, elements)
    return sensor.to_codes(total)


def contribute(hidden: Hidden, run: Conditions, elements: Elements) -> Array:
    """Return what one effect adds to the outputs [n, 6]; nothing for one on temperatures."""
    if hidden.coefficients is None:
        return np.zeros((run.time_s.size, 6))
    columns = DISTURBANCES[hidden.name].columns(run, elements, hidden.parameters)
    added: Array = np.einsum("nkm,km->nk", columns, hidden.coefficients)
    return added


def describe_run(
    sensor: Sensor,
    timeline: Timeline,
    key: str,
    fine_nodes: Array,
    felt: Array,
    every: int,
    period_s: float,
    clock_start_s: float,
) -> tuple[Conditions, Elements]:
    """Return a run as the catalogue's disturbances want it; the couplers' mean is the element."""
    step_s = period_s / every
    chip, body = fine_nodes[:, NODE["board"]], fine_nodes[:, NODE["beams"]]
    heat = HeatHistory(
        body=body,
        chip=chip,
        chip_rate=np.gradient(chip, step_s),
        body_rate=np.gradient(body, step_s),
    )
    run = Conditions(
        name=key,
        use="train",
        seed=0 if sensor.seed is None else sensor.seed,
        stimulus=timeline.as_stimulus(),
        sample_period_s=period_s,
        fine_per_sample=every,
        clock_start_s=clock_start_s,
        heat=heat,
    )
    share = float(SIDE_A.mean())
    mean = share * felt[:, COUPLERS[0]] + (1.0 - share) * felt[:, COUPLERS[1]]
    return run, Elements(mean, np.gradient(mean, period_s))


def choose_hidden(sensor: Sensor, choice: EffectChoice) -> Hidden:
    """Return an effect drawn for a specimen, before it is scaled to its size.

    Raises:
        InputError: there is no such effect, or a parameter is out of range.
    """
    if choice.name not in EFFECTS:
        raise InputError(
            f"twin: no effect '{choice.name}'{nearest(choice.name, EFFECTS) or '.'} "
            f"Known: {', '.join(EFFECTS)}."
        )
    check_choice(choice, "hidden")
    seed = 0 if sensor.seed is None else sensor.seed
    parameters = draw_parameters(choice, seed)
    if choice.name not in DISTURBANCES:
        if choice.size is not None:
            raise InputError(
                f"twin: {choice.name} takes no size in the six-axis twin: it acts in full on what "
                "the sensor does by itself; leave the size out and state its parameter."
            )
        if choice.name == "adc_saturation" and "rail_pct" not in choice.parameters:
            rails = sensor.stream("rails")
            parameters["rail_pct"] = float(rails.uniform(*RAILS_PERCENT))
        return Hidden(choice.name, parameters, None)
    columns = int(parameters.get("order", len(DISTURBANCES[choice.name].terms)))
    coefficients = draw_coefficients(choice.name, seed, sensor.noise_rms, columns)
    return Hidden(choice.name, parameters, coefficients, choice.size or DEFAULT_SIZE)


def scale_hidden(hidden: Hidden, added: Array, noise_rms: Array) -> Hidden:
    """Return the effect with coefficients that give its size, from what it adds now [n, 6]."""
    if hidden.coefficients is None or hidden.size is None:
        return hidden
    centred = (added - added.mean(axis=0)) / noise_rms
    now = float(np.sqrt(np.mean(centred**2)))
    return replace(hidden, coefficients=hidden.coefficients * (hidden.size / now))
