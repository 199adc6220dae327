# SPDX-License-Identifier: Apache-2.0
"""Names of the files of a report, by which the workbench finds them."""

from __future__ import annotations

ANALYSIS_PAGE = "report.html"
COMPARISON_PAGE, COMPARISON_DATA = "compare.html", "compare.json"
DIAGNOSIS_PAGE, DIAGNOSIS_DATA = "diagnosis.html", "diagnosis.json"
DISCOVERY_PAGE = "discovery.html"
HISTORY_PAGE, HISTORY_DATA = "history.html", "history.json"
INVESTIGATION_PAGE = "investigation.html"
LIMITS_PAGE, LIMITS_DATA, LIMITS_TABLE = "limits.html", "limits.json", "limits.csv"
REHEARSAL_PAGE, REHEARSAL_DATA = "rehearsal.html", "rehearsal.json"
DESIGN_STUDY_PAGE, DESIGNS_TABLE = "design_study.html", "designs.csv"

PAGES = (
    ANALYSIS_PAGE,
    COMPARISON_PAGE,
    DIAGNOSIS_PAGE,
    DISCOVERY_PAGE,
    HISTORY_PAGE,
    INVESTIGATION_PAGE,
    LIMITS_PAGE,
    REHEARSAL_PAGE,
    DESIGN_STUDY_PAGE,
)
TABLES = (LIMITS_TABLE, DESIGNS_TABLE)  # next to pages; no recordings
