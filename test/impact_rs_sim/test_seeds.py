# SPDX-License-Identifier: Apache-2.0
"""Seeds of tasks depend on the seed of the whole and on the name, on nothing else, and collide with nobody."""

from impact_rs_sim.seeds import seed_of


def test_a_seed_is_the_same_whenever_and_wherever_it_is_asked_for() -> None:
    """Recorded campaigns are run again from these: they must never change."""
    assert seed_of(0, "cat_food__case_2__s1.000__r0") == 11574260439316600728
    assert seed_of(1, "cat_food__case_2__s1.000__r0") != seed_of(0, "cat_food__case_2__s1.000__r0")


def test_no_two_of_many_tasks_share_a_seed() -> None:
    names = [f"{thing}__case_{case}__r{repeat}" for thing in "abc" for case in range(30) for repeat in range(50)]
    assert len({seed_of(seed, name) for seed in range(3) for name in names}) == 3 * len(names)
