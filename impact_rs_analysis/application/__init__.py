# SPDX-License-Identifier: Apache-2.0
"""Steps of the loop as the command line, the workbench and Python take them: open measurements, compare, diagnose, add.

Nothing here prints: results are returned, and progress goes to an observer.
"""
