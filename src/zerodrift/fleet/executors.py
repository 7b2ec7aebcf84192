"""Where batches of sensors are worked on: here, in processes beside this one, or over Ray."""

import multiprocessing
import os
import signal
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from types import ModuleType
from typing import TYPE_CHECKING, Protocol

from zerodrift.base.errors import CheckError, InputError
from zerodrift.base.extras import FLEET, tell_install
from zerodrift.base.threads import BLAS
from zerodrift.fleet.design import Design
from zerodrift.fleet.result import SensorOutcome
from zerodrift.fleet.sensors import names_urls

if TYPE_CHECKING:
    from zerodrift.fleet.block_work import BlockRun
    from zerodrift.fleet.parcels import Delivery, Parcel

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
            self._jobs, context, initializer=_ignore_interrupts
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
