"""Predictions for training runs by models that did not learn from them: for gate, uncertainty."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.base.journal import write_all
from zerodrift.base.records import to_dict
from zerodrift.base.sealed import render_sealed

if TYPE_CHECKING:
    from zerodrift.dataset.runs import Dataset
    from zerodrift.export.float_model import FloatModel
    from zerodrift.train.compensator import Compensator
    from zerodrift.verify.firmware import Firmware
    from zerodrift.verify.left_out import LeftOut


@dataclass(frozen=True)
class RunsLeftOut:
    """Predictions for training runs by models that did not learn from them."""

    left_out: "LeftOut | None"
    why: str = ""
    """Why no uncertainty is stated; empty where one is."""

    def judge(self, dataset: "Dataset") -> "LeftOut | None":
        """Return what the gate judges by; None where there are test runs, and for networks."""
        from zerodrift.verify.left_out import choose_judge

        return choose_judge(self.left_out, dataset)


NO_TRAINING = RunsLeftOut(
    None,
    "no uncertainty is stated: it comes from models that left a training run out, and a network"
    " from an ONNX file cannot be trained again here",
)


def leave_runs_out(
    config: Config, dataset: "Dataset", compensator: "Compensator", *, wanted: bool = True
) -> RunsLeftOut:
    """Return predictions for training runs by models that did not learn from them.

    Networks are trained again without a part of the runs each, all of them in parallel; finished
    parts stay in build/ and are not repeated.

    Args:
        config: the project.
        dataset: its runs.
        compensator: trained on all training runs.
        wanted: False: only models that are quick to fit are fitted again, for the gate.
    """
    from zerodrift.train.progress import show_progress
    from zerodrift.train.refits import Original
    from zerodrift.train.tasks import Handling
    from zerodrift.verify.left_out import leave_out, leave_out_together

    if not wanted:
        quick = leave_out(config, dataset, compensator)
        return RunsLeftOut(quick, "no uncertainty is stated, as --no-uncertainty asks")
    with show_progress("leaving runs out") as report:
        handling = Handling(folder=config.build_directory, report=report)
        (found,) = leave_out_together([Original(config, dataset, compensator)], handling)
    if isinstance(found, InputError):
        return RunsLeftOut(None, f"no uncertainty is stated: {found}")
    return RunsLeftOut(found)


def keep_uncertainty(
    firmware: "Firmware",
    config: Config,
    dataset: "Dataset",
    described: "FloatModel",
    left: RunsLeftOut,
) -> None:
    """Write build/uncertainty.json where some model left runs out; remove it where none did."""
    from zerodrift.verify.uncertainty import FILE_NAME, measure_firmware

    path = config.build_directory / FILE_NAME
    if left.left_out is None or left.why:
        write_all(config.directory, {path: None})
        return
    rounding = [error.rounding for error in firmware.gate.chip_error]
    measured = measure_firmware(
        described, firmware.model, dataset, left.left_out, rounding, firmware.replay
    )
    write_all(config.directory, {path: render_sealed(to_dict(measured))})
