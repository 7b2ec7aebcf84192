"""Conditions by which the sign of an error is told, as the branches of a hysteresis are.

Such errors are spread evenly in size, so no place holds more of them than another. A condition
scores by the squared error that two levels explain, one where it holds and one elsewhere.
"""

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.diagnosis.scan import SIGNED, Condition, Evidence, Pattern, Scan, have_say, like


def find_contrast(scan: Scan, output: int, error: Array, square: Array) -> list[Pattern]:
    """Return the two sides of the condition that tells the error's sign best, or nothing.

    Args:
        scan: the descriptors.
        output: the output's number.
        error: [M] mean error of each block.
        square: [M] mean squared error of each block beyond the floor, not negative.
    """
    # A descriptor must have words for both sides; then one of its two conditions is enough.
    listed = scan.list_conditions(output)
    two_sided = [not c.is_above and bool(scan.descriptors[c.descriptor].above) for c in listed]
    conditions = [c for c, keep in zip(listed, two_sided, strict=True) if keep]
    if not conditions:
        return []
    ones = np.ones(error.size)
    sums, counts = scan.tally(output, error), scan.tally(output, ones)
    # [2, R, N]: where each condition holds, and elsewhere.
    total = np.stack([sums, scan.total(error)[:, None] - sums])[:, :, two_sided]
    count = np.stack([counts, scan.total(ones)[:, None] - counts])[:, :, two_sided]
    liking = like(scan, conditions)
    gains = np.zeros(scan.runs)
    for run in range(scan.runs):
        left = count.sum(axis=1) - count[:, run]
        level = (total.sum(axis=1) - total[:, run]) / np.maximum(left, 1.0)
        best = int(np.argmax(liking * (level**2 * left).sum(axis=0)))
        explained = 2.0 * level * total[:, run] - level**2 * count[:, run]
        gains[run] = explained[:, best].sum()
    whole, says = float(square.sum()), have_say(scan.total(square))
    evidence = Evidence(
        float(gains.sum()) / whole, 1.0, int(((gains > 0.0) & says).sum()), int(says.sum())
    )
    if not evidence.is_shared:
        return []
    on_all = (total.sum(axis=1) ** 2 / np.maximum(count.sum(axis=1), 1.0)).sum(axis=0)
    best = int(np.argmax(liking * on_all))
    patterns = []
    for is_above in (False, True):
        side = Condition(conditions[best].descriptor, conditions[best].threshold, is_above)
        held = scan.hold(side)
        patterns.append(
            Pattern(
                output,
                SIGNED,
                scan.say(side),
                float(on_all[best]) / whole,
                float(held.mean()),
                evidence.agreeing,
                evidence.checked,
                float(error[held].mean()),
                held,
            )
        )
    return patterns
