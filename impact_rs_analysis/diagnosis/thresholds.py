# SPDX-License-Identifier: Apache-2.0
"""Numbers on which a verdict turns, by the question that they decide, each with its reason.

Numbers of pure numerics (tolerances, caches, steps of a fit) stand in the modules that use them.
``docs/evidence.md`` shows the verdicts with each of these halved and doubled.
"""

from impact_rs_analysis.evidence.cluster import INDEPENDENT_DISCREPANCY_SHARE as INDEPENDENT_DISCREPANCY_SHARE
from impact_rs_analysis.evidence.cluster import SHARED_DISCREPANCY_SHARE as SHARED_DISCREPANCY_SHARE
from impact_rs_analysis.evidence.minimum_data import MIN_BLOCKS as MIN_BLOCKS
from impact_rs_analysis.evidence.minimum_data import MIN_CLUSTERS as MIN_CLUSTERS
from impact_rs_analysis.evidence.minimum_data import MIN_DEGREES_OF_FREEDOM as MIN_DEGREES_OF_FREEDOM

# How small does a p-value have to be?
SIGNIFICANCE_LEVEL = 0.01  # false discovery rate (Benjamini-Hochberg): one verdict in a hundred may be chance
UNADJUSTED_LEVEL = 0.05  # of an effect as if it were tested alone; below, an investigation measures once more
MIN_P_IN_FREE_MOTION = 0.1  # above, an effect with several parameters is ruled out by free motion
MIN_REPORTED_P = 0.0005  # printed as a bound: the tails of a real robot's noise are not known further out

# What is the null distribution?
NULL_DRAWS = 4999  # rotations; the smallest p, 0.0002, survives the adjustment for 25 effects
PRIOR_DEGREES_OF_FREEDOM = 3  # d_0 of the moderated variance, whose weight is that of d_0 contrasts
MAX_CALIBRATION_ERROR = 3.0  # standard deviations that a calibration explains; a uniform prior ends at 1.7
MAX_NOISE_RATIO = 2.0  # residual over noise and calibrations, without repeats: noise is known to a third

# How much better has a model to predict what it has not seen?
MIN_GAIN_SHARE = 0.10  # of the excess held-out error, which an accepted effect must remove
MIN_GAIN_SHARE_OF_JOINT = 0.5  # or of the excess of one joint of a recording, whose noise is not known
MIN_EXPLAINED_SHARE = 0.5  # of the squared error beyond noise, which PARTLY must explain
TIE_LOG_RATIO = 0.05  # of squared held-out errors; explanations closer than 5 % are equally good
MAX_TIE_LOG_RATIO = 0.25  # upper limit of a tie by the scatter between clusters
MAX_ERROR_RATIO = 3.0  # squared error over that of the best fit; above, a fit is dropped

# Do the data determine it?
MAX_HALF_WIDTH = 20.0  # parameter scales; a wider interval does not determine the parameter
PRIOR_DEVIATION = 100.0  # parameter scales; bounds only parameters that the data do not determine
MIN_CLUSTERS_OF_EFFECT = 2  # clusters that see an effect: its search predicts one from the other
MIN_REPORTED_CORRELATION = 0.8  # of two estimates; below, one is worth listing without the other
MIN_CONFOUNDED_SHARE = 0.85  # variance of the order between conditions; three conditions, one after the other: 0.89

# How many candidates does a search fit?
MAX_EFFECTS = 6  # chosen together; more cannot be distinguished in one campaign
SHORTLIST_SIZE = 5  # candidates fitted by simulation in every round; in the first also the likeliest of the others

# Can there be a law of this form?
MIN_RESIDUAL_RATIO_OF_LAW = 1.5  # times repeatability; a smaller residual shows no law
MIN_SHARE_OF_LARGEST_RESIDUAL = 0.25  # likewise: of joints that move others, one is the cause

# Can a parameter depend on a covariate?
MIN_ROWS_OF_LEVEL = 3  # outside every fold: one row may be an outlier, two do not say which
MIN_DISTINCT_NUMBERS = 3  # a line through two numbers is a value for each level
MIN_CANONICAL_CORRELATION = 0.9  # at which two covariates are confounded: they share four fifths of their variance
