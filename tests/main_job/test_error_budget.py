"""The error budget adds up, names the right operation, and shows that nothing grows."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.main_job.conftest import invoke, write_project

from zerodrift.base.config import load_config
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Run
from zerodrift.export.compose import calibrate, describe_compensator, predict_integer
from zerodrift.export.quantize import quantize
from zerodrift.train.compensator import Compensator
from zerodrift.verify.chip_error import ErrorBudget, measure_budget, repeat_run


def measure(
    project: Path,
    folder: Path,
    *,
    weights: str = "int16",
    coarser: int = 1,
    steps: int = 1000,
    change: Callable[[Run], Run] = Run.at_rest,
) -> tuple[ErrorBudget, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
    """Return the budget of a project's compensator and its measured total."""
    config = load_config(project)
    dataset = load_dataset(config)
    compensator = Compensator.load(project / "build")
    described = describe_compensator(compensator, config, dataset.train)
    outputs = tuple(replace(o, lsb_per_unit=o.lsb_per_unit // coarser) for o in described.outputs)
    described = replace(described, outputs=outputs)
    calibration = calibrate(described, dataset.train)
    model = quantize(described, calibration, weights)
    host = HostModel(model, generate(model), folder)
    runs = [change(run) for run in dataset.test]
    budget = measure_budget(described, calibration, host, runs, steps)
    errors = [predict_integer(model, run) - compensator.predict(run) for run in dataset.test]
    return budget, np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))


def test_budget_adds_up_to_what_is_measured(project: Path, tmp_path: Path) -> None:
    budget, measured = measure(project, tmp_path)
    np.testing.assert_allclose(budget.total, measured, rtol=1e-3)
    # the costs are signals that add up; their sizes can only be larger than the whole
    assert (sum(node.rms for node in budget.nodes) >= budget.total * 0.999).all()
    assert {"features", "gru", "head", "drift"} <= {node.node for node in budget.nodes}


def test_budget_names_the_operation_that_is_made_coarse(project: Path, tmp_path: Path) -> None:
    coarse_weights, _ = measure(project, tmp_path / "a", weights="int8")
    assert coarse_weights.largest[0].node == "gru"
    coarse_output, _ = measure(project, tmp_path / "b", coarser=100)
    assert coarse_output.largest[0].node == "drift"
    # an output rounded to whole counts is off by 1/sqrt(12) of one
    counts = coarse_output.nodes[-1].rms * np.array([10.0, 1000.0])
    np.testing.assert_allclose(counts, 12**-0.5, rtol=0.1)


def test_budget_after_a_gap_starts_at_rest_as_the_c_does(project: Path, tmp_path: Path) -> None:
    """Else the float model's memory of what was before the gap would count as quantization."""

    def begin_late(run: Run) -> Run:
        late = run.take(slice(len(run) // 2, None))
        return replace(late, part=1, before=run.take(slice(len(run) // 3)))

    after_gap, _ = measure(project, tmp_path / "a", change=begin_late)
    alone, _ = measure(project, tmp_path / "b", change=lambda run: begin_late(run).at_rest())
    np.testing.assert_array_equal(after_gap.total, alone.total)
    for late, rest in zip(after_gap.over_time, alone.over_time, strict=True):
        np.testing.assert_array_equal(late.rms, rest.rms)


@pytest.mark.slow
def test_error_does_not_grow_over_a_million_steps(project: Path, tmp_path: Path) -> None:
    budget, _ = measure(project, tmp_path, steps=1_000_000)
    assert [span.last_step for span in budget.over_time] == [10**k for k in range(2, 7)]
    earlier = np.max([span.rms for span in budget.over_time[:-1]], axis=0)
    assert (budget.over_time[-1].rms <= 1.05 * earlier).all()


@pytest.mark.parametrize("memory", ["4", '"stream"'])
def test_budget_of_every_memory_without_and_with_network(
    memory: str, logs: Path, tmp_path: Path
) -> None:
    directory = write_project(tmp_path / "p", logs, memory)
    assert invoke("train", "-C", str(directory)).exit_code == 0
    budget, measured = measure(directory, tmp_path)
    np.testing.assert_allclose(budget.total, measured, rtol=2e-3)
    toml = directory / "zerodrift.toml"
    toml.write_text(toml.read_text().split("[network]")[0])
    assert invoke("train", "-C", str(directory)).exit_code == 0
    budget, measured = measure(directory, tmp_path)
    np.testing.assert_allclose(budget.total, measured, rtol=1e-3)


def test_repeated_run_has_no_jump(project: Path) -> None:
    run = load_dataset(load_config(project)).test[0]
    long = repeat_run(run, 3 * len(run) + 7)
    assert len(long) == 3 * len(run) + 7
    largest = np.abs(np.diff(run.temperature_degC)).max()
    assert np.abs(np.diff(long.temperature_degC)).max() == largest
