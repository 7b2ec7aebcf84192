"""One sensor with something hidden: drawn at random, scaled to a size, measured with noise."""

from dataclasses import dataclass

import numpy as np

from benchmarks.foreign import effects as fx
from benchmarks.foreign import world
from benchmarks.foreign.world import Array, Rng, Run

PERIODS_S = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
UNITS = ("N", "Nm", "ppm", "g", "V", "mV/V")
LSB_DEGC = 0.0078125
Gains = dict[str, Array]
"""The coefficient of each column of each effect, for one output."""


@dataclass(frozen=True)
class Recipe:
    """What a case is drawn for.

    `kind` is effect, pair, complete, disturbance or missing_channel; `size` is the least RMS of
    what is hidden beyond what a refit of the told model absorbs, over the RMS of the noise.
    """

    kind: str
    hidden: tuple[str, ...]
    size: float
    runs: int
    seed: int


@dataclass
class Case:
    """Logs and their truth; the dwell is the last of `runs` and of `measured` [n, K] each."""

    recipe: Recipe
    told: fx.Model
    truth: fx.Model
    runs: list[Run]
    period_s: float
    full_scale: Array
    noise_rms: Array
    tared: bool
    units: list[str]
    sizes: dict[str, float]
    measured: list[Array]

    def drift(self, runs: list[Run], model: fx.Model, k: int, gains: Gains) -> Array:
        """Drift of output k over the logged samples of some runs [N]."""
        parts = []
        for run in runs:
            terms = fx.columns(run, model, k, self.full_scale[k])
            made = [block @ gains[name][: block.shape[1]] for name, block in terms.items()]
            parts.append(run.logged(np.sum([np.zeros(len(run.time_s)), *made], axis=0)))
        return np.concatenate(parts)

    def size(self, name: str, k: int, gains: Gains) -> float:
        """RMS of an effect on output k beyond all that a refit without it imitates, over noise.

        A refit moves coefficients, offsets (each run's own if tared) and nonlinear values.
        """
        runs, without = self.runs[:-1], {n: v for n, v in self.truth.items() if n != name}
        without |= {name: self.told[name]} if name in self.told else {}
        base, blocks = self.drift(runs, without, k, gains), []
        for index, run in enumerate(runs):
            terms = fx.columns(run, without, k, self.full_scale[k])
            offset = np.eye(len(runs))[index] if self.tared else np.ones(1)
            offsets = np.broadcast_to(offset, (len(run.time_s), len(offset)))
            blocks.append(run.logged(np.column_stack([*terms.values(), offsets])))
        space = [np.concatenate(blocks)]
        for other, values in without.items():
            for key in set(values) - {"order"}:
                moved = {**without, other: {**values, key: values[key] * 1.02}}
                space.append((self.drift(runs, moved, k, gains) - base)[:, None])
        basis = np.concatenate(space, axis=1)
        basis /= np.maximum(np.linalg.norm(basis, axis=0), 1e-300)
        effect = self.drift(runs, self.truth, k, gains) - base
        rest = effect - basis @ np.linalg.lstsq(basis, effect, rcond=1e-9)[0]
        rms = float(np.sqrt(np.mean(rest**2)))
        return rms / self.noise_rms[k] if rms > 1e-6 * np.ptp(base + effect) else 0.0

    def draw_gains(self, rng: Rng, k: int) -> Gains:
        """Draw coefficients of output k; what is hidden gets its size where it shows at all."""
        gains = {}
        for name, block in fx.columns(self.runs[0], self.truth, k, self.full_scale[k]).items():
            spread = max(float(np.std(block)), 1e-6 * float(np.abs(block).max()), 1e-300)
            signed = rng.uniform(0.3, 1, block.shape[1]) * rng.choice([-1, 1], block.shape[1])
            large = self.noise_rms[k] * 10 ** rng.uniform(0.7, 2) * bool(block.any())
            gains[name] = signed / spread * large
        for name in sorted(self.recipe.hidden, key=lambda name: name in fx.BENDING):
            now = self.size(name, k, gains) if name != "adc_saturation" else 0
            wanted = self.recipe.size * rng.uniform(1, 1.4)
            for other in fx.THERMAL if name in fx.BENDING else (name,):
                if now and other in gains:
                    gains[other] = gains[other] * (wanted / now)
        return gains

    def unpredictable(self, k: int, gains: Gains) -> float:
        """RMS of the drift that the log hides from any model: sampling, rounding, history."""
        steady = {n: values for n, values in self.truth.items() if n != "thermal_gradient"}
        seen = [run.as_logged(LSB_DEGC) for run in self.runs[:-1]]
        change = self.drift(seen, steady, k, gains) - self.drift(self.runs[:-1], steady, k, gains)
        square = float(np.mean(change**2))
        if "thermal_gradient" in self.truth:
            least = np.inf
            for w in (1, 2, 5, 12, 25):
                errors = []
                for run, log in zip(self.runs, seen, strict=False):
                    true, told = (fx.element_temperature(r, self.truth) for r in (run, log))
                    rise = (told[2 * w :] - told[: -2 * w]) / (2 * w * self.period_s)
                    errors.append(rise - run.logged(np.gradient(true, run.time_s))[w:-w])
                least = min(least, float(np.mean(np.concatenate(errors) ** 2)))
            square += float(gains["thermal_gradient"][0]) ** 2 * least
        return float(np.sqrt(square))


def draw(recipe: Recipe) -> Case:
    """Draw a case; one beyond reason (too large for the range, or not excited) is drawn again."""
    for attempt in range(100):
        case = _attempt(np.random.default_rng([recipe.seed, attempt]), recipe)
        if case is not None:
            return case
    raise RuntimeError(f"no sensible case for {recipe}")


def _attempt(rng: Rng, recipe: Recipe) -> Case | None:
    names = set(recipe.hidden)
    outputs = max(int(rng.choice([1, 3, 6], p=[0.4, 0.35, 0.25])), 3 * ("crosstalk" in names))
    period = float(rng.choice(PERIODS_S[:5] if "clock_delay" in names else PERIODS_S))
    counts = np.round(rng.uniform(500, 1500, recipe.runs))
    full_scale = 10.0 ** rng.uniform(-1, 5, outputs)
    noise_rms = full_scale * 10 ** rng.uniform(-4.5, -3, outputs)
    tared = bool(rng.uniform() < 0.4) and "ageing" not in names
    told, truth = _models(rng, recipe, period, float(counts.mean()) * period, tared)
    forced = bool({*told, *truth} & fx.LOADED) or rng.uniform() < 0.5
    loaded = rng.permutation(outputs)[: int(rng.integers(1, outputs + 1)) * forced].tolist()
    runs = _runs(rng, recipe, counts, period, full_scale, loaded)
    units = [str(unit) for unit in rng.choice(UNITS, outputs)]
    case = Case(
        recipe, told, truth, runs, period, full_scale, noise_rms, tared, units, {}, []
    )  # fmt: skip
    gains = [case.draw_gains(rng, k) for k in range(outputs)]
    drifts = [
        np.stack([case.drift([run], truth, k, g) for k, g in enumerate(gains)], 1) for run in runs
    ]
    drifts[-1][:] = drifts[-1][-1]
    hidden_by_chip = [case.unpredictable(k, g) for k, g in enumerate(gains)] / noise_rms
    if np.any(np.ptp(np.concatenate(drifts), 0) > 0.8 * full_scale) or hidden_by_chip.max() > 0.3:
        return None
    _measure(rng, case, drifts)
    for name in names - {"adc_saturation"}:
        shown = [size for size in (case.size(name, k, g) for k, g in enumerate(gains)) if size]
        case.sizes[name] = float(np.sqrt(np.mean(np.square(shown)))) if shown else 0.0
    reached = [recipe.size <= size <= 20 * recipe.size for size in case.sizes.values()]
    return case if all(reached) else None


def _models(
    rng: Rng, recipe: Recipe, period: float, length: float, tared: bool
) -> tuple[fx.Model, fx.Model]:
    """The told model and the truth, each with its nonlinear values."""
    names = set(recipe.hidden)
    base = ["zero_tempco"] + ["dark_current"] * bool(rng.uniform() < 0.3)
    if rng.uniform() < 0.25 and not names & {"clock_delay", "thermal_lag"}:
        base.append("thermal_lag")
    if recipe.kind == "complete":
        more = ["span_tempco", "creep", "crosstalk", "thermal_gradient", "supply_sensitivity",
                "humidity", "thermal_hysteresis", *["warm_up"] * (not tared)]  # fmt: skip
        base += rng.permutation(more).tolist()[: int(rng.integers(0, 3))]
    if "zero_tempco" in names:
        base = [[], ["dark_current"], ["zero_tempco"]][int(rng.integers(3))]
    kept = [name for name in base if name not in names or name == "zero_tempco"]
    if names & {*fx.BENDING} and not {*kept} & {*fx.THERMAL}:
        kept.append("zero_tempco")
    told = {name: fx.draw_parameters(rng, name, period, length) for name in kept}
    if {"dark_current", "zero_tempco"} & names and "zero_tempco" in told:
        told["zero_tempco"] = {"order": 1.0}
    truth = told | {n: fx.draw_parameters(rng, n, period, length) for n in recipe.hidden}
    if "zero_tempco" in names & {*told}:
        truth["zero_tempco"] = {"order": float(rng.integers(2, 4))}
    return told, truth


def _runs(
    rng: Rng, recipe: Recipe, counts: Array, period: float, full_scale: Array, loaded: list[int]
) -> list[Run]:
    """The runs' courses, and last a dwell's."""
    shape, middle = str(rng.choice([*world.TEMPERATURES, "mixed", "mixed"])), rng.uniform(0, 40)
    reach = min(rng.uniform(10, 35), 0.05 * float(counts.min()) * period)
    starts = 86400 * np.cumsum(rng.exponential(3, recipe.runs) + 0.1)
    runs = []
    for index, count in enumerate(counts.tolist()):
        kind = str(rng.choice(world.TEMPERATURES)) if shape == "mixed" else shape
        history = round(count * rng.uniform(0, 0.3) * (rng.uniform() < 0.25))
        time = np.arange(-history * world.OVERSAMPLING, count * world.OVERSAMPLING) * period
        time = time / world.OVERSAMPLING
        share = np.maximum(time, 0) / time[-1]
        loads = np.zeros((len(time), len(full_scale)))
        for k in loaded:
            course = world.load(rng, str(rng.choice(world.LOADS)), share)
            loads[:, k] = course * full_scale[k] * rng.uniform(0.3, 0.9)
        channels = world.channels(rng, share)
        heat = world.temperature(rng, kind, len(time), middle - reach, middle + reach)
        for name in {*recipe.hidden} & {*fx.DISTURBANCES}:
            length = float(counts.mean()) * period
            channels["disturbance"] = fx.disturbance(rng, name, time, heat, length, reach)
        runs.append(Run(f"r{index:02d}_{kind}", time, heat, loads, channels, starts[index]))
    still = np.arange(0, 2000 * world.OVERSAMPLING) * period / world.OVERSAMPLING
    rest = {name: np.full(len(still), course[0]) for name, course in runs[0].channels.items()}
    bare = np.zeros((len(still), len(full_scale)))
    return [*runs, Run("rest", still, np.full(len(still), middle), bare, rest, 0.0)]


def _measure(rng: Rng, case: Case, drifts: list[Array]) -> None:
    """Log the outputs: zero, noise, outliers, rails, quantisation, tare."""
    noise_rms, outputs = case.noise_rms, len(case.noise_rms)
    kind, memory = str(rng.choice(["white", "pink", "ar"])), rng.uniform(3, 40)
    step, spikes = noise_rms * rng.choice([0.05, 0.3, 1]), rng.choice([0, 0, 0, 0, 3e-4])
    zero = case.full_scale * rng.uniform(-0.1, 0.1, outputs)
    for run, drift in zip(case.runs, drifts, strict=True):
        clean = run.logged(run.loads) + drift
        rough = np.stack([world.noise(rng, kind, len(clean), memory) for _ in range(outputs)], 1)
        hit = rng.uniform(size=clean.shape) < spikes
        rough += hit * rng.choice([-1, 1], clean.shape) * rng.uniform(8, 25, clean.shape)
        case.measured.append(clean + zero + rough * noise_rms)
    if "adc_saturation" in case.truth:
        together = np.concatenate(case.measured[:-1])
        rail = np.quantile(together, 1 - rng.uniform(0.03, 0.1), axis=0)
        lost = np.maximum(together - rail, 0) / noise_rms
        case.sizes["adc_saturation"] = float(np.sqrt(np.mean(lost**2)))
        case.measured = [np.minimum(values, rail) for values in case.measured]
    case.measured = [np.round(values / step) * step for values in case.measured]
    if case.tared:
        logs = case.measured[:-1]
        case.measured[:-1] = [values - np.mean(values[:5], axis=0) for values in logs]
