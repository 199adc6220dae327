# SPDX-License-Identifier: Apache-2.0
"""Thresholds of verdicts, grouped by the question that they decide, each with its reason.

Numerical constants (tolerances, caches, steps of a fit) are in the modules that use them.
``docs/evidence.md`` shows the verdicts with each of these halved and doubled.
"""

from impact_rs_analysis.evidence.cluster import INDEPENDENT_DISCREPANCY_SHARE as INDEPENDENT_DISCREPANCY_SHARE
from impact_rs_analysis.evidence.cluster import SHARED_DISCREPANCY_SHARE as SHARED_DISCREPANCY_SHARE
from impact_rs_analysis.evidence.minimum_data import MIN_BLOCKS as MIN_BLOCKS
from impact_rs_analysis.evidence.minimum_data import MIN_CLUSTERS as MIN_CLUSTERS
from impact_rs_analysis.evidence.minimum_data import MIN_DEGREES_OF_FREEDOM as MIN_DEGREES_OF_FREEDOM

# How small does a p-value have to be?
SIGNIFICANCE_LEVEL = 0.01  # false discovery rate (Benjamini-Hochberg): one verdict in a hundred may be due to chance
UNADJUSTED_LEVEL = 0.05  # of an effect as if it were the only test; below, an investigation measures once more
MIN_P_IN_FREE_MOTION = 0.1  # above, an effect with several parameters is ruled out by free motion
MIN_REPORTED_P = 0.0005  # printed as a bound: the tails of a real robot's noise are not known further out

# What is the null distribution?
NULL_DRAWS = 4999  # rotations; the smallest p, 0.0002, survives the adjustment for 25 effects
PRIOR_DEGREES_OF_FREEDOM = 3  # d_0 of the moderated variance, whose weight is that of d_0 contrasts
MAX_CALIBRATION_ERROR = 3.0  # standard deviations that a calibration explains at most; a uniform prior ends at 1.7
MAX_NOISE_RATIO = 2.0  # residual over noise and calibrations, without repeats: noise is uncertain by a third

# How much better must a model predict held-out data?
MIN_GAIN_SHARE = 0.10  # of the excess held-out error, which an accepted effect must remove
MIN_GAIN_SHARE_OF_JOINT = 0.5  # likewise, of the excess of one joint of a recording: its noise is unknown
MIN_EXPLAINED_SHARE = 0.5  # of the squared error beyond noise, which PARTLY must explain
TIE_LOG_RATIO = 0.05  # of squared held-out errors; explanations closer than 5 % are equally good
MAX_TIE_LOG_RATIO = 0.25  # upper limit of a tie by the scatter between clusters
MAX_ERROR_RATIO = 3.0  # squared error over the squared error of the best fit; above, a fit is dropped

# Do the data determine a parameter?
MAX_HALF_WIDTH = 20.0  # parameter scales; a wider interval does not determine the parameter
PRIOR_DEVIATION = 100.0  # parameter scales; bounds only parameters that the data do not determine
MIN_CLUSTERS_OF_EFFECT = 2  # clusters that depend on an effect: its search predicts one from the other
MIN_REPORTED_CORRELATION = 0.8  # of two estimates; smaller correlations are not reported
MIN_CONFOUNDED_SHARE = 0.85  # share of the variance of the order between conditions; three in a row have 0.89

# How many candidates does a search fit?
MAX_EFFECTS = 6  # chosen together; one campaign cannot distinguish more
SHORTLIST_SIZE = 5  # candidates fitted by simulation per round; the first round adds the smallest p-value of the others

# Can there be a law of this form?
MIN_RESIDUAL_RATIO_OF_LAW = 1.5  # times repeatability; a smaller residual shows no law
MIN_SHARE_OF_LARGEST_RESIDUAL = 0.25  # likewise: one joint moves the others, and is the cause

# Can a parameter depend on a covariate?
MIN_ROWS_OF_LEVEL = 3  # outside every fold: one of two rows may be an outlier
MIN_DISTINCT_NUMBERS = 3  # a line through two numbers is a value for each level
MIN_CANONICAL_CORRELATION = 0.9  # of confounded covariates: they share four fifths of their variance
