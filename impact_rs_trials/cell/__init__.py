# SPDX-License-Identifier: Apache-2.0
"""Trials on real arms: states, arming, trial, brake, watchdog and rehearsal, over any transport and on any clock."""
