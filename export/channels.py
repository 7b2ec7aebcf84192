"""The channels that a model reads: which there are, and how each one's codes are converted."""

from collections.abc import Sequence

from zerodrift.base.config import Config
from zerodrift.dataset.chip_codes import RANGE_MARGIN, choose_codes, find_junction_span
from zerodrift.dataset.code_format import CLOCK, MEASURED, TEMPERATURE, ChipCodes
from zerodrift.dataset.runs import Run
from zerodrift.dataset.thermocouples import find_span
from zerodrift.export.conversions import JunctionCodes, design_conversion
from zerodrift.export.float_model import LOAD
from zerodrift.export.integer_model import Channel, OutputFormat
from zerodrift.operations.graph import Node, list_nodes

JUNCTION_MARGIN_K = 5.0
"""How far, at least, a cold junction's table goes beyond what was logged."""


def list_channels(
    roots: Sequence[Node],
    config: Config,
    runs: Sequence[Run],
    outputs: Sequence[OutputFormat],
) -> tuple[tuple[Channel, ...], dict[str, int]]:
    """Return the raw inputs that the graph needs; the temperature is always the first."""
    found = [choose_codes(config, TEMPERATURE, runs, 0.0)]
    sources = {TEMPERATURE: 0}
    places = {TEMPERATURE: 0}
    for node in list_nodes(roots):
        if node.op != "input" or node.source in sources:
            continue
        codes = _find_codes(node.source, config, runs, outputs)
        if codes is None:
            continue
        if codes.source not in places:
            places[codes.source] = len(found)
            found.append(codes)
        sources[node.source] = places[codes.source]
    for codes in tuple(found):
        name = find_junction(codes)
        if name is not None and name not in places:
            places[name] = len(found)
            found.append(choose_codes(config, name, runs, 0.0))
    cold = {
        name: _cover_junction(config, places[name], found[places[name]], runs)
        for name in filter(None, map(find_junction, found))
    }
    channels = [
        make_channel(index, codes, cold.get(find_junction(codes) or ""))
        for index, codes in enumerate(found)
    ]
    return tuple(channels), sources


def find_junction(codes: ChipCodes) -> str | None:
    """Return the input that measures the cold junction of a thermocouple which the chip reads."""
    return None if codes.by is None or codes.held is None else codes.by.junction


def _cover_junction(
    config: Config, index: int, codes: ChipCodes, runs: Sequence[Run]
) -> JunctionCodes:
    """Return the codes of a cold junction that its thermocouple's table covers."""
    low, high = find_junction_span(config, codes.source, runs)
    beyond = max(JUNCTION_MARGIN_K, 1.5 * RANGE_MARGIN * (high - low))
    users = [c.by for c in (config.temperature_codes, *config.input_codes.values()) if c.by]
    spans = [find_span(by.couple) for by in users if by.couple and by.junction == codes.source]
    ends = (
        max([low - beyond, *(span[0] for span in spans)]),
        min([high + beyond, *(span[1] for span in spans)]),
    )
    first, last = (round((end - codes.offset) / codes.lsb) for end in ends)
    first, last = (min(max(code, codes.codes[0]), codes.codes[1]) for code in (first, last))
    by = make_channel(index, codes).conversion
    return JunctionCodes(
        channel=index,
        bits=codes.bits,
        lsb=codes.lsb,
        offset=codes.offset,
        none=codes.no_reading,
        low=first,
        high=last,
        error=0.0 if by is None else by.error,
    )


def _find_codes(
    source: str, config: Config, runs: Sequence[Run], outputs: Sequence[OutputFormat]
) -> ChipCodes | None:
    """Return the codes behind a signal of the graph, or None where it needs none."""
    if source.startswith(LOAD):
        name = source.removeprefix(LOAD)
        output = next(o for o in outputs if o.name == name)
        lsb = 1.0 / output.lsb_per_unit
        return choose_codes(config, f"{MEASURED}{name}", runs, lsb)
    name = CLOCK if source == "clock_s" else source
    if not all(name in run.inputs for run in runs):
        return None
    return choose_codes(config, name, runs, 0.0)


def make_channel(index: int, codes: ChipCodes, junction: JunctionCodes | None = None) -> Channel:
    """Return a channel of the model.

    Args:
        index: its place.
        codes: its codes.
        junction: those of a thermocouple's cold junction, where a channel measures it.

    Raises:
        CheckError: no table converts the raw codes within the allowed error.
    """
    conversion = None
    if codes.cover is not None and codes.by is not None:
        is_same = codes.cover.is_plain and codes.cover.raw == f"int{codes.bits}"
        given = (codes.cover, codes.by, codes.lsb, codes.offset, codes.no_reading)
        conversion = None if is_same else design_conversion(index, *given, junction)
    return Channel(
        name=codes.name,
        unit=codes.unit,
        lsb=codes.lsb,
        offset=codes.offset,
        bits=codes.bits,
        source=codes.source,
        no_reading=codes.no_reading,
        conversion=conversion,
    )
