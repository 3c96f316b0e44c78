"""Joints that turn with a part of another one's position: axes that are coupled, which the columns do not say."""

from collections.abc import Iterator, Sequence

import numpy as np

from armflex.conventions import Array, number
from armflex.errors import Flag
from armflex.estimate.fit import Fit
from armflex.estimate.misread import NAMED
from armflex.estimate.misreadings import USUAL_PRIOR
from armflex.linear_gaussian import LinearGaussian
from armflex.parameters import ABSURD, MISSING


def coupled_axes(fitted: Fit) -> Iterator[Flag]:
    """Yield a flag where no effect is missing any more once drives turn with parts of other drives' positions.

    Every part is a number beside all that was fitted. They are added one by one, the likeliest first, while the
    readings favour each by the odds at which a hypothesis is named.
    """
    before = max(fitted.scatters)
    if before <= MISSING:
        return
    drives, view = fitted.setup.arm.joint_names, fitted.view
    q = view.driven.q[view.rows]
    turned = view.answer(lambda line: line.joints) * fitted.scale[:, :, None]
    columns = turned[:, :, :, None] * (q - q.mean(axis=0))[:, None, None, :]
    columns = np.nan_to_num(columns).reshape(view.residual.size, len(drives) ** 2)
    beside = fitted.regressors.T @ columns
    inverse = LinearGaussian(fitted.information).with_precision(fitted.precision).covariance
    gram, towards = columns.T @ columns - beside.T @ inverse @ beside, columns.T @ fitted.residual
    cost = float(fitted.residual @ fitted.residual + fitted.values**2 @ fitted.precision)
    chosen, left = _chosen(gram, towards, cost, view.count)
    parts, after = [divmod(part, len(drives)) for part in chosen], before * np.sqrt(left / cost)
    sizes = np.linalg.lstsq(gram[np.ix_(chosen, chosen)], towards[chosen])[0]
    # Errors that any joint has are no gear's, and a part of so many may remain where the arm is not linear in them.
    large = [size * q[:, other].std() for (_, other), size in zip(parts, np.abs(sizes), strict=True)]
    named = [i for i, size in enumerate(large) if size > USUAL_PRIOR.joint_offset]
    if after > max(MISSING, before / ABSURD) or all(parts[i][0] == parts[i][1] for i in named):
        return
    said = []
    for drive in dict.fromkeys(parts[i][0] for i in named):
        of_drive = [(parts[i][1], sizes[i]) for i in named if parts[i][0] == drive]
        more = (f"{'+' if size > 0.0 else '-'} {number(abs(size), 3)} q_{drives[other]}" for other, size in of_drive)
        said.append(f"{drives[drive]} = q_{drives[drive]} {' '.join(more)}")
    text = f"the readings scatter {before:.2g} times as much as stated, and {after:.2g} times if "
    yield Flag("coupled_axes", f"{text}{', '.join(said)}: are these axes coupled, as those of a wrist are by its gears,"
                               " and not in the columns? Then write that into them")  # fmt: skip


def _chosen(gram: Array, towards: Array, cost: float, count: int) -> tuple[Sequence[int], float]:
    """Return the columns that are worth their number, in the order of the first, and the cost that they leave.

    Args:
        gram: (k, k) products of all columns without what is fitted beside them.
        towards: (k,) products with the residual.
        cost: Of the residual.
        count: Number of readings.
    """

    def left(columns: Sequence[int]) -> float:
        part = towards[list(columns)]
        return max(cost - float(part @ np.linalg.lstsq(gram[np.ix_(columns, columns)], part)[0]), np.finfo(float).tiny)

    chosen, now = list[int](), cost
    while len(chosen) < len(towards):
        costs = {column: left([*chosen, column]) for column in range(len(towards)) if column not in chosen}
        best = min(costs, key=lambda column: costs[column])
        if 0.5 * count * np.log(now / costs[best]) - np.log(len(costs)) < NAMED:
            break
        chosen, now = [*chosen, best], costs[best]
    for column in tuple(chosen):  # what others that came later say as well
        without = [other for other in chosen if other != column]
        if 0.5 * count * np.log(left(without) / now) - np.log(len(towards)) < NAMED:
            chosen, now = without, left(without)
    return sorted(chosen), now
