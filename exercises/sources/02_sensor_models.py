"""Exercise 2: beam model and likelihood field

*Probabilistic Robotics*, Tables 6.1 (`beam_range_finder_model`) and 6.3 (`likelihood_field_range_finder_model`).
"""

# %% [markdown]
# The **beam model** explains a range $z$ by the range $z^*$ that the map predicts along the beam, in four ways: the
# beam *hit* the wall, something *short* of it, nothing (*max*), or the reading is *random*. Below the maximum
# $z_{top}$ it is a density:
#
# $$ p(z \mid z^*) = z_{hit} \frac{N(z; z^*, \sigma^2)}{\Phi(z^* / \sigma)}
# + z_{short} \frac{\lambda e^{-\lambda z}}{1 - e^{-\lambda \min(z^*, z_{top})}} [z \le z^*]
# + \frac{z_{rand}}{z_{top}} $$
#
# and no return, $z \ge z_{top}$, has a probability:
#
# $$ P(z_{top} \mid z^*) = z_{max} + z_{hit} \frac{\Phi((z^* - z_{top}) / \sigma)}{\Phi(z^* / \sigma)} $$
#
# $\Phi$ is the standard normal distribution function. Integral and probability together must be 1, whatever $z^*$ is.

# %%
import math

import checks
import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import norm

from gridslam.models import BeamRangeFinder, LikelihoodField


# %% [task]
def beam_likelihoods(model, ranges, expected):
    """Evaluate p(z | z*), the beam model.

    Parameters
    ----------
    model : BeamRangeFinder
        Its parameters: z_hit, z_short, z_max, z_rand, sigma_hit_m, lambda_short_per_m, range_max_m.
    ranges, expected : (B,) float64, m
        Measured ranges, at or above range_max_m if nothing returned; predicted ones, infinite if there is no wall.

    Returns
    -------
    (B,) float64
        Densities in 1/m below range_max_m, probabilities otherwise.
    """
    sigma = model.sigma_hit_m
    rate = model.lambda_short_per_m
    seen = norm.cdf(expected / sigma)
    hit = norm.pdf((ranges - expected) / sigma) / (sigma * seen)
    before = np.minimum(expected, model.range_max_m)
    short = np.where(ranges <= expected, rate * np.exp(-rate * ranges) / -np.expm1(-rate * before), 0.0)
    density = model.z_hit * hit + model.z_short * short + model.z_rand / model.range_max_m
    no_return = model.z_max + model.z_hit * norm.cdf((expected - model.range_max_m) / sigma) / seen
    return np.where(ranges < model.range_max_m, density, no_return)


# %%
checks.beam_model(beam_likelihoods)
print("passed")

# %% [markdown]
# The **likelihood field** only needs the distance $d$ from the end of a beam to the nearest obstacle:
#
# $$ p(z \mid x, m) = z_{hit} N(d; 0, \sigma^2) + \frac{z_{rand}}{z_{top}} $$
#
# It is smooth in the pose and costs one look-up, but it sees through walls.


# %% [task]
def field_log_likelihoods(model, distances):
    """Log likelihood of a beam by the likelihood field.

    Parameters
    ----------
    model : LikelihoodField
        Its parameters: z_hit, z_rand, sigma_hit_m, range_max_m.
    distances : (...) float64, m
        From the end of the beam to the nearest obstacle.

    Returns
    -------
    (...) float64
        Nats.
    """
    peak = model.z_hit / (math.sqrt(math.tau) * model.sigma_hit_m)
    hit = peak * np.exp(-0.5 * np.square(distances / model.sigma_hit_m))
    return np.log(hit + model.z_rand / model.range_max_m)


# %%
checks.likelihood_field(field_log_likelihoods)
print("passed")

# %%
z = np.linspace(0, 7.99, 1600)
plt.plot(z, beam_likelihoods(BeamRangeFinder(range_max_m=8.0, sigma_hit_m=0.25), z, np.full(len(z), 4.0)))
plt.plot(z, np.exp(field_log_likelihoods(LikelihoodField(range_max_m=8.0, sigma_hit_m=0.25), np.abs(z - 4.0))))
plt.legend(["beam model, wall at 4 m", "likelihood field"])
plt.xlabel("measured range, m")
plt.ylabel("density, 1/m")
plt.show()
