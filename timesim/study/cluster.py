"""Processes of a dask cluster as those who do the work: of this machine, or of many behind a scheduler."""

import logging
import re
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from difflib import get_close_matches
from importlib.metadata import version
from typing import Any

from timesim.study.worker import ExecutionError, default_workers

LOCAL = "local"
"""Stands for processes of this machine instead of the address of a scheduler."""

RETRIES = 2
"""Times that a chunk is tried again where it fails; that its worker dies does not count as one of them."""

PATIENCE = "15s"  # for a scheduler that does not answer

_ADDRESS = re.compile(r"[a-z]+://\S+|[^\s:/]+:[0-9]+|\[[0-9a-fA-F:.]+\]:[0-9]+")

# Ctrl-C in a terminal reaches every process; the workers of this machine are ended by the one that has started them.
_IGNORE_INTERRUPT = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"


def check_address(cluster: str, workers: int | None) -> None:
    """Refuse what is neither `LOCAL` nor the address of a scheduler, and a number of workers for the latter.

    Raises:
        ExecutionError: with what was meant.
    """
    if cluster != LOCAL and not _ADDRESS.fullmatch(cluster):
        close = get_close_matches(cluster.lower(), [LOCAL], cutoff=0.6)
        hint = f"did you mean {LOCAL}?" if close else f"give one as tcp://host:8786, or '{LOCAL}'"
        raise ExecutionError(f"cluster {cluster}: is no address of a scheduler; {hint}")
    if cluster != LOCAL and workers is not None:
        raise ExecutionError(f"workers: the cluster {cluster} has its own; leave it out, or give cluster '{LOCAL}'")


@contextmanager
def processes(cluster: str, workers: int | None) -> Iterator[Executor]:
    """The workers of a cluster. Left early, it gives up the chunks under way.

    Args:
        cluster: address of a scheduler, as ``tcp://host:8786``, or `LOCAL`.
        workers: processes of a local cluster; by default as many as this process may use processors.

    Raises:
        ExecutionError: dask is not installed, the scheduler does not answer, or its workers cannot do this work.
    """
    try:
        import distributed
    except ImportError:
        hint = "pip install 'timesim[cluster]'"
        raise ExecutionError(f"cluster {cluster}: needs the package distributed; install it with {hint}") from None
    with _quiet(), ExitStack() as stack:
        target = cluster
        if cluster == LOCAL:
            target = stack.enter_context(
                distributed.LocalCluster(
                    n_workers=default_workers() if workers is None else workers,
                    threads_per_worker=1,
                    dashboard_address=":0",
                    silence_logs=logging.CRITICAL,
                    preload=[_IGNORE_INTERRUPT],
                )
            )
        yield stack.enter_context(_connected(distributed, target))


@contextmanager
def _quiet() -> Iterator[None]:
    """Without the tracebacks that dask logs of what a campaign tells in words."""
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


@contextmanager
def _connected(distributed: Any, target: Any) -> Iterator[Executor]:
    try:
        client = distributed.Client(target, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        hint = "give the address of a running scheduler, as tcp://host:8786, or 'local'"
        raise ExecutionError(f"cluster {target} cannot be reached: {error}; {hint}") from error
    with client:
        _check_workers(client, str(target))
        executor = client.get_executor(retries=RETRIES, pure=False)
        try:
            yield executor
        finally:
            executor.shutdown(wait=False)


def _check_workers(client: Any, name: str) -> None:
    """Every worker must do the work as this process would."""
    found = client.run(version, "timesim", on_error="return")
    if not found:
        raise ExecutionError(f"cluster {name} has no workers; start some with: dask worker ADDRESS")
    own = version("timesim")
    for worker, theirs in found.items():
        if theirs != own:
            told = f"has timesim {theirs}" if isinstance(theirs, str) else "has no timesim"
            raise ExecutionError(
                f"cluster {name}: worker {worker} {told}, this is {own}; install the same on all workers"
            )
