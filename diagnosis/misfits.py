"""Compares each run with a fit of the others: another unit, sign, column or sensor.

The fit is linear in a basis that most drifts lie in (powers of the temperature, its lags and rate,
start-up, loads, inputs), so that an effect that the model lacks is no misfit. A run that spoils the
fit of the others is found by leaving each run out: without it the others agree.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.data_notes import DataNote
from zerodrift.operations.recursion import filter_recursively

Array = NDArray[np.float64]

BLOCKS = 240
"""Averages of a run that are fitted."""
FEWEST_ROWS = 50
"""Shorter runs are not looked at."""
FEWEST_RUNS = 3
"""With two runs either may be wrong."""
LAGS_S = (30.0, 120.0, 480.0)
RIDGE = 1e-4
"""Share of each column's square that holds its coefficient back."""
MISFIT = 2.0
"""A run is looked at if its error is this many times that of the others, ..."""
AGREE = 0.8
"""... and these agree better without it: their error falls below this share, ..."""
EXPLAINED = 0.35
"""... and it is told what is wrong if that takes its error below this share, ..."""
ORDINARY = 1.8
"""... and to this many times the others' error; ..."""
CLEAR = 0.1
"""... where it takes the error below this share, a run of a kind of its own may be left more, as
little as another sensor's would not be."""
CLEARLY = 0.5
"""Of two readings of a run one is right if it leaves less than this share of the other's error."""
OTHER, OF_DRIFT = 4.0, 0.2
"""Without any such explanation it is another sensor's from so many times the largest misfit of the
other runs on, each held against the rest, in most of the outputs, if that is this share of the
run's own drift too: compensated by the others' model a fifth of it would be left."""
FAR = 1.0
"""Rows whose signals lie this many times further out than any of the other runs' are not judged."""
WRONG_GAIN = 0.15
"""A gain is wrong if it is off by more than this share, ..."""
SURE_GAIN = 0.3
"""... where the run's course tells it to this share."""
FOLLOWS, WRONG_SLOPE = 0.9, 0.3
"""A column that follows the load to this share has a wrong gain if it is off by this much."""
ENOUGH, SOME = 0.4, 0.1
"""Share of a run's rows that must lie among the others' once it is read another way."""
OF_COURSE = 0.12
"""With few runs an error of this share of the run's own drift is ordinary too."""
MANY_WILD = 0.05
"""A run of which a larger share of the rows would be weighted is taken as it was measured."""
FAMILIAR_GAINS = (1000.0, 100.0, 10.0, 2.0, 9.80665, 4.44822)
RATE = 12.0
"""A run's time is in another unit if its temperature moves this many times faster or slower."""
KELVIN, FAHRENHEIT = 273.15, 1.8


@dataclass(frozen=True)
class _Course:
    """A run's block means: what the basis is made of, and what the outputs read."""

    run: Run
    temperature: Array
    """[n] at the full rate, as read now."""
    inputs: Mapping[str, Array]
    measured: Array
    reference: Array

    @property
    def drift(self) -> Array:
        return self.measured - self.reference


def _read(run: Run) -> _Course:
    wild = float((run.weights < 1.0).any(axis=1).mean())
    # What is wild all over is no outlier: a fast load in another column's place is.
    measured = run.measured if wild > MANY_WILD else run.reference + run.steady_drift
    return _Course(run, run.temperature_degC, dict(run.inputs), measured, run.reference)


def _average(x: Array, blocks: int) -> Array:
    edges = np.linspace(0, x.shape[0], blocks + 1).astype(int)
    return np.asarray(np.add.reduceat(x, edges[:-1], axis=0) / np.diff(edges)[:, None])


def _build(course: _Course, scales: Array) -> tuple[Array, Array, Array]:
    """Return basis [b, J], measured [b, K] and reference [b, K] of a run, its means taken off."""
    run = course.run
    step_s = run.sample_period_s
    warm = (course.temperature - 25.0) / 30.0
    elapsed = np.arange(len(run)) * step_s
    columns = [warm, warm**2, warm**3, 2.0 ** (3.0 * np.clip(warm, -5.0, 5.0))]
    for tau_s in LAGS_S:
        share = -np.expm1(-step_s / tau_s)
        state = np.array([(1.0 - share) * warm[0]])
        lagged = filter_recursively([share], [1.0, share - 1.0], warm, state)
        columns += [lagged, np.exp(-elapsed / (4.0 * tau_s))]
    load = course.reference / scales
    columns += [*load.T, *(load * warm[:, None]).T, *(load**2).T]
    columns += [course.inputs[name] for name in sorted(course.inputs)]
    blocks = min(BLOCKS, len(run))
    table = np.stack(columns, axis=1)
    design = _average(table, blocks)
    return (
        design - design.mean(axis=0),
        _average(course.measured, blocks),
        _average(course.reference, blocks),
    )


@dataclass(frozen=True)
class _Fit:
    """The fit of all runs but some."""

    factors: Array
    """[J, K]."""
    inverse: Array
    """[J, J] of the normal matrix."""
    left: Array
    """[K] RMS that it leaves of the runs it was made of."""
    reach: float
    """Largest leverage of a row of these runs."""
    low_degC: float
    high_degC: float
    """What these runs' temperatures cover."""

    def find_inside(self, design: Array, temperature_degC: Array) -> NDArray[np.bool_]:
        """Return the rows [b] whose signals are like those of the fit.

        Beyond its temperatures a drift that bends goes anywhere, whatever a row's leverage.
        """
        near = _measure_leverage(design, self.inverse) <= FAR * self.reach
        covered = (temperature_degC >= self.low_degC) & (temperature_degC <= self.high_degC)
        return np.asarray(near & covered)


def _measure_leverage(design: Array, inverse: Array) -> Array:
    return np.asarray(np.einsum("bi,ij,bj->b", design, inverse, design))


def _fit(
    designs: Sequence[Array], drifts: Sequence[Array], temperatures_degC: Sequence[Array]
) -> _Fit:
    x, y = np.concatenate(designs), np.concatenate([d - d.mean(axis=0) for d in drifts])
    size = np.sqrt(np.mean(x**2, axis=0))
    size[size == 0.0] = 1.0
    normal = x.T @ x / size / size[:, None] + RIDGE * len(x) * np.eye(size.size)
    inverse = np.linalg.inv(normal) / size / size[:, None]
    factors = inverse @ (x.T @ y)
    left = np.sqrt(np.mean((y - x @ factors) ** 2, axis=0))
    reach = float(_measure_leverage(x, inverse).max())
    low = min(float(t.min()) for t in temperatures_degC)
    high = max(float(t.max()) for t in temperatures_degC)
    return _Fit(factors, inverse, left, reach, low, high)


def _measure(error: Array, inside: NDArray[np.bool_]) -> Array:
    """Return the RMS [K] of an error [b, K] but for its mean, over the rows inside."""
    if inside.sum() < 8:
        return np.full(error.shape[1], np.inf)
    kept = error[inside]
    return np.asarray(np.sqrt(np.mean((kept - kept.mean(axis=0)) ** 2, axis=0)))


class Bench:
    """The runs of a data set, each of which can be compared with the others."""

    def __init__(self, runs: Sequence[Run], outputs: Sequence[str], scales: Array) -> None:
        self.outputs, self.scales = tuple(outputs), scales
        shared = set(runs[0].inputs).intersection(*(run.inputs for run in runs))
        self.courses = [_read(run) for run in runs]
        self.courses = [
            _Course(
                c.run,
                c.temperature,
                {name: c.inputs[name] for name in shared if name != "clock"},
                c.measured,
                c.reference,
            )
            for c in self.courses
        ]
        self.tables = [_build(course, scales) for course in self.courses]

    def fit_without(self, left_out: frozenset[int]) -> _Fit:
        """Return the fit of all runs but these."""
        kept = [i for i in range(len(self.courses)) if i not in left_out]
        tables = [self.tables[i] for i in kept]
        temperatures = [self.courses[i].temperature for i in kept]
        return _fit([t[0] for t in tables], [t[1] - t[2] for t in tables], temperatures)

    def hold(self, fit: _Fit, course: _Course) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return what a run's drift is and should be, [b, K] each, and the rows that count."""
        design, measured, reference = _build(course, self.scales)
        temperature = _average(course.temperature[:, None], len(design))[:, 0]
        inside = fit.find_inside(design, temperature)
        return measured - reference, design @ fit.factors, inside

    def review(self) -> list[DataNote]:
        """Return the notes."""
        notes: list[DataNote] = []
        accused: frozenset[int] = frozenset()
        while len(self.courses) - len(accused) >= FEWEST_RUNS:
            if len(accused) >= max(1, len(self.courses) // 3):
                break
            for culprit in self._list_suspects(accused):
                found = self._explain(culprit, accused)
                if found:
                    notes += found
                    accused |= {culprit}
                    break
            else:
                break
        return notes

    def agrees(self, group: str, output: str) -> bool:
        """Return whether a fit of the other runs explains an output of a run as well as theirs."""
        places = [i for i, course in enumerate(self.courses) if course.run.group == group]
        if not places or len(self.courses) < FEWEST_RUNS:
            return False
        fit = self.fit_without(frozenset(places))
        k = self.outputs.index(output)
        drift, expected, inside = self.hold(fit, self.courses[places[0]])
        return bool(_measure(drift - expected, inside)[k] <= ORDINARY * fit.left[k])

    def look_again(self, told: Sequence[str] | None) -> list[DataNote]:
        """Return what is wrong with the last run as a whole, if that is more than was told of it.

        Args:
            told: outputs that something was told of, which may be less than what is wrong; None:
                what was told is enough, unless columns are exchanged.
        """
        culprit = len(self.courses) - 1
        course = self.courses[culprit]
        fit = self.fit_without(frozenset({culprit}))
        held = self.hold(fit, course)
        error = _measure(held[0] - held[1], held[2])
        usual = np.maximum(fit.left, 1e-300)
        wrong = [k for k in range(usual.size) if error[k] > MISFIT * usual[k]]
        if not wrong:
            return []
        thermometer = self._try_thermometer(fit, course, error, wrong)
        if thermometer is not None:
            return [thermometer]
        known = self._count_covering(course) >= FEWEST_RUNS - 1
        if told is None or not known:
            return []
        swaps = self._try_swaps(fit, course, error, wrong)
        if swaps:
            return swaps
        far = self._list_far(culprit, frozenset(), held, usual)
        if all(self.outputs[k] in told for k in far):
            return []
        return [self._tell_other(course, far, error / usual)]

    def is_reference_reversed(self, output: str) -> bool:
        """Return whether the last run is right with its reference reversed, not its output."""
        k, course = self.outputs.index(output), self.courses[-1]
        fit = self.fit_without(frozenset({len(self.courses) - 1}))
        sign = np.where(np.arange(len(self.outputs)) == k, -1.0, 1.0)
        errors = []
        for measured, reference in (
            (sign * course.measured, course.reference),
            (course.measured, sign * course.reference),
        ):
            changed = _Course(course.run, course.temperature, course.inputs, measured, reference)
            drift, expected, inside = self.hold(fit, changed)
            errors.append(float(_measure(drift - expected, inside)[k]))
        return errors[1] < CLEARLY * errors[0]

    def _list_suspects(self, accused: frozenset[int]) -> list[int]:
        """Return the run without which the others agree much better, and those far from them."""
        rest = [i for i in range(len(self.courses)) if i not in accused]
        fits = {i: self.fit_without(accused | {i}) for i in rest}
        left = np.stack([fits[i].left for i in rest])
        usual = np.maximum(np.median(left, axis=0), 1e-300)
        best = np.unravel_index(int((left / usual).argmin()), left.shape)
        suspects = []
        if left[best] < AGREE * usual[best[1]]:
            suspects.append(rest[int(best[0])])
        # Far outside of the others it pulls nothing, and is wrong all the same.
        for place, i in enumerate(rest):
            drift, expected, inside = self.hold(fits[i], self.courses[i])
            if (
                inside.mean() < 0.3
                or (_measure(drift - expected, inside) > OTHER * left[place]).any()
            ):
                suspects.append(i)
        return list(dict.fromkeys(suspects))

    def _explain(self, culprit: int, accused: frozenset[int]) -> list[DataNote]:
        """Return what is wrong with a run, by what would make it right."""
        fit = self.fit_without(accused | {culprit})
        course = self.courses[culprit]
        drift, expected, inside = self.hold(fit, course)
        error = _measure(drift - expected, inside)
        usual = np.maximum(fit.left, 1e-300)
        wrong = [k for k in range(usual.size) if error[k] > MISFIT * usual[k]]
        if not wrong:
            return []
        thermometer = self._try_thermometer(fit, course, error, wrong)
        if thermometer is not None:
            return [thermometer]
        if self._count_covering(course) < FEWEST_RUNS - 1:
            return []
        notes = self._try_swaps(fit, course, error, wrong)
        told = {note.column for note in notes}
        # Held against as few runs, the others must not fit as badly.
        least = MISFIT * np.maximum(self._measure_others(culprit, accused), 1.0) * usual
        for k in wrong:
            if self.outputs[k] not in told and least[k] < error[k] < np.inf:
                note = self._try_gain(course, k, (drift, expected, inside), error, usual)
                notes += [note] if note is not None else []
        if not np.isfinite(error).all():
            return notes
        far = self._list_far(culprit, accused, (drift, expected, inside), usual)
        told = {note.column.removeprefix("reference of ") for note in notes}
        if notes and all(self.outputs[k] in told for k in far):
            return notes
        return [self._tell_other(course, far, error / usual)] if far else notes

    def _list_far(
        self,
        culprit: int,
        accused: frozenset[int],
        held: tuple[Array, Array, NDArray[np.bool_]],
        usual: Array,
    ) -> list[int]:
        """Return the outputs that follow another law, if most of them do; else none."""
        drift, expected, inside = held
        error, own = _measure(drift - expected, inside), _measure(drift, inside)
        if not np.isfinite(error).all():
            return []
        least = OTHER * np.maximum(self._measure_others(culprit, accused), 1.0) * usual
        far = [k for k in range(error.size) if error[k] > max(least[k], OF_DRIFT * own[k])]
        return far if 2 * len(far) > len(self.outputs) else []

    def _tell_other(self, course: _Course, far: Sequence[int], times: Array) -> DataNote:
        worst = max(far, key=lambda k: float(times[k]))
        return self._note(
            course,
            self.outputs[worst],
            "another_sensor",
            f"a fit of the other runs leaves {times[worst]:.0f} times as much here as of them, "
            "whatever unit, sign or column is tried: another sensor's log, or one with something "
            "else wrong. Check where it comes from, or leave the run out",
        )

    def _measure_others(self, culprit: int, accused: frozenset[int]) -> Array:
        """Return the largest misfit [K] of the other runs, each held against the rest."""
        most = np.zeros(len(self.outputs))
        for i, course in enumerate(self.courses):
            if i == culprit or i in accused:
                continue
            fit = self.fit_without(accused | {culprit, i})
            drift, expected, inside = self.hold(fit, course)
            error = _measure(drift - expected, inside) / np.maximum(fit.left, 1e-300)
            most = np.maximum(most, np.where(np.isfinite(error), error, 0.0))
        return most

    def _note(self, course: _Course, column: str, kind: str, text: str) -> DataNote:
        return DataNote(course.run.group, column, (0, len(course.run) - 1), kind, text)

    def _passes(self, now: float, before: float, usual: float) -> bool:
        if now <= CLEAR * before and now <= OTHER * usual:
            return True
        return now <= ORDINARY * usual and now <= EXPLAINED * before

    def _try_thermometer(
        self, fit: _Fit, course: _Course, error: Array, wrong: Sequence[int]
    ) -> DataNote | None:
        """Return a note if another reading of the temperature makes the run right."""
        tried: dict[str, tuple[str, Callable[[Array], Array], str]] = {
            "fahrenheit": ("temperature", lambda t: (t - 32.0) / FAHRENHEIT, "degF, not degC"),
            "kelvin": ("temperature", lambda t: t - KELVIN, "kelvin, not degC"),
        }
        for kind, (column, change, words) in tried.items():
            changed = _Course(
                course.run,
                change(course.temperature),
                course.inputs,
                course.measured,
                course.reference,
            )
            known = self._count_covering(changed) >= FEWEST_RUNS - 1
            if known and self._is_right(fit, changed, error, wrong):
                text = (
                    f"looks like {words}: read so, the run agrees with the others. State the "
                    "column's unit, or convert the log"
                )
                return self._note(course, column, kind, text)
        for k, name in enumerate(self.outputs):
            if not self._may_be(course, [c.measured[:, k] for c in self._list_others(course)]):
                continue
            measured = course.measured.copy()
            measured[:, k] = course.temperature
            changed = _Course(
                course.run, course.measured[:, k], course.inputs, measured, course.reference
            )
            if self._is_right(fit, changed, error, wrong):
                text = (
                    f"temperature and {name} look swapped: exchanged, the run agrees with the "
                    "others. Exchange the columns in the log"
                )
                return self._note(course, "temperature", "swapped", text)
        for name in sorted(course.inputs):
            if not self._may_be(course, [c.inputs[name] for c in self._list_others(course)]):
                continue
            inputs = {**course.inputs, name: course.temperature}
            changed = _Course(
                course.run, course.inputs[name], inputs, course.measured, course.reference
            )
            if self._is_right(fit, changed, error, wrong):
                text = (
                    f"temperature and {name} look swapped: exchanged, the run agrees with the "
                    "others. Exchange the columns in the log"
                )
                return self._note(course, "temperature", "swapped", text)
        return None

    def _list_others(self, course: _Course) -> list[_Course]:
        return [c for c in self.courses if c.run.group != course.run.group]

    def _may_be(self, course: _Course, others: Sequence[Array]) -> bool:
        """Return whether a run's thermometer reads what a column reads in the other runs."""
        low, high = min(float(x.min()) for x in others), max(float(x.max()) for x in others)
        middle = float(np.median(course.temperature))
        return low - (high - low) <= middle <= high + (high - low)

    def _count_covering(self, course: _Course) -> int:
        """Return how many other runs have been at a run's temperatures, as these are read now.

        What one other run alone has seen is no law of the sensor.
        """
        count = 0
        for other in self._list_others(course):
            low, high = other.temperature.min(), other.temperature.max()
            within = (course.temperature >= low) & (course.temperature <= high)
            count += bool(within.mean() >= ENOUGH)
        return count

    def _is_right(self, fit: _Fit, course: _Course, before: Array, wrong: Sequence[int]) -> bool:
        """Return whether a run agrees with the others as it is read now."""
        drift, expected, inside = self.hold(fit, course)
        # Where nothing could be judged before, it is much that something can be now.
        if inside.mean() < (ENOUGH if np.isfinite(before).all() else SOME):
            return False
        now = _measure(drift - expected, inside)
        own = _measure(drift, inside)
        if not np.isfinite(before).all() and (now > EXPLAINED * own)[wrong].any():
            return False  # a run at a temperature of its own, where the level alone would speak
        usual = np.maximum(fit.left, OF_COURSE / ORDINARY * own)
        better = all(self._passes(now[k], before[k], usual[k]) for k in wrong)
        return better and bool((now <= 2.0 * ORDINARY * usual).all())

    def _try_swaps(
        self, fit: _Fit, course: _Course, error: Array, wrong: Sequence[int]
    ) -> list[DataNote]:
        """Return notes on outputs whose columns are exchanged, or hold another one's."""
        usual = np.maximum(fit.left, 1e-300)
        for attribute, prefix in (("measured", ""), ("reference", "reference of ")):
            table = getattr(course, attribute)
            for j in wrong:
                for k in range(len(self.outputs)):
                    if k == j or not np.isfinite(error[j]):
                        continue
                    order = list(range(len(self.outputs)))
                    order[j], order[k] = k, j
                    moved = table[:, order]
                    measured = moved if attribute == "measured" else course.measured
                    reference = moved if attribute == "reference" else course.reference
                    changed = _Course(
                        course.run, course.temperature, course.inputs, measured, reference
                    )
                    drift, expected, inside = self.hold(fit, changed)
                    now = _measure(drift - expected, inside)
                    if k in wrong and all(self._passes(now[i], error[i], usual[i]) for i in (j, k)):
                        one, two = self.outputs[j], self.outputs[k]
                        text = (
                            f"{prefix}{one} and {two} look swapped: exchanged, the run agrees "
                            "with the others. Exchange the columns in the log"
                        )
                        return [
                            self._note(course, f"{prefix}{one}", "swapped", text),
                            self._note(course, f"{prefix}{two}", "swapped", text),
                        ]
                    if k not in wrong and self._copies(course, j, k):
                        text = (
                            f"holds what {self.outputs[k]} reads: a foreign column. Name the "
                            "right one, or log the run again"
                        )
                        return [self._note(course, self.outputs[j], "foreign_column", text)]
        return []

    def _copies(self, course: _Course, j: int, k: int) -> bool:
        """Return whether one output's reading is another's."""
        one, two = course.measured[:, j], course.measured[:, k]
        spread = float(np.std(two))
        return spread > 0.0 and float(np.abs(one - two).max()) < 1e-6 * spread

    def _try_gain(
        self,
        course: _Course,
        k: int,
        held: tuple[Array, Array, NDArray[np.bool_]],
        error: Array,
        usual: Array,
    ) -> DataNote | None:
        """Return a note if a factor on what is measured, or on the reference, makes it right."""
        _, expected, inside = held
        _, measured, reference = _build(course, self.scales)

        def centre(x: Array) -> Array:
            return np.asarray(x[inside] - x[inside].mean())

        m, r, p = centre(measured[:, k]), centre(reference[:, k]), centre(expected[:, k])
        true = r + p
        name = self.outputs[k]
        power = float(true @ true)
        if power > 0.0:
            gain = float(m @ true) / power
            left = m - gain * true
            doubt = float(np.sqrt(left @ left / power))
            now = float(np.sqrt(np.mean(left**2))) / max(abs(gain), 1e-12)
            if (
                abs(gain - 1.0) > max(WRONG_GAIN, SURE_GAIN * doubt)
                and doubt < SURE_GAIN * max(abs(gain), 1e-12)
                and self._passes(now, error[k] / max(abs(gain), 1e-12), usual[k])
            ):
                return self._note(course, name, *tell_gain(gain, "the column"))
        power = float(r @ r)
        if power > 0.0:
            gain = float((m - p) @ r) / power
            left = m - p - gain * r
            now = float(np.sqrt(np.mean(left**2)))
            if abs(gain - 1.0) > WRONG_GAIN and self._passes(now, error[k], usual[k]):
                factor = 1.0 / gain if gain else np.inf
                return self._note(
                    course, f"reference of {name}", *tell_gain(factor, "the reference")
                )
        return None


def find_load_columns(runs: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return notes on outputs that read another output's load and not their own.

    That shows within a run. Where most runs are so, it is the sensor, or its configuration.
    """
    found: dict[str, list[tuple[Run, int, int]]] = {}
    for run in runs:
        if run.part > 0 or len(run) < FEWEST_ROWS:
            continue
        measured = run.reference + run.steady_drift
        together = np.concatenate([measured, run.reference], axis=1)
        moves = np.ptp(together, axis=0) > 0.0
        count = len(outputs)
        if not moves.any():
            continue
        safe = np.where(moves, together, together + np.arange(len(run))[:, None] % 2)
        likeness = np.corrcoef(safe.T)[:count, count:] ** 2
        likeness[:, ~moves[count:]] = 0.0
        for j in range(count):
            k = int(likeness[j].argmax())
            load = run.reference[:, k] - run.reference[:, k].mean()
            slope = float(measured[:, j] @ load) / max(float(load @ load), 1e-300)
            if abs(slope - 1.0) > WRONG_SLOPE:
                continue  # crosstalk, or an effect of the load; what reads it reads all of it
            if k != j and likeness[j, k] >= FOLLOWS and likeness[j, j] < 0.5 * likeness[j, k]:
                found.setdefault(run.group, []).append((run, j, k))
    if len(runs) > 1 and 3 * len(found) > len(runs) + 1:
        return []
    notes = []
    for group, pairs in found.items():
        for run, j, k in pairs:
            swapped = any((one, two) == (k, j) for _, one, two in pairs)
            kind, words = (
                ("swapped", f"{outputs[j]} and {outputs[k]} look swapped")
                if swapped
                else ("foreign_column", f"reads the load of {outputs[k]}")
            )
            text = f"{words}: name the columns as they are, or exchange them in the log"
            notes.append(DataNote(group, outputs[j], (0, len(run) - 1), kind, text))
    return notes


def find_load_gains(runs: Sequence[Run], outputs: Sequence[str]) -> list[DataNote]:
    """Return notes on outputs that read another multiple of a varying load than one.

    That shows within a run. Where most runs are so, it is the sensor.
    """
    notes = []
    for k, name in enumerate(outputs):
        slopes: dict[str, tuple[Run, float]] = {}
        for run in runs:
            load = run.reference[:, k] - run.reference[:, k].mean()
            power = float(load @ load)
            if power == 0.0 or run.part > 0:
                continue
            measured = run.reference[:, k] + run.steady_drift[:, k]
            measured = measured - measured.mean()
            slope = float(measured @ load) / power
            followed = slope**2 * power / max(float(measured @ measured), 1e-300)
            if followed < FOLLOWS:
                continue
            # A drift that goes with the load is slow: it has no part in what changes at once.
            fast = np.diff(run.reference[:, k])
            at_once = float(np.diff(run.measured[:, k]) @ fast) / float(fast @ fast)
            slope = min(slope, at_once, key=lambda s: abs(s - 1.0))
            slopes[run.group] = (run, slope)
        wrong = {g: s for g, s in slopes.items() if abs(s[1] - 1.0) > WRONG_SLOPE}
        if len(slopes) > 1 and 3 * len(wrong) > len(slopes) + 1:
            continue
        for group, (run, slope) in wrong.items():
            kind, text = tell_gain(slope, "the column")
            notes.append(DataNote(group, name, (0, len(run) - 1), kind, text))
    return notes


def tell_gain(gain: float, what: str) -> tuple[str, str]:
    """Return kind and text for a column that is so many times what it should be."""
    if gain < 0.0 and abs(np.log(-gain)) <= WRONG_SLOPE:
        return "sign", (
            f"{what} has the opposite sign in this run: reversed, it agrees with the others. "
            "Reverse it in the log"
        )
    familiar = [g for f in FAMILIAR_GAINS for g in (f, 1.0 / f)]
    near = min(familiar, key=lambda g: abs(np.log(abs(gain) / g)) if gain else np.inf)
    said = f"{near:.4g}" if gain and abs(np.log(abs(gain) / near)) < 0.1 else f"{gain:.3g}"
    return "gain", (
        f"{what} is {said} times what the other runs lead to expect: another unit or gain. "
        "Convert it in the log, or leave the run out"
    )


def find_time_units(runs: Sequence[Run]) -> list[DataNote]:
    """Return notes on runs whose temperature moves many times faster or slower than in others."""
    groups = list(dict.fromkeys(run.group for run in runs))
    if len(groups) < FEWEST_RUNS:
        return []
    first = {run.group: run for run in runs if run.part == 0}
    rates = {g: _measure_rate(run) for g, run in first.items()}
    notes = []
    for group, run in first.items():
        others = [rate for g, rate in rates.items() if g != group and rate > 0.0]
        lengths = [len(r) for g, r in first.items() if g != group]
        if not others or rates[group] <= 0.0:
            continue
        faster = rates[group] / float(np.median(others))
        shorter = float(np.median(lengths)) / len(run)
        extreme = faster > RATE * max(others) / float(np.median(others))
        slow = faster < min(others) / float(np.median(others)) / RATE
        if (extreme and shorter > RATE) or (slow and shorter < 1.0 / RATE):
            factor = faster if extreme else 1.0 / faster
            unit = min((60.0, 1000.0, 3600.0), key=lambda u: abs(np.log(factor / u)))
            notes.append(
                DataNote(
                    group,
                    "time",
                    (0, len(run) - 1),
                    "time_unit",
                    f"everything is about {unit:g} times {'faster' if extreme else 'slower'} than "
                    "in the other runs: its time looks to be in another unit. State the unit of "
                    "the time column, or convert the log",
                )
            )
    return notes


def _measure_rate(run: Run) -> float:
    """Return how fast a run's temperature moves, K/s: nearly the largest of 20 stretches."""
    count = min(20, max(len(run) // 3, 1))
    edges = np.linspace(0, len(run) - 1, count + 1).astype(int)
    span_s = np.maximum(np.diff(edges), 1) * run.sample_period_s
    rates = np.abs(np.diff(run.temperature_degC[edges])) / span_s
    return float(np.quantile(rates, 0.9))
