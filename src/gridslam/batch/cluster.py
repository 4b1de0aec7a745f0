"""The executor of a cluster: dask.distributed, whose workers import `run_job` and exchange JSON with it."""

from __future__ import annotations

import asyncio
import logging
import re
import time
import uuid
from concurrent.futures import Future
from contextlib import suppress
from typing import TYPE_CHECKING, Any, cast, final

from gridslam.batch.child import LostWorkerError, run_job
from gridslam.errors import ConfigurationError, InputError, MissingDependencyError, OutputError
from gridslam.io.text import read_json

if TYPE_CHECKING:
    import distributed

__all__ = ["DaskCluster"]

_CONNECT_S = 5.0
_COUNT_EVERY_S = 5.0


@final
class DaskCluster:
    """Runs jobs on the workers of a Dask scheduler; an `Executor`.

    Workers need gridslam in the same version, and OUT and the logs under the same paths. A job whose worker is lost is
    repeated by the scheduler or by `run_jobs`; both count as attempts.

    Parameters
    ----------
    scheduler : str
        Address, such as tcp://host:8786 or tls://host:8786; or the scheduler's file (JSON, as ``dask
        scheduler --scheduler-file`` writes it).

    Attributes
    ----------
    dashboard : str
        Address of the dashboard; empty if there is none.

    Raises
    ------
    ConfigurationError
        The scheduler does not answer within 5 s, or the file is none of these.
    MissingDependencyError
        dask.distributed is not installed.
    """

    def __init__(self, scheduler: str) -> None:
        """Connect to the scheduler."""
        try:
            import distributed  # noqa: F401
        except ImportError:
            raise MissingDependencyError("--scheduler", "dask.distributed", "cluster") from None
        for name in ("distributed", "tornado"):  # what they log is no news to the user; what matters is raised
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self._connection = _connect(scheduler)
        self._scheduler = scheduler
        self._capacity = 0
        self._counted_s = -_COUNT_EVERY_S
        self._tasks = dict[Future[dict[str, Any]], Any]()
        has_dashboard = "dashboard" in self._connection.scheduler_info()["services"]
        self.dashboard = str(self._connection.dashboard_link) if has_dashboard else ""

    def __enter__(self) -> DaskCluster:
        """Return the executor itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """Cancel pending jobs and disconnect; children that still run end within seconds."""
        self.close()

    def close(self) -> None:
        """Disconnect."""
        with suppress(Exception):  # the scheduler may be gone
            self._connection.cancel(list(self._tasks.values()), force=True)
        self._tasks.clear()
        with suppress(Exception):
            self._connection.close(timeout=_CONNECT_S)

    def capacity(self) -> int:
        """Return twice the number of the workers' threads, so that none waits for its next job."""
        now = time.monotonic()
        if now >= self._counted_s + _COUNT_EVERY_S:
            try:
                self._capacity = 2 * sum(cast("dict[str, int]", self._connection.nthreads()).values())
            except Exception:
                raise OutputError(self._lost()) from None
            self._counted_s = now
        return max(self._capacity, 1)

    def submit(self, job: dict[str, Any], limits: dict[str, Any]) -> Future[dict[str, Any]]:
        """Hand a job over to the scheduler."""
        name = f"{job['command']}-{job['folder']}-{uuid.uuid4().hex[:8]}"
        try:
            task = self._connection.submit(run_job, job, limits, key=name, pure=False)
        except Exception:
            raise OutputError(self._lost()) from None
        future = Future[dict[str, Any]]()
        future.set_running_or_notify_cancel()
        self._tasks[future] = task
        task.add_done_callback(lambda ended: self._pass_on(ended, future))
        return future

    def _pass_on(self, task: distributed.Future, future: Future[dict[str, Any]]) -> None:
        """Give the result of a task, or its exception, to the future."""
        from distributed.scheduler import KilledWorker

        self._tasks.pop(future, None)
        try:
            row = task.result(timeout=_CONNECT_S)
        except (KilledWorker, LostWorkerError) as error:
            future.set_exception(LostWorkerError(str(error)))
        except ModuleNotFoundError as error:
            future.set_exception(ConfigurationError(f"{self._scheduler}: a worker cannot run gridslam: {error}"))
        except BaseException as error:
            lost = task.status in ("cancelled", "lost")
            future.set_exception(OutputError(self._lost()) if lost else error)
        else:
            future.set_result(row)

    def _lost(self) -> str:
        return f"{self._scheduler}: the connection to the scheduler is lost; the same command again continues"


def _connect(scheduler: str) -> distributed.Client:
    from distributed import Client

    address = scheduler
    if not re.fullmatch(r"\w+://.+|[^/\\]+:\d+", scheduler):
        address = _read_address(scheduler)
    try:
        asyncio.run(_greet(address))
        return Client(address, timeout=_CONNECT_S, set_as_default=False)
    except ValueError as error:
        raise ConfigurationError(f"--scheduler {scheduler}: {error}") from None
    except Exception:
        problem = f"no Dask scheduler answers within {_CONNECT_S:g} s"
        if address.startswith("tls:"):
            problem += " and accepts this machine's certificate (distributed.comm.tls in ~/.config/dask)"
        raise ConfigurationError(f"--scheduler {scheduler}: {problem}") from None


def _read_address(path: str) -> str:
    """Read the address in a scheduler's file."""
    address = read_json(path).get("address")
    if not isinstance(address, str):
        raise InputError(path, "expected a scheduler's file, with an address")
    return address


async def _greet(address: str) -> None:
    """Exchange greetings with a scheduler; raises an exception of any type where there is none."""
    from distributed import Security
    from distributed.comm.core import connect

    answer = connect(address, timeout=_CONNECT_S, **Security().get_connection_args("client"))
    comm = await asyncio.wait_for(answer, _CONNECT_S)
    await comm.close()
