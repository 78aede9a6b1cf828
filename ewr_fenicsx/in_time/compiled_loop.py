"""The compiled loop over a period: step after step, each with its contact impulses.

Projected Gauss-Seidel finds them, pair by pair, started from those of the last two steps. Where many pairs stick and
move one another, sweeps close in slowly: from the tenth on, Anderson's extrapolation combines the last ones so that the
next would change least, were it linear. The laws are written again here, apart from the folder ``laws``.

Source: Walker & Ni (2011), doi:10.1137/10078356X, for the extrapolation.
"""

from __future__ import annotations

from functools import cache

import numpy as np

UNILATERAL, BILATERAL, FRICTION = 0, 1, 2
SLOW, WINDOW = 10, 8  # sweeps from which on they are extrapolated, and so many that this looks back on
STRAYED, ROUNDING = 4.0, 1e-10  # times the square of a change before, from which on it starts anew; rounding in it
FAR = 100.0  # times the largest change, up to which impulses are moved: what drifts on would be moved anywhere
# Times the tolerance, up to which an impulse, and so all others, are left as they are, and the sweep from which on:
# where sweeps close in fast, what sticks is at rest to rounding.
LEAST, LATER = 0.1, 4
HUGE = 1e200  # square of changes, above which nothing is extrapolated


def step_through_period(
    theta, thetas, dt, keep, pull, keep_dense, pull_dense, velocity_of_load, rows, push, echo, echoes, delassus_columns,
    order, kind, partner, twin, friction, initial_gap, given_limit, p, late, tolerance, most_sweeps,
    positions, velocities, impulses,
):  # fmt: skip
    """The loop that ``compile_loop`` compiles: fills the last three arguments, returns sweeps and unsolved steps.

    ``p`` and ``late`` are what is carried, and what the next period takes over in the end.

    ``order`` lists the rows one after the other, but for second tangents under friction: those are solved for together
    with their ``twin``, the first one. Where the pair does not stick, one step of projected gradient has to do.

    A gap counts what is late, and what sticks makes up for it in the next step: else it would creep, and damp what it
    holds.
    """
    steps, m = impulses.shape
    n = positions.shape[1]
    dense = keep_dense.shape[0] > 0
    fast = np.flatnonzero(thetas != theta)
    fast_rows, ahead = np.ascontiguousarray(rows[:, fast]), np.zeros(fast.size)
    x, v = positions[0].copy(), velocities[0].copy()
    free, push_of_p, other = np.zeros(n), np.zeros(n), np.zeros(n)
    echoed = np.zeros(echoes.size)
    u, u_end, gap, pushed = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m)
    changed, begun, last = np.zeros(m), np.zeros((2, m)), np.zeros((3, m))
    differences, overlap = np.zeros((3, WINDOW, m)), np.zeros((WINDOW, WINDOW))
    if m > 0:
        np.dot(rows, v, u)
        np.dot(rows, x, gap)
        gap += initial_gap
    largest = np.max(np.abs(p)) if m > 0 else 0.0
    taken, unsolved = 0, 0
    for k in range(steps):
        if dense:
            np.dot(keep_dense, v, free)
            np.dot(pull_dense, x, other)
            for i in range(n):
                free[i] += other[i] + velocity_of_load[k, i]
        else:
            for i in range(n):
                free[i] = keep[i] * v[i] + pull[i] * x[i] + velocity_of_load[k, i]
        if m > 0:
            np.dot(echo, p, echoed)
            for i in range(echoes.size):
                free[echoes[i]] -= echoed[i]
            if k > 1:  # the contact forces are mostly smooth: a line through the last two saves a quarter of the sweeps
                p[:] = 2.0 * impulses[k - 1] - impulses[k - 2]
            np.dot(rows, free, u_end)
            np.dot(p, delassus_columns, pushed)
            u_end += pushed
            solved = False
            begun[0], begun[1] = p, u_end
            size, squares, known = 0.0, 0.0, -1
            for sweep in range(most_sweeps):
                taken += 1
                change, size = 0.0, 0.0
                changed[:] = p
                least = LEAST * tolerance * largest if sweep >= LATER else 0.0
                for i in order:
                    t = twin[i]
                    new_t = 0.0
                    if kind[i] == FRICTION:
                        limit = friction[i] * max(0.0, p[partner[i]]) if partner[i] >= 0 else given_limit[k, i]
                        if t < 0:
                            new = min(limit, max(-limit, p[i] - (u_end[i] + late[i]) / delassus_columns[i, i]))
                        else:
                            ii, it = delassus_columns[i, i], delassus_columns[t, i]
                            ti, tt = delassus_columns[i, t], delassus_columns[t, t]
                            determinant = ii * tt - it * ti
                            sticks = determinant > 1e-12 * ii * tt
                            if sticks:
                                new = p[i] - (tt * (u_end[i] + late[i]) - it * (u_end[t] + late[t])) / determinant
                                new_t = p[t] - (ii * (u_end[t] + late[t]) - ti * (u_end[i] + late[i])) / determinant
                                sticks = np.hypot(new, new_t) <= limit
                            if not sticks:
                                most = 0.5 * (ii + tt) + np.hypot(0.5 * (ii - tt), 0.5 * (it + ti))
                                new, new_t = p[i] - (u_end[i] + late[i]) / most, p[t] - (u_end[t] + late[t]) / most
                                both = np.hypot(new, new_t)
                                if both > limit:
                                    new, new_t = new * limit / both, new_t * limit / both
                    else:
                        new = p[i] - (u_end[i] + gap[i] / dt) / delassus_columns[i, i]
                        if kind[i] == UNILATERAL:
                            new = max(0.0, new)
                    for row, value in ((i, new), (t, new_t)):
                        size = max(size, abs(value))
                        step = value - p[row] if row >= 0 else 0.0
                        if abs(step) > least:
                            p[row] = value
                            for j in range(m):
                                u_end[j] += delassus_columns[row, j] * step
                            change = max(change, abs(step))
                if change <= tolerance * max(largest, size):
                    solved = True
                    break
                if sweep == most_sweeps // 2:  # anew and without, as sweeps alone may yet arrive, and do not run away
                    p[:], u_end[:] = begun[0], begun[1]
                if sweep < SLOW or sweep >= most_sweeps // 2:
                    continue
                before = squares
                squares = 0.0
                for i in range(m):
                    changed[i] = p[i] - changed[i]
                    squares += changed[i] ** 2
                if sweep == SLOW or squares > STRAYED * before:
                    known = -1
                known = extrapolate(known, changed, p, u_end, last, differences, overlap)
            largest = max(largest, size)
            if not solved:
                unsolved += 1
            np.dot(push, p, push_of_p)
            for i in range(m):
                gap[i] += dt * (theta * u_end[i] + (1 - theta) * u[i])
                u[i] = u_end[i]
                impulses[k, i] = p[i]
            for i in range(fast.size):
                j = fast[i]
                ahead[i] = (thetas[j] - theta) * (free[j] + push_of_p[j] - v[j])
            np.dot(fast_rows, ahead, late)
            for i in range(m):
                gap[i] += dt * late[i]
        for i in range(n):
            end = free[i] + push_of_p[i]
            x[i] += dt * (thetas[i] * end + (1 - thetas[i]) * v[i])
            v[i] = end
            positions[k + 1, i] = x[i]
            velocities[k + 1, i] = v[i]
    return taken, unsolved


def extrapolate(known, changed, p, u_end, last, differences, overlap):
    """Moves impulses, and velocities with them, to where a sweep would change them least, were it linear.

    Not far beside the change, though: where contact has no solution, as friction may jam, impulses drift on evenly.

    Args:
        known: How many earlier sweeps are looked back on; -1 where it starts anew, from the next one on.
        changed: ``(m,)`` by how much the sweep has changed the impulses.
        p, u_end: ``(m,)`` impulses after it, and velocities; moved.
        last: ``(3, m)`` the change, impulses and velocities of the sweep before; filled anew.
        differences: ``(3, WINDOW, m)`` of these three between sweeps; one is added.
        overlap: ``(WINDOW, WINDOW)`` of the differences of changes with one another; kept up.

    Returns:
        ``known`` for the next time.
    """
    m, used = p.size, min(known + 1, WINDOW)
    if known >= 0:
        at = known % WINDOW
        for i in range(m):
            differences[0, at, i] = changed[i] - last[0, i]
            differences[1, at, i] = p[i] - last[1, i]
            differences[2, at, i] = u_end[i] - last[2, i]
        overlap[at, :used] = np.dot(differences[0, :used], differences[0, at])
        overlap[:used, at] = overlap[at, :used]
    last[0], last[1], last[2] = changed, p, u_end
    trace = np.trace(overlap[:used, :used])
    if 0.0 < trace < HUGE:  # else sweeps change all by the same, or a motion grows without bound
        normal = overlap[:used, :used] + ROUNDING * trace * np.eye(used)
        shares = np.linalg.solve(normal, np.dot(differences[0, :used], changed))
        move = np.dot(shares, differences[1, :used])
        if np.max(np.abs(move)) <= FAR * np.max(np.abs(changed)):
            p -= move
            u_end -= np.dot(shares, differences[2, :used])
    return known + 1


@cache
def compile_loop():
    """``step_through_period`` as machine code: a few seconds the first time on a machine, then read from numba's cache.

    Raises:
        ImportError: numba is missing.
    """
    try:
        import numba
        import numba.extending
    except ImportError as missing:
        raise ImportError("time integration needs numba; install Debian's python3-numba") from missing
    numba.extending.register_jitable(extrapolate)
    vector, matrix, index = "f8[::1]", "f8[:,::1]", "i8[::1]"
    arguments = ["f8", vector, "f8", vector, vector, *[matrix] * 6, index, matrix, *[index] * 4, vector, vector, matrix]
    arguments += [vector, vector, "f8", "i8"]
    signature = f"UniTuple(i8,2)({','.join(arguments + [matrix] * 3)})"  # given: compiled now, not within a timed run
    try:
        return numba.njit(signature, cache=True)(step_through_period)
    except RuntimeError:  # neither the package nor the home directory can be written: nowhere to keep the cache
        return numba.njit(signature)(step_through_period)
