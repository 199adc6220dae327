# SPDX-License-Identifier: Apache-2.0
"""Documents that hold everything a page may show, and documents that hold as little as they may."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from impact_rs_analysis.diagnosis.compare import (
    Cell,
    ComparisonDocument,
    ConditionScore,
    JumpLevel,
    LeftOut,
    Level,
    SignalLevel,
)
from impact_rs_analysis.diagnosis.document import (
    TIMES,
    CorrelatedPair,
    DesignDocument,
    DiagnosisDocument,
    DiscrepancyDocument,
    EffectDocument,
    EstimateDocument,
    HoldOutDocument,
    Identifiability,
    JointError,
    LackOfFit,
    ModelIdentity,
    NextExperiment,
    RecordingDocument,
    RestDocument,
    RunsIdentity,
    SizeDocument,
    UnexplainedDocument,
)
from impact_rs_analysis.diagnosis.history import Version, VersionError
from impact_rs_analysis.evidence.tracks import TrackSet, TrackSignal
from impact_rs_sim.model import Model, load_model
from impact_rs_sim.paths import config_directory

MODEL = ModelIdentity(name="nominal", digest="0")
RECORDING = RecordingDocument(
    files=("/somewhere/recording.db3",),
    robot="franka_fer",
    end_effector_mass_kg=0.73,
    samples=727,
    recorded_s=24.2,
    used_s=22.9,
    sampled_Hz=30.0,
    low_pass_Hz=3.0,
)


def effect(name: str, verdict: str, **changes: object) -> EffectDocument:
    """An effect that was found, unless told otherwise."""
    facts: dict[str, object] = {
        "parameters": {"mass": EstimateDocument(estimate=1.101, ci95=(1.08, 1.12), unit="kg", meaning="its mass")},
        "held_out_error_before": 61.8,
        "held_out_error_after": 1.3,
        "p_value": 0.0005,
    }
    return EffectDocument(name=name, verdict=verdict, **(facts | changes))  # type: ignore[arg-type]


@pytest.fixture
def comparison() -> ComparisonDocument:
    """Trials of two conditions against a model."""
    place = {"scenario": "push", "object": "juice", "case": "case_2"}
    velocity = {"phase": "impact", "signal": "end-effector velocity"}
    return ComparisonDocument(
        source="trials",
        model=MODEL,
        trials=12,
        conditions=(
            ConditionScore(name="push/juice/case_2", repeats=6, score=71.5),
            ConditionScore(name="excite/none/slow", repeats=6, score=1.1),
        ),
        score=61.8,
        score_is="size of the difference",
        score_unit=TIMES,
        noise_floor=1.0,
        levels={
            "jump": Level(
                what="velocity jump of the impact map",
                times_noise=7.7,
                entries=(
                    JumpLevel(
                        **place, signal="object velocity", index="y", measured=0.51, predicted=0.48, error=0.03,
                        unit="m/s", times_noise=7.7,
                    ),
                ),
            ),
            "free_motion": Level(what="torque balances", times_noise=0.9),
            "trial": Level(
                what="the twin in closed loop",
                times_noise=12.0,
                signals=(
                    SignalLevel(
                        **velocity, error=0.036, noise_floor=0.0011, discrepancy=0.0022, floor=0.003, unit="m/s",
                        times_noise=12.0,
                    ),
                ),
            ),
        },
        where=(
            Cell(**place, **velocity, index="y", error=-0.041, unit="m/s", floor=0.003, share=0.62, times_noise=14.0),
            Cell(
                scenario="excite", object="none", case="slow", phase="free", signal="motor torque balance",
                index="joint3", error=0.021, unit="N m", floor=0.01, share=0.05, times_noise=2.9,
            ),
        ),
        skipped=(LeftOut(name="juice__case_2__r7", reason="NO-IMPACT: nothing was hit"),),
        discrepancy=DiscrepancyDocument(used=True, provenance="two engines, 9 conditions"),
        remarks=("the gripper was open",),
    )  # fmt: skip


@pytest.fixture
def comparison_of_recordings() -> ComparisonDocument:
    """A recording against a model."""
    joints = [("joint1", 0.48, 0.2), ("joint2", 0.31, 0.16)]
    return ComparisonDocument(
        source="recordings",
        model=MODEL,
        trials=1,
        conditions=(ConditionScore(name="/somewhere/recording.db3", repeats=24, score=0.379),),
        score=0.379,
        score_is="root mean square of recorded minus predicted joint torque",
        score_unit="N m",
        noise_floor=0.128,
        levels={
            "recording": Level(
                what="torque balance",
                times_noise=2.2,
                signals=tuple(
                    SignalLevel(
                        phase="free", signal="torque", index=joint, error=error, mean=-0.26, noise_floor=noise,
                        unit="N m", times_noise=error / noise,
                    )
                    for joint, error, noise in joints
                ),
            )
        },
        where=(
            Cell(
                scenario="recording.db3", object="", case="", phase="moving down", signal="torque", index="joint1",
                error=-0.62, unit="N m", floor=0.0, share=0.4, times_noise=3.2,
            ),
        ),
        not_measured=("velocity jump", "object"),
        recording=RECORDING,
    )  # fmt: skip


@pytest.fixture
def diagnosis() -> DiagnosisDocument:
    """Trials from which two effects were named, with everything that can be said."""
    size = SizeDocument(phase="impact", signal="end-effector velocity", value=0.004, unit="m/s", floor=0.003)
    return DiagnosisDocument(
        verdict="object_mass+joint_coulomb_friction",
        summary="Model 'nominal' lacks object_mass and joint_coulomb_friction.",
        named=("object_mass", "joint_coulomb_friction"),
        effects=(
            effect(
                "object_mass", "CONFIRMED", held_out_error_alone=1.4, sizes=(size,), chosen_in_folds=5,
                reason="predicts unseen data",
            ),
            effect(
                "joint_coulomb_friction",
                "CONFUSABLE-WITH{joint_stribeck_friction}",
                rivals=("joint_stribeck_friction",),
                parameters={
                    "coulomb_joint4": EstimateDocument(
                        estimate=0.31, ci95=(0.29, 0.33), unit="N m", joint="joint4", verdict="AT-BOUND", p_value=0.004,
                        error_before=0.44, error_after=0.12,
                    )
                },
            ),
            effect("base_tilt", "NO-IMPROVEMENT", held_out_error_after=60.2, held_out_error_others=1.3, p_value=0.42),
            effect(
                "restitution", "NOT-IDENTIFIABLE", measured=False, parameters={}, p_value=None,
                held_out_error_before=None, held_out_error_after=None,
            ),
        ),
        confusable=(("joint_coulomb_friction", "joint_stribeck_friction"),),
        unexplained=UnexplainedDocument(
            share_of_excess=0.07,
            where=(
                RestDocument(
                    phase="push", signal="contact force", index="z", value=0.21, unit="N", floor=0.05, share=0.55,
                    times_noise=3.3,
                ),
            ),
        ),
        next_experiment=NextExperiment(
            advice="run a motion there and back", splits=("joint_coulomb_friction", "joint_stribeck_friction"),
            scenario="excite", object="none", case="fast", expected_information=17.0, already_measured=False,
        ),
        model=MODEL,
        runs=RunsIdentity(digest="0", trials=12, conditions=("push/juice/case_2", "excite/none/slow")),
        noise_floor=1.0,
        held_out_error_before=61.8,
        held_out_error_after=1.6,
        held_out_change_ci95=(-71.2, -49.2),
        hold_out=HoldOutDocument(what="conditions with all their repeats", folds=6),
        lack_of_fit=LackOfFit(before=0.0005, after=0.0031),
        design=DesignDocument(clusters=2, freedom=10),
        discrepancy=DiscrepancyDocument(used=True, provenance="two engines, 9 conditions"),
        identifiability=Identifiability(
            singular_values=(210.0, 7.0), condition_number=30.0,
            correlated=(CorrelatedPair(first="mass", second="coulomb_joint4", correlation=-0.87),),
        ),
        remarks=("no free motion was measured",),
    )  # fmt: skip


@pytest.fixture
def diagnosis_of_recordings() -> DiagnosisDocument:
    """A recording from which one effect was named."""
    return DiagnosisDocument(
        source="recordings",
        verdict="joint_coulomb_friction",
        named=("joint_coulomb_friction",),
        effects=(
            effect("joint_coulomb_friction", "CONFIRMED", held_out_error_before=0.379, held_out_error_after=0.16),
        ),
        confusable=(),
        model=MODEL,
        runs=RunsIdentity(digest="", trials=1, conditions=("recording.db3",)),
        error_unit="N m",
        noise_floor=0.128,
        held_out_error_before=0.379,
        held_out_error_after=0.19,
        joints=(JointError(joint="joint1", before=0.48, after=0.21, noise=0.2),),
        recording=RECORDING,
    )


@pytest.fixture
def minimal_diagnosis() -> DiagnosisDocument:
    """As little as a diagnosis may say, as one that an earlier version wrote."""
    return DiagnosisDocument(
        verdict="NONE-EXPLAINS",
        effects=(),
        confusable=(),
        model=MODEL,
        runs=RunsIdentity(digest="0", trials=2, conditions=("push/juice/case_2",)),
        error_unit="times the noise",
        noise_floor=0.41,
        held_out_error_before=1.2,
        held_out_error_after=1.2,
    )


@pytest.fixture
def minimal_comparison() -> ComparisonDocument:
    """As little as a comparison may say: nothing was repeated."""
    return ComparisonDocument(
        source="trials",
        model=MODEL,
        trials=1,
        conditions=(),
        score=5.2,
        score_is="size of the difference",
        score_unit="-",
        noise_floor=None,
        levels={},
        where=(),
    )


@pytest.fixture
def tracks() -> tuple[TrackSet, ...]:
    """A trial with an impact and one without; a sample is missing in one."""
    time = np.linspace(0.0, 1.8, 1801)
    gap = np.where(time > 1.0, np.nan, np.sin(time))
    return (
        TrackSet("juice, case_2", 0.9, time, (TrackSignal("end-effector velocity y", "m/s", np.cos(time), gap),)),
        TrackSet("slow", None, time, (TrackSignal("torque of joint 1", "N m", np.cos(time), np.sin(time)),)),
    )


@pytest.fixture
def nominal() -> Model:
    """The nominal model."""
    return load_model(Path(config_directory()) / "models" / "nominal.yaml")


@pytest.fixture
def versions(nominal: Model) -> list[VersionError]:
    """A model and its parent, which have one name."""
    return [
        VersionError(Version("nominal.yaml", nominal, None), 61.8, 61.8, 1.0),
        VersionError(Version("model_2.yaml", nominal, "object_mass"), 1.4, 2.25, 1.0),
    ]
