"""What the first pass over a fleet with blocks leaves for the second, beside the units' files."""

import pickle
from dataclasses import dataclass, replace
from pathlib import Path

from zerodrift.base.config import Config
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Dataset
from zerodrift.export.integer_model import IntegerModel
from zerodrift.fleet.design import Design
from zerodrift.train.compensator import Compensator
from zerodrift.train.refits import Original
from zerodrift.train.tasks import Handling
from zerodrift.verify.left_out import LeftOut, leave_out, leave_out_together, takes_epochs


@dataclass(frozen=True)
class Spooled:
    """What would have to be read or computed again."""

    mark: str
    """Of the design and of the unit's logs."""
    dataset: Dataset
    left_out: LeftOut | None
    model: IntegerModel | None = None
    """In its own format; None: it has to be loaded."""


def spool(folder: Path | None, sensor: str, content: Spooled) -> None:
    """Keep what the second pass needs, if this process can reach a place with room for it."""
    if folder is None or not folder.is_dir():
        return
    path = folder / f"{sensor}.pickle"
    try:
        path.write_bytes(pickle.dumps(content, protocol=5))
    except OSError:  # the second pass reads the logs again
        path.unlink(missing_ok=True)


def unspool(
    design: Design, config: Config, sensor: str, compensator: Compensator, mark: str
) -> Spooled:
    """Return what was kept of a unit; where nothing was, logs are read and runs left out again.

    Args:
        design: has the spool, a folder of this run that nobody else can write to.
        config: the unit's.
        sensor: its name.
        compensator: what was fitted to its training runs.
        mark: of the design and of its logs.
    """
    path = None if design.spool is None else design.spool / f"{sensor}.pickle"
    if path is not None and path.is_file():
        kept: Spooled = pickle.loads(path.read_bytes())  # noqa: S301 - this run's own file
        if kept.mark == mark:
            return kept
    dataset = load_dataset(config, design.skip_invalid)
    if not takes_epochs(compensator):
        return Spooled(mark, dataset, leave_out_quickly(design, config, dataset, compensator))
    found = None
    if design.uncertainty:
        handling = Handling(device=design.device)
        (found,) = leave_out_together([Original(config, dataset, compensator)], handling)
    return Spooled(mark, dataset, found if isinstance(found, LeftOut) else None)


def leave_out_quickly(
    design: Design, config: Config, dataset: Dataset, compensator: Compensator
) -> LeftOut | None:
    """Return what models say of training runs that they did not learn from, of what is fitted.

    The gate asks for it where there are no test logs, the uncertainty always.
    """
    wanted = replace(dataset, test=()) if design.uncertainty else dataset
    return leave_out(config, wanted, compensator)
