"""The sensors to which both programmes of the benchmark are done, and what is recorded of them."""

import numpy as np
from benchmarks.planned_sensors import PERIOD_S, REST_S, make_whole, record_default

PAIR = ("creep", "load_hysteresis")


def test_shorter_records_of_the_default_are_the_first_hours_of_the_same_sensor():
    sensor = make_whole(PAIR, "creep", 0.5, 3)
    rows = {h: [len(run) for run in record_default(sensor, h).train] for h in (0.5, 1.0, 2.5)}
    whole = rows[1.0][0]
    assert abs(PERIOD_S * whole - (3600.0 - REST_S)) <= PERIOD_S
    cut = round((1800.0 - REST_S) / PERIOD_S)
    assert rows == {0.5: [cut], 1.0: [whole], 2.5: [whole, whole, cut]}
    half, more = (record_default(sensor, h).train[0] for h in (0.5, 2.5))
    assert np.array_equal(half.measured, more.measured[:cut])
    assert np.array_equal(half.reference, more.reference[:cut])
