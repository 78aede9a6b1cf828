"""Independent tasks spread over MPI ranks: each rank takes the next one as soon as it is free."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import numpy as np
from mpi4py import MPI

Task = TypeVar("Task")
Result = TypeVar("Result")


def share_tasks(
    tasks: Sequence[Task],
    work: Callable[[Task], Result],
    comm: MPI.Comm = MPI.COMM_SELF,
    report: Callable[[int], None] | None = None,
) -> list[Result]:
    """Does every task on one rank or other, and hands all results to every rank; collective.

    Which rank does a task is a matter of chance, so that a task's result must not depend on any other's.

    Args:
        tasks: The same on every rank.
        work: Does one task; its result must be picklable.
        comm: The ranks.
        report: Called on each rank as it begins a task, with the number of those that are surely done.

    Returns:
        Results in the order of the tasks, on every rank.

    Raises:
        Exception: What ``work`` or ``report`` raised first, on every rank; as text where it cannot be pickled.
    """
    mine: dict[int, Result] = {}
    error: Exception | None = None
    take = _Counter(comm)
    while error is None and (k := take(1)) < len(tasks):
        try:
            if report:
                report(max(len(mine), k - (comm.size - 1)))  # the other ranks are at one each
            mine[k] = work(tasks[k])
        except Exception as caught:
            error = caught
            take(len(tasks))  # nobody need begin another
    take.free()  # not where this is interrupted: it waits for the other ranks, which would do all the tasks first
    _raise_together(error, comm)
    done = {k: result for results in comm.allgather(mine) for k, result in results.items()}
    return [done[k] for k in range(len(tasks))]


def share_steps(
    tasks: Sequence[Task],
    begun: Sequence[Result],
    go_on: Callable[[Task, Result], Iterable[Result]],
    count: Callable[[Task, Result], int],
    sizes: Sequence[int],
    comm: MPI.Comm,
    report: Callable[[int], None],
) -> list[Result]:
    """Brings every task to its end, step by step from the state that it is in; collective, as ``share_tasks``.

    Args:
        tasks: The same on every rank.
        begun: State of each task, the same on every rank.
        go_on: The states of a task after a given one, up to its end.
        count: How many points of a task are done in a state.
        sizes: Points of each task.
        comm: The ranks.
        report: Called on each rank as it begins a task or has done a step, with the number of points of all tasks that
            are done.

    Returns:
        The last state of each task, on every rank.

    Raises:
        Exception: As ``share_tasks``.
    """
    done = [count(task, state) for task, state in zip(tasks, begun, strict=True)]
    left = [k for k, size in enumerate(sizes) if done[k] < size]
    before = np.cumsum([sum(done), *(sizes[k] - done[k] for k in left)]).tolist()  # by how many tasks are done
    now = before[0]

    def begin(number: int) -> None:
        nonlocal now
        now = before[number]
        report(now)

    def bring_to_end(k: int) -> Result:
        state = begun[k]
        for state in go_on(tasks[k], begun[k]):
            report(now + count(tasks[k], state) - done[k])
        return state

    ends = dict(zip(left, share_tasks(left, bring_to_end, comm, begin), strict=True))
    return [ends.get(k, state) for k, state in enumerate(begun)]


def do_together(action: Callable[[], Result], comm: MPI.Comm) -> Result:
    """Does something on every rank; collective.

    Returns:
        What it came to on this rank.

    Raises:
        Exception: What it raised on any rank, on every one: so that none waits for another that is gone.
    """
    result, error = None, None
    try:
        result = action()
    except Exception as caught:
        error = caught
    _raise_together(error, comm)
    return result


def do_on_rank_zero(action: Callable[[], Result], comm: MPI.Comm) -> Result:
    """Does something on rank 0 alone; collective.

    Returns:
        What it came to, on every rank.

    Raises:
        Exception: What it raised, on every rank.
    """
    return comm.bcast(do_together(lambda: action() if comm.rank == 0 else None, comm))


def _raise_together(error: Exception | None, comm: MPI.Comm) -> None:
    if error is not None and comm.size == 1:
        raise error
    failed = [caught for caught in comm.allgather(_make_portable(error)) if caught is not None]
    if failed:
        raise failed[0] from error


def _make_portable(error: Exception | None) -> Exception | None:
    """The error as one that other ranks can be sent; what they wait for must come, whatever it is."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


class _Counter:
    """A counter that all ranks share: ``counter(n)`` adds n and returns what it was before."""

    def __init__(self, comm: MPI.Comm):
        self._window = None
        self._value = np.zeros(1, dtype=np.int64)
        if comm.size > 1:
            self._window = MPI.Win.Allocate(8 if comm.rank == 0 else 0, 8, comm=comm)
            if comm.rank == 0:
                self._window.Lock(0)
                np.frombuffer(self._window, dtype=np.int64)[0] = 0
                self._window.Unlock(0)
            comm.Barrier()

    def __call__(self, amount: int) -> int:
        before = self._value.copy()
        if self._window is None:
            self._value += amount
        else:
            self._window.Lock(0)
            self._window.Fetch_and_op(np.array([amount], dtype=np.int64), before, 0)
            self._window.Unlock(0)
        return int(before[0])

    def free(self) -> None:
        if self._window is not None:
            self._window.Free()
