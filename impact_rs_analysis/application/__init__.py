# SPDX-License-Identifier: Apache-2.0
"""Steps of the loop for command line, workbench and Python: open measurements, compare, diagnose, add.

No function prints: results are returned, and progress goes to an observer.
"""
