"""What Table I of Dinius says, how long it is run here, and what is known from elsewhere to compare with."""

import numpy as np

N = 4
NORMALISATION = 0.01  # ten time steps of 0.001
T1, T1_QUICK = 1000.0, 100.0
T1_MISTAKES, T1_MISTAKES_QUICK = 100.0, 20.0  # of each of the runs
REPLICATES = 16

# Of the independent reference: event-driven C.
COLLISION_RATE, COLLISION_RATE_ERROR = 14.199255785714287, 5.1e-4
RATE_SCATTER = 0.068 * 1000**0.5  # standard deviation of the rate of one run, times √t
SCATTER = np.array([0.03382, 0.03163, 0.02336, 0.02045, 0.02424]) * 1000**0.5  # the same of λ1 … λ5

WITHIN = 5.0  # standard errors
ZERO = 0.01
CLOSED = 1e-9  # pairing and sum
LAW_FROM = 10.0  # some 140 collisions: from then on running exponents are compared with the law of their scatter
