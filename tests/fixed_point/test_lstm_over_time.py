"""An LSTM's integers stay with float64 over a long run, whose memory is slow."""

import pytest
from benchmarks.bench_recurrent import LSTM_MARK_PCT, measure_lstm

pytestmark = pytest.mark.long


def test_16_bit_lstm_stays_with_float_over_thousands_of_steps() -> None:
    assert max(measure_lstm(300, 4000, "int16")) <= LSTM_MARK_PCT


def test_8_bits_cost_more_than_16() -> None:
    wide, narrow = (sum(measure_lstm(301, 2000, weights)) for weights in ("int16", "int8"))
    assert wide < narrow
