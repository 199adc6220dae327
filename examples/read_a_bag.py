# SPDX-License-Identifier: Apache-2.0
"""Read one trial back from its bag, as arrays, and look at its impact.

Shows how a bag is opened, the trial that it holds, and two of its topics as columns. Prints what was run, when the
impact was detected, and the velocity of the end effector before and after it. The bag is any trial of ours; the default
is one of those that examples/campaign.py makes.

    ./run python examples/read_a_bag.py [BAG]
"""

import sys
from pathlib import Path

import numpy as np

from impact_rs_trials.bags import topics
from impact_rs_trials.bags.reader import TrialBag

BAG = Path("campaigns/example/cat_food__case_2__s1.000__r0")


def main(path: Path = BAG) -> tuple[float, float]:
    """Print what the bag says; returns the velocity along the measured axis before and after the impact [m/s]."""
    bag = TrialBag.open(path)
    info, arm = bag.info, bag.info.robots[0]
    print(f"{info.scenario}/{info.object}/{info.case_name}: {bag.outcome}, {sum(bag.counts.values())} messages")

    joints = bag.joints(topics.joint_states(arm))
    print(f"{joints.time.size} samples of {joints.position.shape[1]} joints in {joints.time[-1]:.2f} s")
    print(f"largest joint torque {np.abs(joints.effort).max():.1f} N m")

    impact, states = bag.impact_time(arm), bag.controller(arm)
    along = states.twist[:, "xyz".index(info.axis)]
    before = along[(states.time > impact - 0.02) & (states.time < impact - 0.005)].mean()
    after = along[(states.time > impact + 0.02) & (states.time < impact + 0.04)].mean()
    print(f"impact at {impact:.3f} s (planned {info.nominal_impact_time:.3f} s): {before:+.3f} to {after:+.3f} m/s")
    print(f"predicted after the impact: {info.predicted_post_velocity:+.3f} m/s")
    return float(before), float(after)


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:2]))
