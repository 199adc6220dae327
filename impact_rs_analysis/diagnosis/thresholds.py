# SPDX-License-Identifier: Apache-2.0
"""Thresholds of the verdicts, each with its reason."""

from impact_rs_analysis.inference.noise import UNMEASURED as UNMEASURED

SIGNIFICANT = 0.01  # false-discovery rate: one verdict in a hundred may be chance
NOMINAL = 0.05  # p of an effect as if it were tested alone, below which an investigation looks once more
DRAWS = 4999  # of a null distribution; its smallest p, 0.0002, survives the adjustment for 25 effects
LEAST_P = 0.0005  # printed as a bound: the tails of a real robot's noise are not known further out
LEAST_FREEDOM = 3  # degrees of freedom of the pure error; with fewer its estimate may be wrong by a factor of 10
LEAST_CLUSTERS = 3  # for a hold-out: with two, each is predicted from a single one
NOTHING = 0.1  # p in free motion above which an effect with several parameters is ruled out
LEAST_GAIN = 0.10  # share of the excess held-out error that an accepted effect must remove
LEAST_GAIN_IN_ONE = 0.5  # or of the excess of one joint of a recording, whose noise is not known
MOST = 0.5  # share of the excess that PARTLY must explain
# Times noise and calibrations without repeats, from which a residual needs an explanation: noise is known to a third.
PLAINLY_BEYOND = 2.0
TIE = 0.05  # log of the ratio of squared held-out errors; explanations closer than 5 % are equally good
WIDE_TIE = 0.25  # upper limit of the same where the scatter between clusters is larger
UNSEEN = 20.0  # parameter scales; a wider interval does not determine the parameter
MOST_EFFECTS = 6  # chosen together; more cannot be distinguished in one campaign
MOST_TESTED = (
    40  # effects with a p-value in every round, more than the library has; the others count as tested, with p = 1
)
SHORTLIST = 5  # candidates fitted by simulation in every round; in tests the true one was always among them
MANY = 40  # candidates; among more of them, as among laws, the true one may be further down
LONG_LIST = 20  # of so many instead: a strong drag was the thirteenth of 57 by its slope at nominal
LEAST_ROWS_OF_LEVEL = 3  # of a covariate, beside every fold: one row may be an outlier, two do not say which
LEAST_NUMBERS = 3  # different ones of a covariate: a line through two is a level for each
GOES_WITH = 0.9  # canonical correlation of covariates; of the variance of one, a fifth is then not that of the other
