"""All benches' work on local processes or a Dask cluster; each result is kept as soon as it is there, so that a run
that was cut off goes on where it was.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from fiohost.errors import ConfigError, FiohostError
from fiohost.files import make_folder
from fiohost.fleet.benches import Bench, key_of
from fiohost.fleet.work import SCHEMA, Settings, work
from fiohost.strict_json import plain
from fiohost.workers import one_thread

KEPT = "benches"
# A bench whose worker is lost so often is what kills it: it is given up, and said.
MOST_LOST = 3
# So many benches are with the workers at once for each of them: their logs are in memory.
AHEAD = 4

Job = tuple[Bench, str, dict[str, bytes]]


def run_fleet(
    benches: Sequence[Bench],
    out: Path,
    settings: Settings,
    *,
    processes: int = 1,
    scheduler: str | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> list[dict[str, Any]]:
    """Results of all benches, in their order: those kept in ``out`` from before, and those made now. Raises
    FiohostError.
    """
    folder = out / KEPT
    make_folder(folder)
    results: dict[str, dict[str, Any]] = {}
    waiting: list[tuple[Bench, str]] = []
    for place, bench in enumerate(benches):
        try:
            key = key_of(bench.contents(), f"{SCHEMA} {settings.text}")
        except FiohostError as exc:
            results[bench.name] = {"bench": bench.name, "error": str(exc), "seconds": 0.0, "cpu_s": 0.0}
            continue
        kept = _kept(_file(folder, place, bench), key)
        if kept is not None:
            results[bench.name] = kept
        else:
            waiting.append((bench, key))
    if results:
        say(f"{len(results)} of {len(benches)} benches are there already")
    places = {bench.name: place for place, bench in enumerate(benches)}
    ways = _on_cluster(waiting, settings, scheduler) if scheduler else _locally(waiting, settings, processes)
    for bench, key, row in ways:
        results[bench.name] = row
        _keep(_file(folder, places[bench.name], bench), row | {"key": key})
        say(f"{len(results)} of {len(benches)}: {bench.name} {row.get('error') or row.get('verdict') or 'fitted'}")
    return [results[b.name] | {"said": {**results[b.name].get("metadata", {}), **b.said}} for b in benches]


def _file(folder: Path, place: int, bench: Bench) -> Path:
    safe = "".join(c if c.isalnum() or c in "-_." else "_" for c in bench.name)[:80]
    return folder / f"{place:05d}-{safe}.json"


def _kept(path: Path, key: str) -> dict[str, Any] | None:
    try:
        row = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return row if isinstance(row, dict) and row.get("key") == key else None


def _keep(path: Path, row: Mapping[str, Any]) -> None:
    """Whole or not at all. Raises FiohostError."""
    try:
        fd, temporary = tempfile.mkstemp(prefix=".fiohost-", dir=path.parent)
        with os.fdopen(fd, "w", encoding="utf-8") as stream:
            json.dump(plain(dict(row)), stream)
        os.replace(temporary, path)
    except OSError as exc:
        raise FiohostError(f"cannot write {path}: {exc.strerror}") from exc


def _lost(bench: Bench) -> dict[str, Any]:
    text = f"its worker ended {MOST_LOST} times without a result"
    return {"bench": bench.name, "error": text, "seconds": 0.0, "cpu_s": 0.0}


def _locally(
    waiting: Sequence[tuple[Bench, str]], settings: Settings, processes: int
) -> Iterator[tuple[Bench, str, dict[str, Any]]]:
    """On processes of this machine; one that ends takes no result with it but its own, which is made again."""
    left = list(waiting)
    losses = {bench.name: 0 for bench, _ in left}
    most = processes * AHEAD
    while left:
        batch, left = left, []
        broken = False
        alone = one_thread if processes > 1 else None
        with ProcessPoolExecutor(processes, get_context("spawn"), alone) as pool:
            running: dict[Any, tuple[Bench, str]] = {}
            queue = iter(batch)
            _fill(pool, running, queue, most, settings)
            while running:
                done = next(as_completed(running))
                bench, key = running.pop(done)
                try:
                    row = done.result()
                except BrokenProcessPool:
                    broken = True
                    left.append((bench, key))
                    continue
                yield bench, key, row
                if not broken:
                    _fill(pool, running, queue, most, settings)
            under_way = [bench.name for bench, _ in left]
            left += list(queue)
        if broken:  # it is not known which of those under way ended the process: one by one shows it
            for name in under_way:
                losses[name] += 1
            for job in [job for job in left if losses[job[0].name] >= MOST_LOST]:
                left.remove(job)
                yield job[0], job[1], _lost(job[0])
            most = 1 if max(losses.values()) > 1 else processes * AHEAD


def _fill(
    pool: ProcessPoolExecutor, running: dict[Any, tuple[Bench, str]], queue: Iterator[tuple[Bench, str]], most: int,
    settings: Settings,
) -> None:  # fmt: skip
    """Give the processes work, as far as there is some, up to so much at once."""
    while len(running) < most and (job := next(queue, None)) is not None:
        bench = job[0]
        future: Future[dict[str, Any]] = Future()
        try:
            future = pool.submit(work, bench.name, bench.contents(), len(bench.logs), settings)
        except BrokenProcessPool as exc:  # what is under way says so too
            future.set_exception(exc)
        running[future] = job


def _on_cluster(
    waiting: Sequence[tuple[Bench, str]], settings: Settings, address: str
) -> Iterator[tuple[Bench, str, dict[str, Any]]]:
    """On a Dask cluster, which gives the work of a worker that ended to another one."""
    try:
        distributed: Any = import_module("distributed")
    except ImportError:
        raise ConfigError("a cluster needs Dask: pip install 'fiohost[dask]'") from None
    try:
        client = distributed.Client(address, timeout=10)
    except (OSError, ValueError) as exc:
        raise ConfigError(f"no Dask scheduler answers at {address[:80]}: {exc}") from exc
    with client:
        many = max(1, len(client.scheduler_info().get("workers", {}))) * AHEAD
        queue, running = iter(waiting), distributed.as_completed()
        jobs: dict[Any, tuple[Bench, str]] = {}

        def submit() -> None:
            job = next(queue, None)
            if job is None:
                return
            bench = job[0]
            future = client.submit(
                work, bench.name, bench.contents(), len(bench.logs), settings, pure=False, retries=MOST_LOST
            )
            jobs[future.key] = job
            running.add(future)

        for _ in range(many):
            submit()
        for future in running:
            bench, key = jobs.pop(future.key)
            row = future.result() if future.status == "finished" else _lost(bench)
            future.release()
            yield bench, key, row
            submit()
