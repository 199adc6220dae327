# SPDX-License-Identifier: Apache-2.0
"""The offline side, free of ROS: bags, net feedback, comparison, diagnosis and report.

Compare a model with measurements, and find what it lacks::

    from impact_rs_analysis import compare, diagnose, read_measurements

    measured = read_measurements("campaigns/example")  # or a laboratory's bags with an experiment.yaml
    comparison = compare(measured)
    print(f"error: {comparison.score:.2f} times repeatability")
    for place in comparison.where[:3]:
        print(f"{place.phase}: {place.signal} {place.index} {place.error:+.3g} {place.unit}")

    document = diagnose(measured)
    print(document.verdict, document.summary)
    for name in document.named:
        for key, value in document.effect(name).parameters.items():
            print(f"{name}: {key} = {value.estimate:.4g} {value.unit}, 95 % interval {value.interval}")

The names below are imported when they are first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from impact_rs_sim.lazy_names import lazy_names

if TYPE_CHECKING:
    from impact_rs_analysis.application.measurements import MeasurementOptions as MeasurementOptions
    from impact_rs_analysis.application.measurements import Measurements as Measurements
    from impact_rs_analysis.application.measurements import open_measurements as open_measurements
    from impact_rs_analysis.application.measurements import read_measurements as read_measurements
    from impact_rs_analysis.diagnosis.compare import ComparisonDocument as ComparisonDocument
    from impact_rs_analysis.diagnosis.compare import compare as compare
    from impact_rs_analysis.diagnosis.diagnose import diagnose as diagnose
    from impact_rs_analysis.diagnosis.document import DiagnosisDocument as DiagnosisDocument
    from impact_rs_analysis.diagnosis.document import read_document as read_document
    from impact_rs_analysis.diagnosis.document import write_document as write_document
    from impact_rs_analysis.diagnosis.history import history as history
    from impact_rs_analysis.diagnosis.laws.discover import discover as discover
    from impact_rs_analysis.evidence.calibration import LaboratoryCalibration as LaboratoryCalibration
    from impact_rs_analysis.evidence.calibration import calibration_of as calibration_of
    from impact_rs_analysis.evidence.source import Source as Source
    from impact_rs_analysis.evidence.sources.recording_source import RecordingSource as RecordingSource
    from impact_rs_analysis.evidence.sources.run_source import ReplaySource as ReplaySource
    from impact_rs_analysis.evidence.sources.table_source import ImpactTableSource as ImpactTableSource
    from impact_rs_analysis.measure.analyze import ExperimentSet as ExperimentSet
    from impact_rs_analysis.measure.analyze import analyze_campaign as analyze_campaign

MODULES = {
    "application.measurements": ("MeasurementOptions", "Measurements", "open_measurements", "read_measurements"),
    "diagnosis.compare": ("ComparisonDocument", "compare"),
    "diagnosis.diagnose": ("diagnose",),
    "diagnosis.laws.discover": ("discover",),
    "diagnosis.document": ("DiagnosisDocument", "read_document", "write_document"),
    "diagnosis.history": ("history",),
    "evidence.calibration": ("LaboratoryCalibration", "calibration_of"),
    "evidence.sources.table_source": ("ImpactTableSource",),
    "evidence.sources.recording_source": ("RecordingSource",),
    "evidence.sources.run_source": ("ReplaySource",),
    "evidence.source": ("Source",),
    "measure.analyze": ("ExperimentSet", "analyze_campaign"),
}
__all__ = sorted(name for names in MODULES.values() for name in names)  # noqa: PLE0605
__getattr__ = lazy_names(__name__, MODULES)
