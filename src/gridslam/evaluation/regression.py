"""Whether one version's results are worse than another's, beyond the noise of their seeds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from scipy.special import stdtr

LEAST_PAIRS: Final = 5
"""Fewer pairs can hardly show a change beyond the noise of the seeds."""


@final
@dataclass(frozen=True)
class Change:
    """The change of one figure in one group of pairs.

    Attributes
    ----------
    log, figure : str
        What was measured, on which log.
    pairs : int
        Pairs with a value.
    mean : float
        Mean of the differences, new minus old; of logarithms, so that its exponential is the ratio.
    p_worse, p_better : float, [0, 1]
        Probability of a difference as large in any of the figures and logs, if nothing had changed.
    """

    log: str
    figure: str
    pairs: int
    mean: float
    p_worse: float
    p_better: float


def find_changes(differences: Mapping[tuple[str, str], Sequence[float]], margins: Mapping[str, float]) -> list[Change]:
    """Test differences of pairs, new minus old, for values above a margin, by Student's t.

    The probabilities are multiplied by the number of figures (Bonferroni), so that the probability of any false alarm,
    over all logs and figures, is at most the level that they are compared with.

    Parameters
    ----------
    differences : mapping of (str, str) to sequence of float
        By log and figure; NaN where a pair has none.
    margins : mapping of str to float
        By figure, how much larger the new values may be; at least 0.

    Returns
    -------
    list of Change
        In the order of the differences; those with fewer than `LEAST_PAIRS` pairs are left out.
    """
    known = {name: np.array(values)[np.isfinite(values)] for name, values in differences.items()}
    tested = {name: values for name, values in known.items() if len(values) >= LEAST_PAIRS}
    changes = []
    for (log, figure), values in tested.items():
        count = len(values)
        mean = float(values.mean())
        error = float(values.std(ddof=1)) / math.sqrt(count) + 1e-12
        worse, better = (
            min(1.0, len(tested) * float(stdtr(count - 1, (margins[figure] - sign * mean) / error))) for sign in (1, -1)
        )
        changes.append(Change(log, figure, count, mean, worse, better))
    return changes
