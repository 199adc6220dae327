# SPDX-License-Identifier: Apache-2.0
"""How a trial ended: the rules by which one that went wrong is told, each with its limit and its duration."""

from mutant import Mutant

FILE = "impact_rs_trials/bags/outcome.py"
TESTS = ("test/impact_rs_trials/test_outcome.py",)
LOOP = "impact_rs_control/closed_loop.py"
QP = "impact_rs_control/qp.py"
QP_TESTS = ("test/impact_rs_control/test_qp.py",)

MUTANTS = [
    Mutant(
        name="runaway_one_way_only",
        file=FILE,
        original="speed = np.abs(joints.velocity) / model.velocity_max",
        mutated="speed = joints.velocity / model.velocity_max",
        wrong="A joint that runs away backwards is not seen.",
        tests=TESTS,
    ),
    Mutant(
        name="runaway_of_the_fastest_joint",
        file=FILE,
        original="speed = np.abs(joints.velocity) / model.velocity_max",
        mutated="speed = np.abs(joints.velocity) / model.velocity_max.max()",
        wrong="All joints have the speed limit of the fastest.",
        tests=TESTS,
    ),
    Mutant(
        name="nan_is_within_bounds",
        file=FILE,
        original="np.flatnonzero(~(speed <= RUNAWAY).all(axis=1))",
        mutated="np.flatnonzero((speed > RUNAWAY).any(axis=1))",
        wrong="A speed that is not a number is within its bound.",
        tests=TESTS,
    ),
    Mutant(
        name="lower_limit_forgotten",
        file=FILE,
        original="beyond = (values < margin * low) | (values > margin * high)",
        mutated="beyond = values > margin * high",
        wrong="A joint beyond its lower stop, or with a torque beyond the negative limit, is within its limits.",
        tests=TESTS,
    ),
    Mutant(
        name="limit_at_its_bound",
        file=FILE,
        original="beyond = (values < margin * low) | (values > margin * high)",
        mutated="beyond = (values <= margin * low) | (values >= margin * high)",
        wrong="What is at its limit is beyond it.",
        tests=TESTS,
    ),
    Mutant(
        name="limit_told_of_the_other_side",
        file=FILE,
        original="limit = high[joint] if worst > high[joint] else low[joint]",
        mutated="limit = low[joint] if worst > high[joint] else high[joint]",
        wrong="The reason names the other stop.",
        tests=TESTS,
    ),
    Mutant(
        name="limit_for_as_long_as_allowed",
        file=FILE,
        original="np.flatnonzero(lasted > longest + ROUNDING)",
        mutated="np.flatnonzero(lasted >= longest - ROUNDING)",
        wrong="A limit passed for exactly as long as allowed is broken.",
        tests=TESTS,
    ),
    Mutant(
        name="joints_counted_from_zero",
        file=FILE,
        original='f"{name} joint{joint + 1}: {what} {worst:.4g}',
        mutated='f"{name} joint{joint}: {what} {worst:.4g}',
        wrong="The reason names the joint before.",
        tests=TESTS,
    ),
    Mutant(
        name="relaxed_is_solved",
        file=FILE,
        original="arm.qp_status != QpStatus.SOLVED",
        mutated="arm.qp_status == QpStatus.FAILED",
        wrong="A QP whose limits gave way counts as solved.",
        tests=TESTS,
    ),
    Mutant(
        name="tilt_from_the_other_axis",
        file=FILE,
        original="1.0 - 2.0 * (x**2 + y**2)), axis=-1)",
        mutated="1.0 - 2.0 * (y**2 + z**2)), axis=-1)",
        wrong="An object that turns about the vertical has tipped over.",
        tests=TESTS,
    ),
    Mutant(
        name="any_arm_hit",
        file=FILE,
        original="    if missed:\n",
        mutated="    if len(missed) == len(recorded.arms):\n",
        wrong="One arm that hit is enough.",
        tests=TESTS,
    ),
    Mutant(
        name="lift_with_the_wrong_sign",
        file=FILE,
        original="seen.position[-1, 2] - seen.position[0, 2]",
        mutated="seen.position[0, 2] - seen.position[-1, 2]",
        wrong="An object that falls has risen.",
        tests=TESTS,
    ),
    Mutant(
        name="the_mildest_is_told",
        file=FILE,
        original="(gravity.index(one.outcome), one.time)",
        mutated="(-gravity.index(one.outcome), one.time)",
        wrong="Of several things that went wrong the mildest is told.",
        tests=TESTS,
    ),
    Mutant(
        name="a_runaway_runs_on",
        file=LOOP,
        original="if number == last or ran_away(plan, measurement.arms, torques):",
        mutated="if number == last:",
        wrong="A plant that blew up is stepped to the end of the trial.",
        tests=TESTS,
    ),
    Mutant(
        name="nan_goes_to_the_solver",
        file=QP,
        original="return all(np.isfinite(part).all() for part in parts)",
        mutated="return all(np.isfinite(part).any() for part in parts)",
        wrong="The solver looks for minutes for the answer to a question with a NaN in it.",
        tests=QP_TESTS,
    ),
]
