"""Reports: one page skeleton with templates; HTML that works offline, the same figures as PNG, the numbers as JSON."""

from impact_rs_analysis.report.analysis import write_analysis_report
from impact_rs_analysis.report.comparison import write_comparison
from impact_rs_analysis.report.diagnosis import write_diagnosis
from impact_rs_analysis.report.history import write_history

write_report = write_analysis_report

__all__ = ["write_analysis_report", "write_comparison", "write_diagnosis", "write_history", "write_report"]
