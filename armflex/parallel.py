"""Pieces of work that do not need each other, through joblib: one after the other, in processes, or on a cluster.

`with joblib.parallel_config(backend="dask"): ...` around a function of armflex that works in pieces puts them on a
`dask.distributed` cluster; nothing else changes, and neither do the results.
"""

import signal
import threading
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from functools import partial
from itertools import chain, islice
from typing import Any, TypeVar

import numpy as np

from armflex.errors import NO_ANSWER, ArmflexError

Piece = TypeVar("Piece")
Result = TypeVar("Result")

MANY = 6
"""Pieces from which threads are worth what it takes to begin them; fewer are done one after the other."""

WAVE = 32
"""Tasks for each process that are begun together. joblib begins another task whenever one ends, even if nobody takes
the results; between two waves it waits, so that what nobody took yet does not fill the memory."""

_begun: set[object] = set()
"""Code of the work that threads of this process have shared."""


def in_pieces(rows: np.ndarray, most: int) -> list[np.ndarray]:
    """Return rows, in their order, so many at most at a time."""
    return [rows[first : first + most] for first in range(0, len(rows), most)]


def in_halves(
    work: Callable[[np.ndarray], Result], rows: np.ndarray
) -> Iterator[tuple[np.ndarray, Result | ArmflexError]]:
    """Yield rows with what work makes of them together; one without an answer comes alone, with its error instead.

    Where one has none (`NO_ANSWER`) halves are asked, until it stands alone.
    """
    try:
        yield rows, work(rows)
    except tuple(NO_ANSWER.values()) as error:
        if len(rows) == 1:
            yield rows, error
        for half in np.array_split(rows, 2) if len(rows) > 1 else ():
            yield from in_halves(work, half)


def in_threads(work: Callable[[Piece], Result], pieces: Iterable[Piece]) -> Generator[Result, None, None]:
    """Yield what work makes of each piece, in their order; many pieces in a thread for each core of this process.

    Most of the work must be compiled code that lets other threads run. Pieces are taken as they are needed, two for
    each thread. Where one fails, no others are begun.
    """
    left = iter(pieces)
    first = list(islice(left, MANY))
    if len(first) < MANY or threading.current_thread() is not threading.main_thread():
        yield from map(work, chain(first, left))
        return
    from joblib import cpu_count  # takes a tenth of a second

    threads, waiting, left = cpu_count(), deque[Future[Result]](), chain(first, left)
    if _is_new(work):
        yield work(next(left))
    pool = ThreadPoolExecutor(threads)
    try:
        for piece in left:
            waiting.append(pool.submit(work, piece))
            if len(waiting) >= 2 * threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


def _is_new(work: Callable) -> bool:
    """Return whether threads of this process never shared such work: its first piece is then done before they begin.

    What work imports and compiles at its first piece is not safe in two threads: one may hold the lock of a module and
    wait for the compiler's, another the reverse.
    """
    code = getattr(work.func if isinstance(work, partial) else work, "__code__", work)
    new = code not in _begun
    _begun.add(code)
    return new


def in_order(
    tasks: Iterable[Callable[[], Result]], jobs: int | None = None, threads: bool = False
) -> Generator[Result, None, None]:
    """Yield what each task returns, in the order of the tasks; closed early, the work on the rest ends.

    A task carries its data (`functools.partial`): large arguments beside it would be put on one worker of a dask
    cluster for all the others and be lost with it, whereas a task is sent again.

    Args:
        tasks: Functions without arguments that can be sent to another process.
        jobs: Number of processes, -1 for one on each core; None for what `joblib.parallel_config` says, else one.
        threads: Whether threads will do as well, where `joblib.parallel_config` says nothing else.
    """
    from joblib import Parallel, delayed, effective_n_jobs  # takes a tenth of a second

    left, size = iter(tasks), WAVE * effective_n_jobs(jobs)  # pyright: ignore[reportArgumentType] - None is the default
    if threads:
        for first in islice(left, 1):
            if _is_new(first):
                yield _alone(first)
            else:
                left = chain([first], left)
    parallel: Any  # for what it returns depends on `return_as`
    with Parallel(n_jobs=jobs, return_as="generator", prefer="threads" if threads else None) as parallel:
        wave = list(islice(left, size))
        with _deaf_children() if size > WAVE else nullcontext():
            results = parallel(delayed(partial(_alone, task))() for task in wave)
        yield from _taken(results)
        while wave := list(islice(left, size)):
            yield from _taken(parallel(delayed(partial(_alone, task))() for task in wave))


def _taken(results: Generator[Result, None, None]) -> Iterator[Result]:
    """Yield results; where nobody takes the rest, end the work on it without joblib's advice."""
    try:
        for result in results:  # noqa: UP028 - `yield from` would close them before the warning is silenced
            yield result
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            results.close()


@contextmanager
def _deaf_children() -> Iterator[None]:
    """Ignore Ctrl-C while processes are begun, which inherit that: this one ends them, and they need not complain.

    Here it is held back meanwhile, and heard afterwards where no other thread (of BLAS) took it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    mask: Any = getattr(signal, "pthread_sigmask", lambda how, signals: ())
    held = mask(getattr(signal, "SIG_BLOCK", 0), (signal.SIGINT,))
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        mask(getattr(signal, "SIG_SETMASK", 0), held)


def _alone(task: Callable[[], Result]) -> Result:
    """Return what a task returns; pieces that it has itself stay where it is, instead of going out to all again."""
    from joblib import parallel_config

    with parallel_config(backend="sequential"):
        return task()
