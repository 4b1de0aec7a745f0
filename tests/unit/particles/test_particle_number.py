"""How many particles a belief needs, by KLD-sampling."""

import numpy as np
import pytest
from scipy.stats import chi2, norm

from gridslam.particles import kld_bound


@pytest.mark.parametrize("bins", [2, 5, 20, 300])
@pytest.mark.parametrize("error", [0.05, 0.3])
def test_the_bound_is_the_quantile_of_chi_square(bins, error):
    exact = chi2.ppf(norm.cdf(2.33), bins - 1) / (2 * error)
    assert kld_bound(np.array(bins), error, 2.33) == pytest.approx(exact, rel=0.03, abs=1)
