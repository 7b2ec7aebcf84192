"""What is wrong with a run that disagrees with the others: the reading that makes it agree best.

Each explanation reads the run another way: another unit, sign or gain, two columns exchanged, the
reference shifted, the zero moved from a row on, rows left out that stand at a limit or spike. The
fit of the other runs, which knows of none of them, tells which of them leaves least; where none
makes the run agree, it follows another law.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from zerodrift.base.arrays import Array, Mask
from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.agreement import FEWEST_RUNS, Bench, RunAgreement, RunReading
from zerodrift.diagnosis.data_notes import DataNote
from zerodrift.diagnosis.misfits import WRONG_GAIN, tell_gain
from zerodrift.diagnosis.sentinels import tell_wild

KELVIN, FAHRENHEIT = 273.15, 1.8
EXPLAINED = 0.4
"""An explanation leaves at most this share of what was left without, ..."""
AGREES = 0.75
"""... and brings the run's doubt below this: from 1 on it disagrees."""
CLEARLY = 0.1
"""One that leaves less than this share of both is told, though something is left: a fault is hardly
ever mended to the last row."""
AMONG = 0.4
"""Share of a run's rows that a reading leaves, or brings, among the other runs' temperatures."""
FITTED = 0.8
"""A number that is fitted, or rows that are left out, explain a little of anything: such an
explanation leaves at most this share of what the best plain one leaves."""
STANDS = 0.05
"""Share of a run's rows that stand exactly at the end of a column's range where it is cut off."""
SPIKES = 0.005
"""Share of a run's rows that are far off from their neighbours, ..."""
WIDTH, FAR_OFF = 9, 8.0
"""... by so many usual distances from the median of so many rows."""
SURE_GAIN = 0.3
"""A gain is told where the run's course tells it to this share."""


@dataclass(frozen=True)
class Explanation:
    """One way to read a run."""

    notes: tuple[DataNote, ...]
    courses: tuple[RunReading, ...]
    fitted: bool = False
    """Whether a number or rows were chosen by the run itself, ..."""
    seen: bool = False
    """Whether the columns alone show it, and the fit that it matters: stands and spikes."""
    shrinks: float = 1.0
    """... and by what its outputs are divided, which makes whatever is left small, or its reference
    multiplied, which says the same of the load."""

    def count(self, after: RunAgreement) -> float:
        """Return what is left of the run as it is read, by how much was chosen for it."""
        return after.error * max(self.shrinks, 1.0) / (FITTED if self.fitted else 1.0)


def explain(bench: Bench, i: int, rest: frozenset[int]) -> list[DataNote]:
    """Return what is wrong with a run that disagrees with the others; never nothing.

    Args:
        bench: all runs.
        i: the run's place.
        rest: places of the runs that are held to be right, and this one.
    """
    now = bench.assess(i, rest)
    assert now is not None
    found = weigh(bench, i, rest, now)
    return list(found.notes) if found is not None else [tell_other(bench, i, now)]


def find_units(bench: Bench, rest: frozenset[int]) -> list[DataNote]:
    """Return notes on runs far from all others' temperatures, that a unit brings among them.

    Where the drift is a straight line of the temperature, such a run agrees at any level.
    """
    notes = []
    for i in sorted(rest) if len(rest) >= FEWEST_RUNS else ():
        low, high = _find_span(bench, i, rest)
        own = np.concatenate([c.run.temperature_degC for c in bench.courses[i]])
        if max(low - own.max(), own.min() - high) <= high - low:
            continue
        for tried in _read_units(bench, i):
            after = bench.assess(i, rest, tried.courses)
            among = _is_among(tried.courses, (low, high))
            if after is not None and after.doubt.max() <= AGREES and among:
                notes += list(tried.notes)
                break
    return notes


def _find_span(bench: Bench, i: int, rest: frozenset[int]) -> tuple[float, float]:
    """Return the lowest and the highest temperature of the runs that a run is held to, in degC."""
    others = np.concatenate([c.run.temperature_degC for j in rest - {i} for c in bench.courses[j]])
    return float(others.min()), float(others.max())


def _is_among(courses: Sequence[RunReading], span: tuple[float, float]) -> bool:
    """Return whether a reading has the run where others have been; elsewhere nothing tests it."""
    read = np.concatenate([course.run.temperature_degC for course in courses])
    return float(((read >= span[0]) & (read <= span[1])).mean()) >= AMONG


def _assess(
    bench: Bench, i: int, rest: frozenset[int], readings: Iterator[Explanation]
) -> Iterator[tuple[Explanation, RunAgreement]]:
    """Give readings with what is left by each; none takes the run away from where others were."""
    span = _find_span(bench, i, rest)
    is_among = _is_among(bench.courses[i], span)
    for tried in readings:
        after = bench.assess(i, rest, tried.courses)
        if after is not None and (_is_among(tried.courses, span) or not is_among):
            yield tried, after


def find_reading(bench: Bench, rest: frozenset[int]) -> tuple[int, list[DataNote]] | None:
    """Return the run that another unit, sign, gain or order of its columns explains best, if any.

    Such a reading has nothing to fit a misfit with, or one number: where it takes away most of what
    makes the run the worst of all, no missing effect is as good an explanation, however small the
    misfit is.
    """
    found: tuple[int, list[DataNote]] | None = None
    best = EXPLAINED
    for i in sorted(rest) if len(rest) >= FEWEST_RUNS else ():
        now = bench.assess(i, rest)
        if now is None or now.error <= 1.0:
            continue
        left = np.exp(np.log(np.maximum(now.misfit, 1e-12)).mean(axis=0))
        wrong = [k for k in range(len(bench.outputs)) if left[k] > 1.0]
        for tried, after in _assess(bench, i, rest, _list_readings(bench, i, rest, wrong)):
            if tried.count(after) / now.error <= best:
                found, best = (i, list(tried.notes)), tried.count(after) / now.error
    return found


def weigh(bench: Bench, i: int, rest: frozenset[int], now: RunAgreement) -> Explanation | None:
    """Return the explanation that leaves least of a run; None where none makes it agree."""
    best: Explanation | None = None
    least = (True, np.inf)
    for tried, after in _assess(bench, i, rest, _list_all(bench, i, rest, now)):
        doubts = float(now.doubt.max()), float(after.doubt.max())
        agrees = doubts[1] <= AGREES and after.error <= EXPLAINED * now.error
        most = EXPLAINED if tried.seen else CLEARLY
        if not agrees and max(after.error / now.error, doubts[1] / doubts[0]) > most:
            continue
        counts = tried.count(after)
        # What makes the run agree comes before what only takes most of the misfit away.
        if (not agrees, counts) < least:
            best, least = tried, (not agrees, counts)
    return best


def tell_other(bench: Bench, i: int, now: RunAgreement) -> DataNote:
    """Return the note on a run that nothing explains."""
    worst = int(now.doubt.argmax())
    times, harm = float(now.misfit[-1, worst]), float(now.harm[worst])
    said = (
        f"{times:.3g} times as much as of any other"
        if times >= 1.0
        else f"and with it in the fit {harm:.2g} times as much of the others"
    )
    return _note(
        bench,
        i,
        bench.outputs[worst],
        "another_sensor",
        f"does not agree with the others: a fit of them leaves {said}, whatever unit, sign or "
        "column is tried. Another sensor's log, or one with something else wrong. Check where it "
        "comes from, or leave the run out",
    )


def _note(
    bench: Bench, i: int, column: str, kind: str, text: str, rows: tuple[int, int] | None = None
) -> DataNote:
    last = sum(len(course.run) for course in bench.courses[i]) - 1
    return DataNote(bench.groups[i], column, rows or (0, last), kind, text)


def _list_readings(
    bench: Bench, i: int, rest: frozenset[int], wrong: Sequence[int]
) -> Iterator[Explanation]:
    """Give the run in other units, with other signs and gains, and with columns exchanged."""
    yield from _read_thermometer(bench, i)
    yield from _exchange_outputs(bench, i, wrong)
    for k in wrong:
        yield from _scale(bench, i, rest, k)


def _list_all(
    bench: Bench, i: int, rest: frozenset[int], now: RunAgreement
) -> Iterator[Explanation]:
    wrong = [k for k in range(len(bench.outputs)) if now.doubt[k] >= 0.5]
    yield from _list_readings(bench, i, rest, wrong)
    yield from _cut(bench, i, "temperature", lambda run: run.temperature_degC)
    for k in wrong:
        yield from _shift(bench, i, k)
        yield from _move_zero(bench, i, rest, k)
        yield from _leave_out(bench, i, k)


def _change(bench: Bench, i: int, change: Callable[[Run], Run]) -> tuple[RunReading, ...]:
    return tuple(replace(course, run=change(course.run)) for course in bench.courses[i])


def _read_units(bench: Bench, i: int) -> Iterator[Explanation]:
    """Give the temperature in other units."""
    units: dict[str, tuple[Callable[[Array], Array], str]] = {
        "fahrenheit": (lambda t: (t - 32.0) / FAHRENHEIT, "degF, not degC"),
        "kelvin": (lambda t: t - KELVIN, "kelvin, not degC"),
    }
    for kind, (convert, words) in units.items():
        text = (
            f"looks like {words}: read so, the run agrees with the others. State the column's "
            "unit, or convert the log"
        )
        yield Explanation(
            (_note(bench, i, "temperature", kind, text),),
            _change(bench, i, partial(_convert, convert)),
        )


def _read_thermometer(bench: Bench, i: int) -> Iterator[Explanation]:
    """Give other readings of the temperature."""
    yield from _read_units(bench, i)

    def exchange(name: str, change: Callable[[Run], Run]) -> Explanation:
        text = (
            f"temperature and {name} look swapped: exchanged, the run agrees with the others. "
            "Exchange the columns in the log"
        )
        note = _note(bench, i, "temperature", "swapped", text)
        return Explanation((note,), _change(bench, i, change))

    for k, name in enumerate(bench.outputs):

        def with_output(run: Run, k: int = k) -> Run:
            exchanged = _set(run, k, measured=run.temperature_degC)
            return _warm(exchanged, run.measured[:, k])

        yield exchange(name, with_output)
    for name in bench.courses[i][0].run.inputs:

        def with_input(run: Run, name: str = name) -> Run:
            inputs = {**run.inputs, name: run.temperature_degC}
            return _warm(replace(run, inputs=inputs), run.inputs[name])

        yield exchange(name, with_input)


def _cut(bench: Bench, i: int, name: str, read: Callable[[Run], Array]) -> Iterator[Explanation]:
    """Give the run without the rows in which a column stands at an end."""
    for end in (np.max, np.min):
        value = float(end([end(read(course.run)) for course in bench.courses[i]]))

        def stand(run: Run, value: float = value) -> Mask:
            return np.asarray(read(run) == value)

        standing = _mark(bench, i, stand)
        if standing is not None:
            courses, rows, count = standing
            text = (
                f"{count} rows stand at {value:.6g}, the end of what it reads in this run; "
                "without them it agrees with the others: it is cut off there. Look at its range, "
                "and record the run again"
            )
            note = _note(bench, i, name, "saturated", text, rows)
            yield Explanation((note,), courses, fitted=True, seen=True)


def _mark(
    bench: Bench, i: int, find: Callable[[Run], Mask], least: float = STANDS
) -> tuple[tuple[RunReading, ...], tuple[int, int], int] | None:
    """Return a run without some rows, the first and last of them, and how many; None if few."""
    marks = [find(course.run) for course in bench.courses[i]]
    every = np.flatnonzero(np.concatenate(marks))
    total = sum(mark.size for mark in marks)
    if every.size < max(least * total, 3) or every.size > 0.8 * total:
        return None
    courses = tuple(
        replace(course, kept=course.kept & ~mark)
        for course, mark in zip(bench.courses[i], marks, strict=True)
    )
    return courses, (int(every[0]), int(every[-1])), int(every.size)


def _exchange_outputs(bench: Bench, i: int, wrong: Sequence[int]) -> Iterator[Explanation]:
    for attribute, prefix in (("measured", ""), ("reference", "reference of ")):
        for j in wrong:
            for k in wrong:
                if k <= j:
                    continue
                order = list(range(len(bench.outputs)))
                order[j], order[k] = k, j

                def change(run: Run, order: list[int] = order, name: str = attribute) -> Run:
                    if name == "measured":
                        return replace(run, measured=run.measured[:, order])
                    return replace(run, reference=run.reference[:, order])

                one, two = bench.outputs[j], bench.outputs[k]
                text = (
                    f"{prefix}{one} and {two} look swapped: exchanged, the run agrees with the "
                    "others. Exchange the columns in the log"
                )
                notes = tuple(
                    _note(bench, i, f"{prefix}{name}", "swapped", text) for name in (one, two)
                )
                yield Explanation(notes, _change(bench, i, change))


def _convert(change: Callable[[Array], Array], run: Run) -> Run:
    return _warm(run, change(run.temperature_degC))


def _warm(run: Run, temperature_degC: Array) -> Run:
    return replace(run, temperature_degC=temperature_degC)


def _set(run: Run, k: int, *, measured: Array | None = None, reference: Array | None = None) -> Run:
    """Return a stretch with another column of an output."""
    if measured is not None:
        columns = run.measured.copy()
        columns[:, k] = measured
        return replace(run, measured=columns)
    columns = run.reference.copy()
    columns[:, k] = reference
    return replace(run, reference=columns)


def _scale(bench: Bench, i: int, rest: frozenset[int], k: int) -> Iterator[Explanation]:
    """Give an output, or its reference, with the opposite sign, or as a multiple of itself."""
    courses, name = bench.courses[i], bench.outputs[k]
    loaded = any(float(np.ptp(course.run.reference[:, k])) > 0.0 for course in courses)
    kind, text = tell_gain(-1.0, "the column")
    yield Explanation(
        (_note(bench, i, name, kind, text),),
        _change(bench, i, lambda r: _set(r, k, measured=-r.measured[:, k])),
    )
    if loaded:
        text = (
            "has the opposite sign in this run: reversed, the drift agrees with that of the "
            "other runs. Reverse it in the log"
        )
        yield Explanation(
            (_note(bench, i, f"reference of {name}", "reversed_reference", text),),
            _change(bench, i, lambda r: _set(r, k, reference=-r.reference[:, k])),
        )
    expected, drift = bench.expect(i, rest, courses)
    blank = _change(bench, i, lambda r: replace(r, measured=np.zeros_like(r.measured)))
    load = -bench.expect(i, rest, blank)[1][:, k]
    p, measured = expected[:, k], drift[:, k] + load
    true = load + p
    power = float(true @ true)
    if power > 0.0:
        gain = float(measured @ true) / power
        left = measured - gain * true
        doubt = float(np.sqrt(left @ left / power))
        if abs(gain - 1.0) > WRONG_GAIN and 0.0 < doubt < SURE_GAIN * abs(gain):
            yield Explanation(
                (_note(bench, i, name, *tell_gain(gain, "the column")),),
                _change(bench, i, lambda r: _set(r, k, measured=r.measured[:, k] / gain)),
                fitted=True,
                shrinks=abs(gain),
            )
    power = float(load @ load)
    if loaded and power > 0.0:
        factor = float((measured - p) @ load) / power
        if abs(factor - 1.0) > WRONG_GAIN and factor:
            told = tell_gain(1.0 / factor, "the reference")
            yield Explanation(
                (_note(bench, i, f"reference of {name}", *told),),
                _change(bench, i, lambda r: _set(r, k, reference=r.reference[:, k] * factor)),
                fitted=True,
                shrinks=abs(factor),
            )


def _shift(bench: Bench, i: int, k: int) -> Iterator[Explanation]:
    """Give the reference as many rows earlier or later as the output follows it best."""
    longest = max(bench.courses[i], key=lambda course: len(course.run))
    m, r = (x[:, k] - x[:, k].mean() for x in (longest.run.measured, longest.run.reference))
    if float(np.ptp(r)) == 0.0:
        return
    size = 1 << int(np.ceil(np.log2(2 * m.size)))
    product = np.fft.irfft(np.conj(np.fft.rfft(m, size)) * np.fft.rfft(r, size))
    reach = m.size // 4
    likeness = np.concatenate([product[-reach:], product[: reach + 1]])
    rows = int(likeness.argmax()) - reach
    if not rows:
        return

    def move(course: RunReading) -> RunReading:
        place = np.clip(np.arange(len(course.run)) + rows, 0, len(course.run) - 1)
        moved = _set(course.run, k, reference=course.run.reference[place, k])
        return RunReading(moved, place == np.arange(len(course.run)) + rows)

    seconds = rows * longest.run.sample_period_s
    text = (
        f"is {abs(seconds):.4g} s {'late' if rows > 0 else 'early'} in this run: moved by that, "
        "the run agrees with the others. Set the clocks right, or shift the column"
    )
    name = f"reference of {bench.outputs[k]}"
    note = _note(bench, i, name, "late_reference", text)
    yield Explanation((note,), tuple(map(move, bench.courses[i])), fitted=True)


def _move_zero(bench: Bench, i: int, rest: frozenset[int], k: int) -> Iterator[Explanation]:
    """Give the run with another zero from one row on."""
    expected, drift = bench.expect(i, rest, bench.courses[i])
    left = drift[:, k] - expected[:, k]
    n = left.size
    counts = np.arange(1, n)
    sums = np.cumsum(left - left.mean())[:-1]
    clear = np.abs(sums) * np.sqrt(n / (counts * (n - counts)))
    place = int(clear[2:-2].argmax()) + 3
    total = sum(len(course.run) for course in bench.courses[i])
    row = round(place * total / n)
    size = float(left[place:].mean() - left[:place].mean())
    begins = np.cumsum([0, *(len(course.run) for course in bench.courses[i])])
    courses = tuple(
        replace(course, later=np.arange(len(course.run)) + begin >= row)
        for course, begin in zip(bench.courses[i], begins[:-1], strict=True)
    )
    text = (
        f"the zero moves by about {size:.4g} near row {row} and stays there, with no cause in the "
        "logs: re-zeroed or disturbed in mid-run. Split the run there (file@from:to)"
    )
    note = _note(bench, i, bench.outputs[k], "offset_jump", text, (row, total - 1))
    yield Explanation((note,), courses, fitted=True)


def _leave_out(bench: Bench, i: int, k: int) -> Iterator[Explanation]:
    """Give the run without rows of an output that stand at its limit, or spike."""
    name = bench.outputs[k]
    yield from _cut(bench, i, name, lambda run: np.asarray(run.measured[:, k]))
    wild = _mark(bench, i, lambda r: _find_wild(r, k), SPIKES)
    if wild is not None:
        courses, rows, _ = wild
        runs = [course.run for course in bench.courses[i]]
        values = np.concatenate([run.measured[_find_wild(run, k), k] for run in runs])
        note = _note(bench, i, name, *tell_wild(values, sum(map(len, runs))), rows)
        yield Explanation((note,), courses, fitted=True, seen=True)


def _find_wild(run: Run, k: int) -> Mask:
    """Return the rows of an output's drift far off from the median of their neighbours."""
    x = run.drift[:, k]
    if x.size < WIDTH:
        return np.zeros(x.size, dtype=np.bool_)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(x, WIDTH // 2, "edge"), WIDTH)
    away = np.abs(x - np.median(around, axis=1))
    usual = float(np.quantile(away, 0.6))
    return np.asarray(away > FAR_OFF * max(usual, 1e-9 * float(np.ptp(x)), 1e-300))
