"""Engine `ray`: the same map as Ray core tasks, on a running cluster or on a new one on this machine.

Ray is imported only in this module, and only when requested. It repeats the tasks of a lost worker or machine
(`max_retries`). Workers import cyclekit: it must be installed on every machine, in the same version.
"""

from __future__ import annotations

import logging
import os
import socket
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclekit.errors import EngineError
from cyclekit.extras import need
from cyclekit.parallel.outcome import ONE_THREAD, RETRIES, Done, cores, in_chunks, outcomes, packed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

_AHEAD = 2
"""Number of chunks at the cluster per worker, so that a worker finds the next one when it is done."""
_REACH_S = 5.0


def map_in_cluster(
    function: Callable[[Any], Any], items: Sequence[Any], jobs: int | None, address: str | None
) -> Iterator[Done[Any, Any]]:
    """Run `Engine.map` on Ray."""
    if not items:
        return
    ray = _connected(jobs, address)
    workers = min(jobs or len(items), max(int(ray.cluster_resources().get("CPU", 1)), 1))
    ahead = workers if jobs else _AHEAD * workers  # never more than `jobs`
    task = ray.remote(num_cpus=1, max_retries=RETRIES)(_task)
    told = (packed(function), str(Path.cwd()), version("cyclekit"))
    waiting = in_chunks(len(items), workers)[::-1]
    under_way: dict[Any, list[int]] = {}
    try:
        while waiting or under_way:
            while waiting and len(under_way) < ahead:
                chunk = waiting.pop()
                under_way[task.remote([items[number] for number in chunk], *told)] = chunk
            ready, _ = ray.wait(list(under_way), num_returns=1)
            chunk = under_way.pop(ready[0])
            try:
                done = ray.get(ready[0])
            except ray.exceptions.RayError as error:
                if len(chunk) > 1:  # one of them kills workers: retry each alone
                    waiting.extend([number] for number in chunk)
                else:
                    yield Done(chunk[0], items[chunk[0]], None, _gave_up(error))
                continue
            for number, outcome in zip(chunk, done, strict=True):
                yield Done(number, items[number], *outcome)
    finally:
        for reference in under_way:
            ray.cancel(reference, force=True)


def _task(items: Sequence[Any], function: bytes, folder: str, theirs: str) -> list[tuple[Any, Exception | None]]:
    """Process a chunk of items in a Ray worker, after setting its environment and before heavy imports."""
    os.environ.update(ONE_THREAD)
    with suppress(OSError):
        os.chdir(folder)  # on a machine without it, paths must be absolute
    if (ours := version("cyclekit")) != theirs:
        seen = f"{socket.gethostname()} has cyclekit {ours} installed, but the work was sent by cyclekit {theirs}"
        return [(None, EngineError(seen, cure="Install the same version on every machine.")) for _ in items]
    return list(outcomes(function, items))


def _connected(jobs: int | None, address: str | None) -> Any:  # noqa: ANN401 - the module of a package without types
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # before the import, else Ray reports usage
    if address not in (None, "auto") and (Path.home() / ".ray" / "auth_token").is_file():
        os.environ.setdefault("RAY_AUTH_MODE", "token")  # as Ray does for a cluster found automatically
    need("--engine ray", "ray")
    import ray

    if ray.is_initialized():
        return ray
    if address is None:
        level = logging.ERROR
        ray.init("local", num_cpus=jobs or cores(), include_dashboard=False, logging_level=level, log_to_driver=False)
        return ray
    _reach(address)
    try:
        ray.init(address=address, logging_level=logging.ERROR, log_to_driver=False)
    except (ConnectionError, RuntimeError, ValueError, TimeoutError, ray.exceptions.RayError) as error:
        raise _out_of_reach(address, str(error).strip().partition("\n")[0]) from error
    return ray


def _reach(address: str) -> None:
    """Raise an error at once for an address without a listener; Ray would retry for minutes.

    Raises:
        EngineError: No process listens there, or it is not an address.
    """
    if address == "auto" or "://" in address:
        return
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=_REACH_S).close()
    except (OSError, ValueError) as error:
        raise _out_of_reach(address, str(error)) from error


def _out_of_reach(address: str, why: str) -> EngineError:
    cure = "Start one with `ray start --head`, and give --ray-address auto there or HOST:6379 elsewhere."
    return EngineError(f"no Ray cluster can be reached at {address!r} ({why})", cure=cure)


def _gave_up(error: Exception) -> EngineError:
    seen = f"its worker was lost {RETRIES + 1} times ({type(error).__name__})"
    return EngineError(seen, cure="Often memory is too small: give fewer --jobs, or use machines with more memory.")
