# SPDX-License-Identifier: Apache-2.0
"""Reports: one page skeleton with templates; HTML that works offline, the same figures as PNG, the numbers as JSON."""

from impact_rs_analysis.report.analysis import write_analysis_report

write_report = write_analysis_report
"""Short name of the report of an analysis; the other reports are functions of their modules."""

__all__ = ["write_analysis_report", "write_report"]
