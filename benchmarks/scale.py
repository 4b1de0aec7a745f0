"""A million logs on ten thousand workers, simulated event by event: what limits a batch, and what removes the limit.

python benchmarks/scale.py [--logs N] [--workers N] [-o FILE]

The parts are those of `gridslam batch --scheduler`: a client that submits jobs and writes the journal, a scheduler that
takes messages one after the other, workers, and an object store. What a log costs is the model of cost's; what a part
costs is measured (`Parts`) or that of its documentation. A part with one server is a queue, first come first served.
"""

from __future__ import annotations

import argparse
import heapq
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.evaluation.cost import DEFAULT_COSTS, Work
from gridslam.types import FloatArray
from measure import write_document
from report import table

__all__ = ["Outcome", "Parts", "main", "make_durations", "simulate"]

_RESULT = Path(__file__).resolve().parent / "results" / "scale.json"


@dataclass(frozen=True)
class Parts:
    """What each part takes, s, and how it is built."""

    submit_s: float = 3e-4
    """Of the client to hand a job over."""
    wait_per_pending_s: float = 0.0
    """To wait for any of many futures, for each of them; 0 with a queue that they are put into."""
    commit_s: float = 1.9e-4
    row_s: float = 2.2e-4
    """Of a transaction of the journal, and of each row in it (a document of 11 kB); on a local disk."""
    rows_together: int = 1000
    message_s: float = 1e-3
    """Of the scheduler for all messages of a job: Dask's documentation gives up to 1 ms."""
    request_s: float = 0.05
    """Of the object store for one request."""
    listed_together: int = 1000
    """Logs whose state is known after one request."""
    client_requests: int = 8
    """Requests of the client at a time."""
    uploads: int = 11
    """Files of a result."""
    upload_by_client: bool = False
    download_s: float = 0.15
    """Of a worker to get a log: two requests and 5 MB."""
    child_s: float = 0.03
    """Of a worker for a child beside the log itself."""
    batches: int = 1
    """Parts of the logs with a client, a scheduler and a journal of their own."""


@dataclass
class Outcome:
    """Times of a simulated batch, s, and how busy its parts were."""

    start_s: float
    wall_s: float
    ideal_s: float
    requests_per_s: float = 0.0
    busy: dict[str, float] = field(default_factory=dict)

    @property
    def bottleneck(self) -> str:
        """The part that was busy for the largest share of the time."""
        return max(self.busy, key=lambda name: self.busy[name])


def make_durations(count: int, rng: np.random.Generator) -> FloatArray:
    """CPU time of logs, s, the longest first: 10 minutes at 5 Hz in the median, a tenth longer than half an hour."""
    scans = rng.lognormal(math.log(3000.0), 1.0, count)
    typical = np.array(
        [DEFAULT_COSTS.estimate(Work(each, 0.2 * each, 30)).cpu_s for each in np.unique(scans.round(-2))]
    )
    seconds = np.interp(scans, np.unique(scans.round(-2)), typical) * rng.lognormal(0.0, 0.15, count)
    return np.sort(seconds)[::-1]


def simulate(durations: FloatArray, workers: int, parts: Parts) -> Outcome:
    """Run the batches, which share nothing but the object store, and add their requests."""
    count, own = len(durations), workers // parts.batches
    outcome = _simulate_one(durations[:: parts.batches], own, parts)
    seconds = durations + parts.download_s + parts.child_s
    if not parts.upload_by_client:
        seconds = seconds + parts.uploads * parts.request_s
    outcome.ideal_s = float(max(seconds.sum() / workers, seconds.max()))
    requests = count / parts.listed_together + count * (2 + parts.uploads)
    outcome.requests_per_s = requests / outcome.wall_s
    return outcome


def _simulate_one(durations: FloatArray, workers: int, parts: Parts) -> Outcome:
    count = len(durations)
    start = math.ceil(count / parts.listed_together) * parts.request_s / parts.client_requests
    busy = dict.fromkeys(("client", "scheduler", "workers", "uploads"), 0.0)
    free_workers = [start] * workers
    uploaders = [start] * parts.client_requests
    events: list[tuple[float, int, int]] = []  # time, kind (0: to the scheduler, 1: back to it), job
    ended: list[float] = []
    submitted = written = pending = 0
    scheduler = client = last = start
    extra = parts.download_s + parts.child_s + (0.0 if parts.upload_by_client else parts.uploads * parts.request_s)
    while written < count:
        # A round of the client: it submits what there is room for, and writes the rows that have come.
        rows = 0
        while ended and ended[0] <= client and rows < 1000:
            heapq.heappop(ended)
            rows += 1
        begun = client
        if rows:
            client += parts.commit_s * math.ceil(rows / parts.rows_together) + rows * parts.row_s
            written += rows
            pending -= rows
            if parts.upload_by_client:
                for _ in range(rows):
                    at = max(heapq.heappop(uploaders), client)
                    last = at + parts.uploads * parts.request_s
                    heapq.heappush(uploaders, last)
                    busy["uploads"] += parts.uploads * parts.request_s / parts.client_requests
        while submitted < count and pending < 2 * workers:
            client += parts.submit_s
            heapq.heappush(events, (client, 0, submitted))
            submitted += 1
            pending += 1
        client += parts.wait_per_pending_s * pending
        busy["client"] += client - begun
        # The scheduler and the workers, up to the time of the client, or until a row is there.
        while events and (events[0][0] <= client or not ended):
            at, kind, job = heapq.heappop(events)
            scheduler = max(scheduler, at) + parts.message_s / 2
            busy["scheduler"] += parts.message_s / 2
            if kind == 0:
                begin = max(heapq.heappop(free_workers), scheduler)
                seconds = float(durations[job]) + extra
                heapq.heappush(free_workers, begin + seconds)
                busy["workers"] += seconds / workers
                heapq.heappush(events, (begin + seconds, 1, job))
            else:
                heapq.heappush(ended, scheduler)
        if ended and (submitted == count or pending >= 2 * workers):
            client = max(client, ended[0])
    wall = max(client, last)
    return Outcome(start, wall, 0.0, busy={name: value / (wall - start) for name, value in busy.items()})


BUILT = Parts(wait_per_pending_s=1.4e-6, rows_together=1, listed_together=1, upload_by_client=True)
SCENARIOS = {
    "at first: a request and a commit for each log": BUILT,
    "states of logs from listings": replace(BUILT, listed_together=1000),
    "workers upload their results": replace(BUILT, listed_together=1000, upload_by_client=False),
    "rows written together, a queue of what has ended": Parts(),
    "four batches of a quarter each": Parts(batches=4),
}


def main(arguments: Sequence[str] | None = None) -> Path:
    """Simulate all scenarios, and write the file; returns its path."""
    parser = argparse.ArgumentParser(description="A million logs on ten thousand workers.")
    parser.add_argument("--logs", type=int, default=1_000_000)
    parser.add_argument("--workers", type=int, default=10_000)
    parser.add_argument("-o", "--out", type=Path, default=_RESULT)
    given = parser.parse_args(arguments)
    durations = make_durations(given.logs, np.random.default_rng(0))
    found: dict[str, Any] = {}
    rows: list[list[object]] = []
    for name, parts in SCENARIOS.items():
        began = time.perf_counter()
        outcome = simulate(durations, given.workers, parts)
        found[name] = {
            "start_s": round(outcome.start_s, 1),
            "wall_s": round(outcome.wall_s, 1),
            "ideal_s": round(outcome.ideal_s, 1),
            "requests_per_s": round(outcome.requests_per_s, 1),
            "bottleneck": outcome.bottleneck,
            "busy": {part: round(value, 3) for part, value in outcome.busy.items()},
        }
        ratio = outcome.wall_s / outcome.ideal_s
        shares = [f"{100 * outcome.busy[part]:.0f} %" for part in ("client", "scheduler", "workers", "uploads")]
        rows.append(
            [
                name,
                f"{outcome.start_s:.0f} s",
                f"{outcome.wall_s:.0f} s",
                f"{ratio:.2f}",
                *shares,
                f"{outcome.requests_per_s:.0f}",
            ]
        )
        print(name, found[name], f"{time.perf_counter() - began:.0f} s", flush=True)
    head = [
        "",
        "before the first job",
        "wall",
        "times the ideal",
        "client",
        "scheduler",
        "workers",
        "uploads",
        "requests/s",
    ]
    size = f"{given.logs} logs, {durations.mean():.1f} s each, {given.workers} workers"
    write_document(
        given.out,
        f"a discrete-event simulation, seed 0: {size}",
        scenarios=found,
        table=table(head, rows).splitlines(),
    )
    path: Path = given.out
    return path


if __name__ == "__main__":
    print(main())
