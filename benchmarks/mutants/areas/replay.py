# SPDX-License-Identifier: Apache-2.0
"""Replays: where they start, what drives them, what is read off them."""

from mutant import Mutant

REPLAY = "impact_rs_analysis/evidence/replay.py"
FREE = "impact_rs_sim/free_motion.py"
FEATURES = "impact_rs_analysis/evidence/features.py"
DRIVE = "impact_rs_sim/drive.py"
LABORATORY = "impact_rs_analysis/evidence/laboratory.py"
ANTE = "impact_rs_analysis/evidence/ante_impact.py"
JUMPS = "impact_rs_analysis/measure/laboratory.py"
TESTS = ("test/impact_rs_analysis/evidence/test_replay.py",)
FREE_TESTS = ("test/impact_rs_sim/test_free_motion.py",)
LABORATORY_TESTS = ("test/impact_rs_analysis/evidence/test_laboratory_runs.py",)

MUTANTS = [
    Mutant(
        name="delay_the_other_way",
        file=REPLAY,
        original="grid = np.arange(len(held) + 1) * period - delay",
        mutated="grid = np.arange(len(held) + 1) * period + delay",
        wrong="Delayed torque arrives early.",
        tests=TESTS,
    ),
    Mutant(
        name="command_one_tick_late",
        file=REPLAY,
        original='side="right") - 1, 0)',
        mutated='side="right") - 2, 0)',
        wrong="Every command acts one message late.",
        tests=TESTS,
    ),
    Mutant(
        name="start_of_position_alone",
        file=REPLAY,
        original="q[joint], dq[joint] = solution[0] + a[0], solution[1]",
        mutated="q[joint], dq[joint] = solution[0] + a[0], 0.0",
        wrong="A replay starts at rest.",
        tests=TESTS,
    ),
    Mutant(
        name="motor_starts_with_the_link",
        file=DRIVE,
        original="            link.velocity + drive.torque_rate / self._stiffness,",
        mutated="            link.velocity - drive.torque_rate / self._stiffness,",
        wrong="The spring of a starting motor is stretched the other way.",
        tests=(*FREE_TESTS, *TESTS, "test/impact_rs_sim/test_drive.py"),
    ),
    Mutant(
        name="free_loads_on_links_sign",
        file=FREE,
        original="(tick + 1) * substeps], on_links)",
        mutated="(tick + 1) * substeps], -on_links)",
        wrong="Loads of a free motion act the other way.",
        tests=FREE_TESTS,
    ),
    Mutant(
        name="link_torque_without_damping",
        file=DRIVE,
        original="return np.asarray(desired + self._damping / self._stiffness * rate)",
        mutated="return np.asarray(desired - self._damping / self._stiffness * rate)",
        wrong="The damping of the transmission feeds it.",
        tests=(*TESTS, "test/impact_rs_sim/test_drive.py"),
    ),
    Mutant(
        name="motor_balance_without_inertia",
        file=FEATURES,
        original="- damped - self.physics.motor_inertia_reduced * ramp, link",
        mutated="+ damped - self.physics.motor_inertia_reduced * ramp, link",
        wrong="The motor-side balance counts the passed torque the other way.",
        tests=TESTS,
    ),
    Mutant(
        name="onset_of_all_that_is_lost",
        file=FEATURES,
        original="level = min(max(ONSET * speed, TIMES_NOISE * noise), MOST_OF_LOSS * float(loss.max()))",
        mutated="level = max(ONSET * speed, TIMES_NOISE * noise)",
        wrong="A light object is never hit.",
        tests=TESTS,
    ),
    Mutant(
        name="command_offset_sign",
        file=LABORATORY,
        original="command_time={name: time + offsets[name] for name, time in run.command_time.items()}",
        mutated="command_time={name: time - offsets[name] for name, time in run.command_time.items()}",
        wrong="Commands are shifted away from where they act.",
        tests=LABORATORY_TESTS,
    ),
    Mutant(
        name="a_command_acts_from_the_next_period_on",
        file="impact_rs_analysis/evidence/replay.py",
        original="    if np.array_equal(rows, last):",
        mutated="    if True:",
        wrong="A command that begins within a period of the torque loop waits for the next, up to 0.25 ms.",
        tests=("test/impact_rs_analysis/evidence/test_replay.py",),
    ),
    Mutant(
        name="a_real_delay_is_taken_out",
        file=LABORATORY,
        original="if abs(offset) > largest + SURE * error:",
        mutated="if abs(offset) > 100.0 * largest + SURE * error:",
        wrong="A delay of the actuation is taken for an offset of clocks.",
        tests=LABORATORY_TESTS,
    ),
    Mutant(
        name="object_moved_into_the_pad",
        file=ANTE,
        original="-meeting.separation * meeting.normal",
        mutated="meeting.separation * meeting.normal",
        wrong="The object is moved away from the pad.",
        tests=LABORATORY_TESTS,
    ),
    Mutant(
        name="controller_pushes_back",
        file=JUMPS,
        original="driving[row - 1] - terms.bias - opposed",
        mutated="terms.bias - driving[row - 1] - opposed",
        wrong="The recorded torque acts the other way in the prediction.",
        tests=LABORATORY_TESTS,
    ),
    Mutant(
        name="object_left_behind_sideways",
        file=JUMPS,
        original="plane = terms.jacobian[:2]",
        mutated="plane = np.outer(way, way)[:2] @ terms.jacobian[:3]",
        wrong="Beside the direction of the hit the pad moves on as if there were no object.",
        tests=LABORATORY_TESTS,
    ),
    Mutant(
        name="gap_in_a_window",
        file=REPLAY,
        original="return not run.within_gap(start - FIT, start + FREE + FIT)",
        mutated="return True",
        wrong="Windows of free motion reach across gaps.",
        tests=LABORATORY_TESTS,
    ),
    Mutant(
        name="gaps_rename_windows",
        file="impact_rs_analysis/evidence/measured.py",
        original="replace(f, bin=numbers[f.bin])",
        mutated="replace(f, bin=f.bin)",
        wrong="Behind a gap a window of one repeat is compared with the next one of another.",
        tests=LABORATORY_TESTS,
    ),
]
