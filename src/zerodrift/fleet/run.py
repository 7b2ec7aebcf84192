"""A fleet from its directory to results: batches, where they go, and what is written at the end."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Protocol

from zerodrift.base.config import locate_key
from zerodrift.base.errors import CheckError, InputError, ZerodriftError
from zerodrift.base.extras import FLEET, tell_install
from zerodrift.base.files import refuse_foreign
from zerodrift.base.fleet_config import PLACEHOLDER, SHARED_RUNTIME
from zerodrift.base.journal import write_all
from zerodrift.base.threads import BLAS
from zerodrift.c_runtime.compilers import RUNTIME_FILES
from zerodrift.codegen.identifiers import sanitize_prefix
from zerodrift.fleet.parcels import at_hand
from zerodrift.fleet.result import RESULT, SensorOutcome, SensorResult, load_result
from zerodrift.fleet.sensors import Design, configure_sensor, find_sensors, names_urls
from zerodrift.verify.manifest import check_manifest

if TYPE_CHECKING:
    from zerodrift.fleet.block_work import BlockRun
    from zerodrift.fleet.parcels import Delivery, Parcel


# Where batches of sensors are worked on: here, in processes beside this one, or over Ray.

Batch = tuple[str, ...]
ONE_THREAD = (*BLAS, "POLARS_MAX_THREADS")
"""Set to 1 in workers, so that as many processes as cores do not fight over them."""
RETRIES = 2
"""How often a batch is begun again whose worker died."""
AHEAD = 2
"""Batches that are sent for each core of a cluster, so that none waits and few are in memory."""


class Executor(Protocol):
    """What works on batches of sensors."""

    def run(
        self, design: "Design | BlockRun", batches: Sequence[Batch]
    ) -> Generator[list[SensorOutcome], None, None]:
        """Yield the outcomes of each batch as it is done, in any order.

        Args:
            design: the first pass; or the second, in which blocks are tried in the one program.
            batches: sensors' names.
        """
        ...

    def close(self) -> None:
        """End what was kept for another run."""
        ...


def work_here(run: "Design | BlockRun", sensors: Batch) -> list[SensorOutcome]:
    """Work on a batch where the project's files are, and write its results."""
    if names_urls((run if isinstance(run, Design) else run.design).config):
        from zerodrift.fleet.parcels import deliver, pack

        parcel, failed = pack(run, sensors)
        return [*failed, *deliver(run, work_away(parcel))]
    return work_on_batch(run, sensors)


def work_away(parcel: "Parcel") -> "list[Delivery]":
    """Work on a batch that came with all of its files, and return those that it made."""
    from zerodrift.fleet.parcels import work_on_parcel

    return work_on_parcel(parcel, work_on_batch)


def work_on_batch(run: "Design | BlockRun", sensors: Batch) -> list[SensorOutcome]:
    """Work on a batch; what that takes is loaded only where it is done."""
    if isinstance(run, Design):
        from zerodrift.fleet.work import work_on

        return work_on(run, sensors)
    from zerodrift.fleet.block_work import try_units

    return try_units(run, sensors)


class Serial:
    """In this process, one batch after the other."""

    def run(
        self, design: "Design | BlockRun", batches: Sequence[Batch]
    ) -> Generator[list[SensorOutcome], None, None]:
        """Yield the outcomes batch by batch."""
        for batch in batches:
            yield work_here(design, batch)

    def close(self) -> None:
        """Nothing was kept."""


class Processes:
    """In processes of this machine, which are kept for another run until they are closed."""

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._pool: ProcessPoolExecutor | None = None

    def run(
        self, design: "Design | BlockRun", batches: Sequence[Batch]
    ) -> Generator[list[SensorOutcome], None, None]:
        """Yield the outcomes batch by batch; leaving the loop ends the processes.

        Raises:
            CheckError: a process died, as when memory runs out.
        """
        before = {name: os.environ.get(name) for name in ONE_THREAD}
        os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
        # A fork would take along threads of Polars and PyTorch that no longer run.
        context = multiprocessing.get_context("spawn")
        pool = self._pool or ProcessPoolExecutor(
            self._jobs, mp_context=context, initializer=_ignore_interrupts
        )
        self._pool = pool
        pending: set[Future[list[SensorOutcome]]] = set()
        is_whole = False
        try:
            pending = {pool.submit(work_here, design, batch) for batch in batches}
            while pending:
                done, pending = wait(pending, return_when=FIRST_COMPLETED)
                for future in done:
                    yield future.result()
            is_whole = True
        except BrokenProcessPool as error:
            raise CheckError(
                "a worker process ended unexpectedly, most likely for lack of memory. Sensors that"
                " were done are kept: the same command goes on; try fewer --jobs or a smaller"
                " --batch."
            ) from error
        finally:
            for process in list((getattr(pool, "_processes", None) or {}).values()):
                if pending:  # left early: what has begun need not be finished
                    process.terminate()
            if not is_whole:
                self.close()
            for name, value in before.items():
                if value is None:
                    os.environ.pop(name, None)
                else:
                    os.environ[name] = value

    def close(self) -> None:
        """End the processes."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None


def _ignore_interrupts() -> None:
    """Leave Ctrl-C to the main process, which ends the workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class OverRay:
    """On a Ray cluster, to which files are sent; or in processes of Ray's on this machine."""

    def __init__(self, address: str | None, jobs: int) -> None:
        """Take where to work.

        Args:
            address: of the cluster; None starts Ray on this machine for this run.
            jobs: cores of this machine to use, where Ray is started here.
        """
        self._address, self._jobs = address, jobs

    def run(
        self, design: "Design | BlockRun", batches: Sequence[Batch]
    ) -> Generator[list[SensorOutcome], None, None]:
        """Yield the outcomes batch by batch.

        Raises:
            InputError: Ray is not installed, or there is no cluster at the address.
            CheckError: the cluster went away.
        """
        ray = import_ray()
        self._connect(ray)
        try:
            yield from (
                _share(ray, design, batches)
                if self._address is None
                else _send(ray, design, batches)
            )
        except _list_ray_errors(ray) as error:
            raise CheckError(
                "the Ray cluster went away or a worker died"
                f" ({type(error).__name__}: {_first_line(error)}). Sensors that were done are"
                " kept: the same command goes on with the others, with --ray or without."
            ) from error
        finally:
            ray.shutdown()

    def close(self) -> None:
        """Nothing was kept."""

    def _connect(self, ray: ModuleType) -> None:
        options: dict[str, object] = {"log_to_driver": False, "logging_level": "ERROR"}
        if self._address is None:
            options |= {"num_cpus": self._jobs, "include_dashboard": False}
        else:
            options |= {"address": self._address}
        environment = dict.fromkeys(ONE_THREAD, "1")
        os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
        try:
            ray.init(**options, runtime_env={"env_vars": environment})
        except (ConnectionError, RuntimeError, ValueError) as error:
            where = self._address or "this machine"
            raise InputError(
                f"Ray cannot be reached at {where}: {_first_line(error)}. Start a cluster with"
                " `ray start --head`, correct --ray-address, or leave it out to run Ray here."
            ) from error


def _share(
    ray: ModuleType, run: "Design | BlockRun", batches: Sequence[Batch]
) -> Iterator[list[SensorOutcome]]:
    """Yield the outcomes of workers that see the project's files, and write their own."""
    task = ray.remote(num_cpus=1, max_retries=RETRIES)(work_here)
    shared = ray.put(run)
    pending = [task.remote(shared, batch) for batch in batches]
    while pending:
        done, pending = ray.wait(pending, num_returns=1)
        yield ray.get(done[0])


def _send(
    ray: ModuleType, run: "Design | BlockRun", batches: Sequence[Batch]
) -> Iterator[list[SensorOutcome]]:
    """Yield the outcomes of workers that see no file of this machine; write what they return."""
    from zerodrift.fleet.parcels import deliver, pack

    task = ray.remote(num_cpus=1, max_retries=RETRIES)(work_away)
    waiting = list(reversed(batches))
    pending: list[object] = []
    while waiting or pending:
        most = AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)))
        while waiting and len(pending) < most:
            parcel, failed = pack(run, waiting.pop())
            if failed:
                yield failed
            if parcel.sensors:
                pending.append(task.remote(parcel))
        if pending:
            done, pending = ray.wait(pending, num_returns=1)
            yield deliver(run, ray.get(done[0]))


def import_ray() -> ModuleType:
    """Return the module.

    Raises:
        InputError: it is not installed.
    """
    try:
        import ray
    except ImportError as error:
        raise InputError(
            f"--ray needs Ray, which is not installed. Run: {tell_install(FLEET.name)}. Without it,"
            " --jobs uses this machine's cores."
        ) from error
    module: ModuleType = ray
    return module


def _list_ray_errors(ray: ModuleType) -> tuple[type[BaseException], ...]:
    return (ray.exceptions.RayError, ConnectionError, OSError)


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or ["no reason given"])[0]


# A fleet from its directory to results: batches, where they go, and what is written at the end.

BATCH = 32
"""Sensors in a batch: compiled together, and with a network trained together."""


@dataclass(frozen=True)
class FleetProgress:
    """Where a fleet stands, for a bar."""

    done: int
    total: int
    kept: int
    failed: int


def run_fleet(
    design: Design,
    executor: Executor,
    *,
    jobs: int = 1,
    batch: int | None = None,
    fresh: bool = False,
    report: Callable[[FleetProgress], None] = lambda _: None,
) -> tuple[SensorOutcome, ...]:
    """Return the outcome of every sensor, sorted by name.

    Args:
        design: what they share.
        executor: where the work is done.
        jobs: processes that want work at the same time.
        batch: sensors in a batch; by default as many as are worth it.
        fresh: compute anew what is kept.
        report: called whenever a batch is done.

    Raises:
        InputError: zerodrift.toml does not say where the sensors are.
        CheckError: the executor was lost; finished results are kept.
    """
    sensors = find_sensors(design.config)
    refuse_equal_prefixes(design, sensors)
    if design.firmware:
        write_runtime(design)
    outcomes: dict[str, SensorOutcome] = {}

    def tell() -> None:
        kept = sum(o.kept for o in outcomes.values())
        failed = sum(o.result is None for o in outcomes.values())
        report(FleetProgress(len(outcomes), len(sensors), kept, failed))

    tell()
    for sensor in () if fresh else sensors:
        kept = find_kept(design, sensor)
        if kept is not None:
            outcomes[sensor] = SensorOutcome(sensor, kept, kept=True)
            tell()
    left = [sensor for sensor in sensors if sensor not in outcomes]
    batches = cut_batches(left, jobs, batch)
    if batches:
        with closing(executor.run(design, batches)) as found:
            for part in found:
                outcomes |= {outcome.sensor: outcome for outcome in part}
                tell()
    return tuple(outcomes[sensor] for sensor in sensors)


def cut_batches(sensors: Sequence[str], jobs: int, batch: int | None) -> list[Batch]:
    """Return the sensors in batches, as many in each as are worth it unless that is told."""
    size = batch or max(1, min(BATCH, -(-len(sensors) // jobs)))
    return [tuple(sensors[i : i + size]) for i in range(0, len(sensors), size)]


def refuse_equal_prefixes(design: Design, sensors: Sequence[str]) -> None:
    """Refuse prefixes that are equal for two sensors.

    Raises:
        InputError: two sensors' C would have the same names.
    """
    text = design.config.firmware_prefix
    if PLACEHOLDER not in text:
        return
    taken: dict[str, str] = {}
    for sensor in sensors:
        prefix = sanitize_prefix(text.replace(PLACEHOLDER, sensor))
        if prefix in taken:
            where = locate_key(design.config.path, "firmware", "prefix")
            raise InputError(
                f"{where}: sensors {taken[prefix]} and {sensor} would both be '{prefix}' in the C;"
                " expected prefixes that differ in their first 31 letters and digits. Shorten the"
                " prefix, or rename a sensor."
            )
        taken[prefix] = sensor


def find_kept(design: Design, sensor: str) -> SensorResult | None:
    """Return a sensor's result if neither its logs, nor the design, nor its files have changed."""
    folder = design.build_folder(sensor)
    if not (folder / RESULT).is_file():
        return None
    try:
        config = configure_sensor(design.config, sensor)
        with at_hand(design, sensor) as near:
            mark = near.mark_sensor(configure_sensor(near.config, sensor))
        kept = load_result(folder, design.directory, mark)
        if kept is None or not design.firmware:
            return kept
        if kept.refused and kept.forced != design.force:
            return None
        if (kept.refused and not kept.forced) or design.in_block:
            return kept
        place = design.firmware_folder(sensor)  # logs and design are in the mark
        check = check_manifest(config, folder=place, build=folder, wants_inputs=False)
    except (ZerodriftError, OSError):
        return None  # told when it is worked on
    return None if check.manifest is None or check.findings else kept


def write_runtime(design: Design) -> None:
    """Write the C that all sensors share, where it differs from what is there.

    Raises:
        InputError: a file that zerodrift did not write stands in the place of one.
    """
    folder = design.config.firmware_out / SHARED_RUNTIME
    contents = {folder / path.name: path.read_bytes() for path in RUNTIME_FILES}
    changed = {
        target: content
        for target, content in contents.items()
        if not target.is_file() or target.read_bytes() != content
    }
    refuse_foreign(changed, folder)
    write_all(design.directory, changed)
