"""The null-space cascade as machine code. Importing this module needs numba; `compiled` does so when used.

Velocities are turned, v = Q z, by Householder reflections that are collected level by level: the rows of a
level become a lower triangle in the next free coordinates, and all rows below are turned along. What a level
fixes are the first coordinates of z, what it leaves free are the others; no basis is ever formed.

Invariants: with `done` fixed coordinates, the reflections 0 … done-1 were applied to all rows of lower
levels but the last. The last level, which is long (the posture), adds no reflections and is not turned: the
few directions that are left free, the last columns of Q, are formed for it. Bounds are not turned either: a
row that becomes active is turned by itself. `single` finds rows with one entry, as those of joints.
`reflections[c, c:]` is the vector w of the reflection 1 - scales[c] w w'.

A level whose least squares violate a bound is solved by a dual active-set method (Goldfarb and Idnani 1983):
it starts at the least squares and adds one violated bound after the other. In the turned coordinates the
Hessian is a small block and a multiple of the identity, so its factor is cheap.

Warm start: the bounds that were active at the end of the last problem become active at once, but for those
whose multiplier is then negative. What is left is the minimum on its active bounds with multipliers that are
not negative, where the method could have come to by itself; so the solution is the same.

All arrays are made by the caller; nothing is allocated here.

This is one file on purpose: numba keeps machine code on the disk by the time of the file of a function, and
would use old code for a function that calls a changed one of another file.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit

from handover_humanoid.model.kinematics import Array

RANK_TOLERANCE, FEASIBLE, EQUALITY, PRIMAL_TOLERANCE = 1e-6, 1e-8, 1e-12, 1e-9
"""As in `cascade`; a test compares them."""
INDEPENDENT = 1e-10
"""The same share above which a row may become active at once, in a warm start."""
DEPENDENT = 1e-20
"""The share of the square of a row outside of the active ones below which it depends on them."""
RECOMPUTE = 1e-3
"""A norm that shrank to this share is computed again, since subtraction has cancelled its digits."""

SOLVED, NOT_FINITE, ZERO_IS_OUTSIDE, STUCK = 0, 1, 2, 3
"""What `solve` returns. `STUCK`: rounding errors led the active-set method in a circle."""
FEASIBLE_STEP, NO_STEP, CIRCLE = 0, 1, 2

Function = TypeVar("Function", bound=Callable[..., Any])
Indices = Any


def machine_code(function: Function) -> Function:
    """Compile a function when it is first called; the code is kept in a folder that can be written.

    Sums may be computed in any order. Values that are not finite keep their meaning.
    """
    flags = {"reassoc", "contract", "arcp", "nsz"}
    try:
        compiled = njit(cache=True, fastmath=flags, error_model="numpy")(function)
    except RuntimeError:  # no folder can be written: it is compiled in every process
        compiled = njit(fastmath=flags, error_model="numpy")(function)
    return cast("Function", compiled)


@machine_code
def dot(first: Array, second: Array) -> float:
    """Return the product of two vectors of the same length."""
    total = 0.0
    for index in range(first.shape[0]):
        total += first[index] * second[index]
    return total


@machine_code
def add(factor: float, vector: Array, to: Array) -> None:
    """Add a multiple of a vector to another one."""
    for index in range(to.shape[0]):
        to[index] += factor * vector[index]


@machine_code
def reflect(row: Array, reflections: Array, scales: Array, first: int, last: int) -> None:
    """Apply the reflections `first` … `last` - 1 to a row."""
    for column in range(first, last):
        part, vector = row[column:], reflections[column, column:]
        add(-scales[column] * dot(part, vector), vector, part)


@machine_code
def reflect_rows(rows: Array, reflections: Array, scales: Array, first: int, last: int) -> None:
    """Apply the reflections `first` … `last` - 1 to rows, four at a time: their sums do not wait."""
    count = rows.shape[0]
    whole = count - count % 4
    for column in range(first, last):
        vector, scale = reflections[column, column:], -scales[column]
        for row in range(0, whole, 4):
            a, b = rows[row, column:], rows[row + 1, column:]
            c, d = rows[row + 2, column:], rows[row + 3, column:]
            of_a = of_b = of_c = of_d = 0.0
            for index in range(vector.shape[0]):
                value = vector[index]
                of_a += a[index] * value
                of_b += b[index] * value
                of_c += c[index] * value
                of_d += d[index] * value
            add(scale * of_a, vector, a)
            add(scale * of_b, vector, b)
            add(scale * of_c, vector, c)
            add(scale * of_d, vector, d)
        for row in range(whole, count):
            part = rows[row, column:]
            add(scale * dot(part, vector), vector, part)


@machine_code
def norm_of_residual(rows: Array, targets: Array, z: Array) -> float:
    """Return |rows @ z - targets|."""
    total = 0.0
    for row in range(rows.shape[0]):
        rest = dot(rows[row], z) - targets[row]
        total += rest * rest
    return float(np.sqrt(total))


@machine_code
def reflect_back(row: Array, reflections: Array, scales: Array, last: int) -> None:
    """Turn coordinates z into velocities Q z."""
    for column in range(last - 1, -1, -1):
        part, vector = row[column:], reflections[column, column:]
        add(-scales[column] * dot(part, vector), vector, part)


@machine_code
def swap(rows: Array, targets: Array, first: int, second: int) -> None:
    """Exchange two rows of a level."""
    if first != second:
        for column in range(rows.shape[1]):
            rows[first, column], rows[second, column] = rows[second, column], rows[first, column]
        targets[first], targets[second] = targets[second], targets[first]


@machine_code
def triangle(rows: Array, targets: Array, done: int, reflections: Array, scales: Array, norms: Array) -> int:
    """Make a lower triangle of `rows[:, done:]`, the longest rows first, and return its rank."""
    count, n = rows.shape
    for index in range(count):
        norms[0, index] = dot(rows[index, done:], rows[index, done:])
        norms[1, index] = norms[0, index]
    rank = 0
    while rank < count and done + rank < n:
        column, longest = done + rank, rank
        for index in range(rank + 1, count):
            if norms[0, index] > norms[0, longest]:
                longest = index
        swap(rows, targets, rank, longest)
        for which in range(2):
            norms[which, longest] = norms[which, rank]
        row = rows[rank, column:]
        length = np.sqrt(dot(row, row))
        if length <= RANK_TOLERANCE:
            break
        vector = reflections[column, column:]
        vector[:] = row
        end = -length if row[0] > 0 else length
        vector[0] -= end
        scales[column] = 2.0 / dot(vector, vector)
        row[:] = 0.0
        row[0] = end
        for index in range(rank + 1, count):
            part = rows[index, column:]
            add(-scales[column] * dot(part, vector), vector, part)
            norms[0, index] -= part[0] * part[0]
            if norms[0, index] <= RECOMPUTE * norms[1, index]:
                norms[0, index] = dot(part[1:], part[1:])
                norms[1, index] = norms[0, index]
        rank += 1
    return rank


@machine_code
def factor(matrix: Array, size: int) -> bool:
    """Replace the lower triangle of a matrix by its Cholesky factor; False if it is not positive."""
    for row in range(size):
        for column in range(row + 1):
            rest = matrix[row, column] - dot(matrix[row, :column], matrix[column, :column])
            if column < row:
                matrix[row, column] = rest / matrix[column, column]
            elif rest <= 0.0:
                return False
            else:
                matrix[row, row] = np.sqrt(rest)
    return True


@machine_code
def substitute(lower: Array, size: int, vector: Array) -> None:
    """Solve L L' x = vector in place."""
    for row in range(size):
        vector[row] = (vector[row] - dot(lower[row, :row], vector[:row])) / lower[row, row]
    for row in range(size - 1, -1, -1):
        vector[row] /= lower[row, row]
        add(-vector[row], lower[row, :row], vector[:row])


@machine_code
def least_squares(
    rows: Array,
    targets: Array,
    z: Array,
    done: int,
    rank: int,
    epsilon: float,
    hessian: Array,
) -> bool:
    """Set z[done : done + rank] to the damped least squares, and leave the factor in `hessian`.

    `rows[:, done:]` is a lower triangle of this rank.
    """
    end = done + rank
    hessian[:rank, :rank] = 0.0
    z[done:end] = 0.0
    for index in range(rows.shape[0]):
        part = rows[index, done:end]
        add(targets[index] - dot(rows[index, :done], z[:done]), part, z[done:end])
        for row in range(min(index + 1, rank)):
            add(part[row], part[: row + 1], hessian[row, : row + 1])
    for row in range(rank):
        hessian[row, row] += epsilon
    if not factor(hessian, rank):
        return False
    substitute(hessian, rank, z[done:end])
    return True


@machine_code
def start_factor(hessian: Array, rank: int, size: int, epsilon: float, inverse: Array) -> None:
    """Set `inverse` to the inverse of the factor of blockdiag(L L', epsilon 1)."""
    inverse[:size, :size] = 0.0
    for row in range(rank):
        for column in range(row):
            add(-hessian[row, column], inverse[column, : column + 1], inverse[row, : column + 1])
        for column in range(row + 1):
            inverse[row, column] = (inverse[row, column] + (1.0 if column == row else 0.0)) / hessian[
                row, row
            ]
    for row in range(rank, size):
        inverse[row, row] = 1.0 / np.sqrt(epsilon)


@machine_code
def single(rows: Array, columns: Indices) -> None:
    """Set `columns` to the column of the only entry of each row, or -1 for a row with more."""
    n = rows.shape[1]
    for index in range(rows.shape[0]):
        row = rows[index]
        count, place = 0, 0
        for column in range(n):
            if row[column] != 0.0:
                count += 1
                place += column
        columns[index] = place if count == 1 else -1


@machine_code
def product(row: Array, column: int, vector: Array) -> float:
    """Return row @ vector; `column` is that of `single`."""
    return row[column] * vector[column] if column >= 0 else dot(row, vector)


@machine_code
def multiply(matrix: Array, columns: Indices, vector: Array, products: Array) -> None:
    """Set `products` to matrix @ vector."""
    for index in range(matrix.shape[0]):
        products[index] = product(matrix[index], columns[index], vector)


@machine_code
def most_violated(is_used: Indices, low: Array, high: Array, reached: Array) -> int:
    """Return the row that is violated most, or -1."""
    worst, most = -1, PRIMAL_TOLERANCE
    for index in range(reached.shape[0]):
        if is_used[index] == 0:
            violation = max(low[index] - reached[index], reached[index] - high[index])
            if violation > most:
                worst, most = index, violation
    return worst


@machine_code
def activate(inverse: Array, upper: Array, direction: Array, count: int, size: int, work: Array) -> None:
    """Add the row whose products with `inverse` are `direction` to the `count` active ones."""
    part = direction[count:size]
    length = np.sqrt(dot(part, part))
    end = -length if part[0] > 0 else length
    upper[count, :count] = direction[:count]  # transposed: row `count` is the column of R
    upper[count, count] = end
    part[0] -= end
    square = dot(part, part)
    if square > 0.0:
        work[:size] = 0.0
        for row in range(count, size):
            add(direction[row], inverse[row, :size], work[:size])
        for row in range(count, size):
            add(-2.0 * direction[row] / square, work[:size], inverse[row, :size])


@machine_code
def deactivate(inverse: Array, upper: Array, which: int, count: int, size: int) -> None:
    """Remove an active row: its column leaves R, and rotations make R a triangle again."""
    for row in range(which, count - 1):
        upper[row, : row + 2] = upper[row + 1, : row + 2]
    for row in range(which, count - 1):
        length = np.hypot(upper[row, row], upper[row, row + 1])
        if length == 0.0:
            continue
        cosine, sine = upper[row, row] / length, upper[row, row + 1] / length
        for other in range(row, count - 1):
            first, second = upper[other, row], upper[other, row + 1]
            upper[other, row] = cosine * first + sine * second
            upper[other, row + 1] = cosine * second - sine * first
        for column in range(size):
            first, second = inverse[row, column], inverse[row + 1, column]
            inverse[row, column] = cosine * first + sine * second
            inverse[row + 1, column] = cosine * second - sine * first


@machine_code
def drop(
    inverse: Array,
    upper: Array,
    which: int,
    count: int,
    size: int,
    active: Indices,
    signs: Indices,
    values: Array,
) -> None:
    """Remove an active row from the factors and from the lists of the active ones."""
    deactivate(inverse, upper, which, count, size)
    for row in range(which, count - 1):
        active[row], signs[row], values[row] = active[row + 1], signs[row + 1], values[row + 1]


@machine_code
def multipliers(upper: Array, direction: Array, count: int, result: Array) -> None:
    """Solve R result = direction[:count]."""
    result[:count] = direction[:count]
    for row in range(count - 1, -1, -1):
        result[row] /= upper[row, row]
        add(-result[row], upper[row, :row], result[:row])


@machine_code
def first_to_leave(duals: Array, change: Array, count: int) -> int:
    """Return the active row whose multiplier is the first to become zero, or -1."""
    which = -1
    for row in range(count):
        if change[row] > 0.0 and (which < 0 or duals[row] * change[which] < duals[which] * change[row]):
            which = row
    return which


@machine_code
def warm_start(
    matrix: Array,
    low: Array,
    high: Array,
    guess: Indices,
    is_used: Indices,
    active: Indices,
    signs: Indices,
    z: Array,
    reached: Array,
    done: int,
    last: int,
    reflections: Array,
    scales: Array,
    inverse: Array,
    upper: Array,
    turned: Array,
    vectors: Array,
) -> int:
    """Move z[done:] to the minimum on bounds of `guess`, and return how many of them are active.

    `guess` has their number, then each as the number of its row from 1 on: positive for the lower bound,
    negative for the upper one. The multipliers in vectors[1] are not negative afterwards.
    """
    size, count, remembered = z.shape[0] - done, 0, 0
    gaps, duals, along, direction, work = vectors[0], vectors[1], vectors[2], vectors[3], vectors[6]
    for place in range(guess[0]):
        row = abs(guess[1 + place]) - 1
        if remembered < size and is_used[row] == 0:
            signs[remembered] = 1 if guess[1 + place] > 0 else -1
            active[remembered] = row
            turned[remembered] = matrix[row]
            remembered += 1
    reflect_rows(turned[:remembered], reflections, scales, 0, last)
    for place in range(remembered):
        row, sign = active[place], signs[place]
        for index in range(size):
            direction[index] = sign * dot(inverse[index, :size], turned[place, done:])
        total = dot(direction[:size], direction[:size])
        if dot(direction[count:size], direction[count:size]) <= INDEPENDENT * total:
            continue
        activate(inverse, upper, direction, count, size, work)
        gaps[count] = sign * ((low[row] if sign > 0 else high[row]) - reached[row])
        active[count], signs[count], is_used[row] = row, sign, 1
        count += 1
    while count > 0:
        for index in range(count):  # R' along = gaps, then R duals = along
            along[index] = (gaps[index] - dot(upper[index, :index], along[:index])) / upper[index, index]
        multipliers(upper, along, count, duals)
        leaving = 0
        for index in range(1, count):
            if duals[index] < duals[leaving]:
                leaving = index
        if duals[leaving] >= 0.0:
            break
        is_used[active[leaving]] = 0
        drop(inverse, upper, leaving, count, size, active, signs, gaps)
        count -= 1
    for index in range(count):
        add(along[index], inverse[index, :size], z[done:])
    return count


@machine_code
def remember(guess: Indices, active: Indices, signs: Indices, count: int) -> None:
    """Keep the active bounds for the next problem."""
    guess[0] = count
    for row in range(count):
        guess[1 + row] = signs[row] * (active[row] + 1)


@machine_code
def move(
    length: float,
    direction: Array,
    count: int,
    z: Array,
    velocity: Array,
    done: int,
    last: int,
    reflections: Array,
    scales: Array,
    inverse: Array,
    step: Array,
) -> None:
    """Move z and velocity = Q z towards a bound, along the active ones."""
    size = z.shape[0] - done
    step[:] = 0.0
    for row in range(count, size):
        add(direction[row], inverse[row, :size], step[done:])
    add(length, step[done:], z[done:])
    reflect_back(step, reflections, scales, last)
    add(length, step, velocity)


@machine_code
def satisfy(
    matrix: Array,
    columns: Indices,
    low: Array,
    high: Array,
    whole: Indices,
    z: Array,
    velocity: Array,
    reached: Array,
    done: int,
    last: int,
    reflections: Array,
    scales: Array,
    inverse: Array,
    upper: Array,
    rows: Array,
    vectors: Array,
    guess: Indices,
) -> int:
    """Move z[done:] from the unbounded minimum to the bounded one (Goldfarb and Idnani 1983).

    `velocity` is Q z and `reached` is matrix @ velocity, before and after. `guess` are the active bounds of a
    similar problem, and then those of this one, as `warm_start` has them; `rows` (n, n) is memory for it.
    """
    n, m = z.shape[0], reached.shape[0]
    size, rounds = n - done, 0
    is_used, active, signs = whole[1, :m], whole[2], whole[5]
    is_used[:] = whole[0, :m]
    count = warm_start(
        matrix,
        low,
        high,
        guess,
        is_used,
        active,
        signs,
        z,
        reached,
        done,
        last,
        reflections,
        scales,
        inverse,
        upper,
        rows,
        vectors,
    )
    guess[0] = 0
    if count > 0:
        velocity[:] = z
        reflect_back(velocity, reflections, scales, last)
        multiply(matrix, columns, velocity, reached)
    duals, change, direction = vectors[1], vectors[2], vectors[3]
    step, turned, work = vectors[4, :n], vectors[5, :n], vectors[6]
    while True:
        added = most_violated(is_used, low, high, reached)
        if added < 0:
            remember(guess, active, signs, count)
            return FEASIBLE_STEP
        sign = 1.0 if reached[added] < low[added] else -1.0
        wanted = low[added] if sign > 0 else high[added]
        turned[:] = 0.0
        add(sign, matrix[added], turned)
        reflect(turned, reflections, scales, 0, last)
        dual = 0.0
        while True:
            rounds += 1
            if rounds > 20 * (size + m):
                return CIRCLE
            for row in range(size):
                direction[row] = dot(inverse[row, :size], turned[done:])
            slope = dot(direction[count:size], direction[count:size])
            multipliers(upper, direction, count, change)
            leaving = first_to_leave(duals, change, count)
            can_move = slope > DEPENDENT * dot(direction[:size], direction[:size])
            if leaving < 0 and not can_move:
                return NO_STEP
            length = sign * (wanted - reached[added]) / slope if can_move else np.inf
            is_full = leaving < 0 or length <= duals[leaving] / change[leaving]
            if not is_full:
                length = duals[leaving] / change[leaving]
            if can_move:
                move(length, direction, count, z, velocity, done, last, reflections, scales, inverse, step)
                multiply(matrix, columns, velocity, reached)
            add(-length, change[:count], duals[:count])
            dual += length
            if is_full:
                activate(inverse, upper, direction, count, size, work)
                active[count], signs[count], duals[count] = added, int(sign), dual
                is_used[added] = 1
                count += 1
                break
            is_used[active[leaving]] = 0
            drop(inverse, upper, leaving, count, size, active, signs, duals)
            count -= 1


@machine_code
def free_directions(reflections: Array, scales: Array, done: int, basis: Array) -> None:
    """Set the rows of `basis` to the columns `done` … of Q."""
    n = basis.shape[1]
    basis[:, :] = 0.0
    for row in range(n - done):
        basis[row, done + row] = 1.0
    for column in range(done - 1, -1, -1):
        reflect_rows(basis, reflections, scales, column, column + 1)


@machine_code
def last_level(
    rows: Array,
    targets: Array,
    columns: Indices,
    fixed: Array,
    basis: Array,
    epsilon: float,
    hessian: Array,
    step: Array,
    missing: Array,
    reduced: Array,
) -> bool:
    """Set `step` to the damped least squares in the rows of `basis`, and leave the factor in `hessian`."""
    free, count = basis.shape[0], rows.shape[0]
    for index in range(count):
        column = columns[index]
        missing[index] = targets[index] - product(rows[index], column, fixed)
        if column >= 0:
            entry = rows[index, column]
            for direction in range(free):
                reduced[direction, index] = entry * basis[direction, column]
        else:
            for direction in range(free):
                reduced[direction, index] = dot(rows[index], basis[direction])
    for direction in range(free):
        step[direction] = dot(reduced[direction, :count], missing[:count])
        for other in range(direction + 1):
            hessian[direction, other] = dot(reduced[direction, :count], reduced[other, :count])
        hessian[direction, direction] += epsilon
    if not factor(hessian, free):
        return False
    substitute(hessian, free, step)
    return True


@machine_code
def are_finite(values: Array) -> bool:
    """Return whether no value is NaN or infinite: a product with zero keeps both as NaN."""
    total = 0.0
    for index in range(values.shape[0]):
        total += values[index] * 0.0
    return total == 0.0


@machine_code
def examined(rows: Array, targets: Array, matrix: Array, lower: Array, upper: Array) -> int:
    """Return whether the problem has a meaning, and whether zero obeys its bounds."""
    if not (are_finite(rows.reshape(-1)) and are_finite(targets) and are_finite(matrix.reshape(-1))):
        return NOT_FINITE
    is_outside = False
    for index in range(lower.shape[0]):
        if not (-np.inf < lower[index] <= upper[index] < np.inf):
            return NOT_FINITE
        is_outside = is_outside or lower[index] > 0.0 or upper[index] < 0.0
    return ZERO_IS_OUTSIDE if is_outside else SOLVED


@machine_code
def equalities(
    matrix: Array, lower: Array, upper: Array, is_equal: Indices, rows: Array, targets: Array
) -> int:
    """Copy the bounds that are equal to `rows`, and return their number."""
    count = 0
    for index in range(lower.shape[0]):
        is_equal[index] = 1 if upper[index] - lower[index] <= EQUALITY else 0
        if is_equal[index] == 1:
            rows[count] = matrix[index]
            targets[count] = lower[index]
            count += 1
    return count


@machine_code
def solve_equalities(rows: Array, targets: Array, z: Array, rank: int, hessian: Array) -> bool:
    """Set z[:rank] to the solution; rows that depend on others share their rounding errors."""
    if rank == rows.shape[0]:
        for row in range(rank):
            z[row] = (targets[row] - dot(rows[row, :row], z[:row])) / rows[row, row]
        return True
    return least_squares(rows, targets, z, 0, rank, 0.0, hessian)


@machine_code
def widen(reached: Array, lower: Array, upper: Array, low: Array, high: Array) -> None:
    """Let bounds contain what the levels above reach, which may violate them by a rounding error."""
    for index in range(lower.shape[0]):
        low[index] = min(lower[index], reached[index]) - FEASIBLE
        high[index] = max(upper[index], reached[index]) + FEASIBLE


@machine_code
def are_held(low: Array, high: Array, is_equal: Indices, reached: Array) -> bool:
    """Return whether all bounds are obeyed."""
    for index in range(low.shape[0]):
        value = reached[index]
        if is_equal[index] == 0 and (value < low[index] - FEASIBLE or value > high[index] + FEASIBLE):
            return False
    return True


@machine_code
def are_obeyed(lower: Array, upper: Array, reached: Array) -> bool:
    """Return whether all bounds are obeyed, those that are equal too."""
    for index in range(lower.shape[0]):
        if not lower[index] - FEASIBLE <= reached[index] <= upper[index] + FEASIBLE:
            return False
    return True


@machine_code
def start(
    matrix: Array,
    columns: Indices,
    lower: Array,
    upper: Array,
    is_outside: bool,
    is_equal: Indices,
    equal_rows: Array,
    values: Array,
    z: Array,
    velocity: Array,
    reached: Array,
    reflections: Array,
    scales: Array,
    norms: Array,
    hessian: Array,
) -> int:
    """Set z and velocity = Q z to what the bounds that are equal ask for, and reached = matrix @ velocity.

    Returns how many coordinates they fix, or -STUCK, or -ZERO_IS_OUTSIDE if zero `is_outside` and so is this.
    """
    done, count = 0, equalities(matrix, lower, upper, is_equal, equal_rows, values)
    if count > 0:
        done = triangle(equal_rows[:count], values, 0, reflections, scales, norms)
        reflect(z, reflections, scales, 0, done)
        if not solve_equalities(equal_rows[:count], values, z, done, hessian):
            return -STUCK
    velocity[:] = z
    reflect_back(velocity, reflections, scales, done)
    multiply(matrix, columns, velocity, reached)
    return -ZERO_IS_OUTSIDE if is_outside and not are_obeyed(lower, upper, reached) else done


@machine_code
def solve_last(
    rows: Array,
    targets: Array,
    columns: Indices,
    z: Array,
    velocity: Array,
    done: int,
    reflections: Array,
    scales: Array,
    basis: Array,
    epsilon: float,
    hessian: Array,
    missing: Array,
    reduced: Array,
) -> bool:
    """Set z[done:] and `velocity` = Q z to the least squares of the last level."""
    z[done:] = 0.0
    velocity[:] = z
    reflect_back(velocity, reflections, scales, done)
    free_directions(reflections, scales, done, basis)
    single(rows, columns)
    if not last_level(rows, targets, columns, velocity, basis, epsilon, hessian, z[done:], missing, reduced):
        return False
    for row in range(basis.shape[0]):
        add(z[done + row], basis[row], velocity)
    return True


@machine_code
def solve(
    rows: Array,
    targets: Array,
    ends: Indices,
    matrix: Array,
    lower: Array,
    upper: Array,
    epsilon: float,
    velocity: Array,
    is_started: bool,
    residuals: Array,
    squares: Array,
    equal_rows: Array,
    reduced: Array,
    vectors: Array,
    whole: Indices,
    guesses: Indices,
) -> int:
    """Solve all levels. `rows` and `targets` are overwritten; `velocity` obeys the bounds afterwards.

    It does so before where `is_started`; otherwise it is zero. Where neither zero nor the smallest velocity
    with the bounds that are equal obeys all, this returns ZERO_IS_OUTSIDE, and has overwritten nothing else.

    Shapes: rows (R, n), targets (R,), ends (levels + 1,), matrix (m, n), squares (5, n, n), equal_rows
    (m, n), reduced (n, R), vectors (15, max(R, m, n)), whole (6, max(R, m, n)), guesses
    (levels, max(R, m, n) + 1), which has the active bounds of each level: of the last problem before, of this
    one afterwards.
    """
    state = examined(rows, targets, matrix, lower, upper)
    if state == NOT_FINITE:
        return state
    n, m, levels = matrix.shape[1], matrix.shape[0], ends.shape[0] - 1
    reflections, hessian, inverse, triangular = squares[0], squares[1], squares[2], squares[3]
    z, before, scales = vectors[7, :n], vectors[8, :n], vectors[9, :n]
    low, high, norms, reached = vectors[10, :m], vectors[11, :m], vectors[12:14], vectors[14, :m]
    is_equal, columns = whole[0, :m], whole[3, :m]
    single(matrix, columns)

    turned = ends[max(levels - 1, 0)]  # the rows below are those of the last level
    z[:] = velocity
    done = start(
        matrix,
        columns,
        lower,
        upper,
        state == ZERO_IS_OUTSIDE and not is_started,
        is_equal,
        equal_rows,
        vectors[6],
        z,
        velocity,
        reached,
        reflections,
        scales,
        norms,
        hessian,
    )
    if done < 0:
        return -done
    last = done  # the number of reflections
    reflect_rows(rows[:turned], reflections, scales, 0, done)

    for level in range(levels):
        jacobian, target = rows[ends[level] : ends[level + 1]], targets[ends[level] : ends[level + 1]]
        is_last = level == levels - 1
        if done < n:
            widen(reached, lower, upper, low, high)
            rank = n - done
            if is_last:
                before[:] = z
                basis, of_rows = squares[4, :rank], whole[4, : jacobian.shape[0]]
                if not solve_last(
                    jacobian,
                    target,
                    of_rows,
                    z,
                    velocity,
                    done,
                    reflections,
                    scales,
                    basis,
                    epsilon,
                    hessian,
                    vectors[6],
                    reduced,
                ):
                    return STUCK
            else:
                rank = triangle(jacobian, target, done, reflections, scales, norms)
                last = done + rank
                # Free coordinates of the levels above are chosen again, in the axes that this level turned.
                reflect(z, reflections, scales, done, last)
                before[:] = z
                if not least_squares(jacobian, target, z, done, rank, epsilon, hessian):
                    return STUCK
                z[last:] = 0.0
                velocity[:] = z
                reflect_back(velocity, reflections, scales, last)
            multiply(matrix, columns, velocity, reached)
            if not are_held(low, high, is_equal, reached):
                start_factor(hessian, rank, n - done, epsilon, inverse)
                outcome = satisfy(
                    matrix,
                    columns,
                    low,
                    high,
                    whole,
                    z,
                    velocity,
                    reached,
                    done,
                    last,
                    reflections,
                    scales,
                    inverse,
                    triangular,
                    squares[4],
                    vectors[:7],
                    guesses[level],
                )
                if outcome == CIRCLE:
                    return STUCK
                if outcome == NO_STEP:
                    z[:] = before
                velocity[:] = z
                reflect_back(velocity, reflections, scales, last)
                multiply(matrix, columns, velocity, reached)
            if not is_last:
                reflect_rows(rows[ends[level + 1] : turned], reflections, scales, done, last)
                done = last
        residuals[level] = norm_of_residual(jacobian, target, velocity if is_last else z)
    return SOLVED
