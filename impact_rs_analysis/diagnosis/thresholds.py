# SPDX-License-Identifier: Apache-2.0
"""Every number on which a verdict turns, with its reason."""

SIGNIFICANT = 0.01  # false-discovery rate: one verdict in a hundred may be chance
DRAWS = 4999  # of a null distribution; its smallest p, 0.0002, survives the adjustment for 25 effects
LEAST_P = 0.0005  # printed as a bound: further out the noise of a real robot follows no law that we know
LEAST_FREEDOM = 3  # degrees of freedom of the pure error; with fewer a factor of 10 in noise may be chance
# Of a simulator left out, the share of its differences that no sum of the others' is: 14 to 67 %, 34 % in the mean.
UNMEASURED = 1.0 / 3.0
LEAST_OWN = 0.01  # of a feature's squared scale that is not discrepancy, lest a direction without noise weighs all
LEAST_CLUSTERS = 3  # that can be held out: with two, one point decides about the other
LEAST_TO_DISAGREE = 4  # clusters that see an effect; of fewer, Student's factor for their scatter is beyond all bounds
FOLDS = 6  # of the outer hold-out, at most: from five on, an error on unseen clusters changes little with their number
NOTHING = 0.1  # p in free motion above which an effect of several parameters is not looked for in contact
LEAST_GAIN = (
    0.10  # share of the excess error on unseen clusters that an accepted effect removes; less is no explanation
)
LEAST_GAIN_OF_FIRST = 0.05  # the same of the first excess, for recordings, where no lack of fit ends the search
LEAST_GAIN_OF_JOINT = 0.05  # the same of one joint's whole error, for a verdict on that joint alone
MOST = 0.5  # share of the excess that an answer explains if "most" is said of it
TIE = 0.05  # log error on unseen clusters; explanations that are closer than 5 % are equally good
WIDE_TIE = 0.25  # the same where their scatter from cluster to cluster is larger: never more than this
UNSEEN = 20.0  # parameter scales; an interval wider than this says nothing
MOST_EFFECTS = 4  # missing at a time; the fifth has always been noise
SHORTLIST = 5  # candidates fitted through the model in every round; the true one has never been further down
SHORTLIST_OF_FOLD = 2  # the same in the folds of the hold-out, where the rest is clear from the first
