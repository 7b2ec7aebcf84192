"""What the pictures show, and that nothing in them can be taken for something else."""

from zerodrift.lab.paper.figures import draw_heat
from zerodrift.lab.paper.summary import Spread
from zerodrift.lab.paper.why import Heat

CHAMBER, BENCH, SECOND = "the chamber alone", "the chamber and bench logs", "a second thermometer"


def test_heat_has_a_look_per_method_and_a_row_per_training_logs() -> None:
    def errors(base: float) -> dict[str, Spread]:
        tests = ("chamber", "heating", "walking_still")
        return {
            test: Spread(base + i, base + i - 0.5, base + i + 0.5, 3)
            for i, test in enumerate(tests)
        }

    pairs = [("mlp", CHAMBER), ("mlp", BENCH), ("lag_bank", CHAMBER), ("lag_bank", BENCH)]
    heat = Heat(
        {pair: errors(2.0 * i + 1.0) for i, pair in enumerate([*pairs, ("lag_bank", SECOND)])}
    )
    figure = draw_heat(heat)
    looks = {(trace.marker.color, trace.marker.symbol): set() for trace in figure.data}
    for trace in figure.data:
        looks[trace.marker.color, trace.marker.symbol].add(trace.name)
    assert sorted(map(len, looks.values())) == [1, 1]
    assert [trace.showlegend for trace in figure.data].count(True) == 2
    assert list(figure.layout.yaxis.ticktext) == [CHAMBER, BENCH, SECOND]
    shown = [x for trace in figure.data for x in trace.x]
    told = [s.median for spreads in heat.errors.values() for s in spreads.values()]
    assert sorted(shown) == sorted(told)
    places = [(trace.xaxis, y) for trace in figure.data for y in trace.y]
    assert len(set(places)) == len(places)
    assert {round(y) for _, y in places} == {0, 1, 2}
