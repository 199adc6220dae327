# SPDX-License-Identifier: Apache-2.0
"""Faults of the readings in the words of a laboratory: degrees, milliseconds and percent, the measurement first."""

from __future__ import annotations

import math

import pytest

from impact_rs_analysis.diagnosis.document import DiagnosisDocument, EffectDocument, EstimateDocument
from impact_rs_analysis.diagnosis.verdict import NONE, SMALL, DiagnosisVerdict
from impact_rs_analysis.diagnosis.verdicts.measurement import clauses_of, experiments_of, measurement_of
from impact_rs_analysis.diagnosis.verdicts.words import summary_of
from impact_rs_sim.effects import library
from impact_rs_sim.effects.depending import Depending, Levels
from impact_rs_sim.effects.each_arm import of_each

OFFSET, GAIN, DELAY, FRAME = (
    "{joint} reads {size} {more}",
    "the torque of {joint} reads {size} {more}",
    "torques are recorded {size} {late}",
    "the tracker's frame is off by {size}",
)


def value(estimate: float, half: float | None, unit: str, nominal: float = 0.0, **more: object) -> EstimateDocument:
    ci95 = None if half is None else (estimate - half, estimate + half)
    return EstimateDocument(estimate=estimate, ci95=ci95, unit=unit, nominal=nominal, **more)  # type: ignore[arg-type]


def effect(name: str, reading: str, **parameters: EstimateDocument) -> EffectDocument:
    return EffectDocument(
        name=name, of_measurement=True, reading=reading, calibration="hold still in six poses", verdict="CONFIRMED",
        parameters=parameters, held_out_error_before=9.0, held_out_error_after=1.0, p_value=0.0005,
    )  # fmt: skip


ENCODER = effect(
    "encoder_offset",
    OFFSET,
    offset_joint1=value(0.0001, 0.0002, "rad", joint="joint1"),
    offset_joint2=value(-0.0089, 0.00018, "rad", joint="joint2"),
    offset_joint3=value(0.5e-3, 0.2e-3, "m", joint="joint3"),
)
PAYLOAD = EffectDocument(
    name="object_mass", verdict="CONFIRMED", parameters={"scale": value(1.1, 0.02, "-", 1.0)},
    held_out_error_before=9.0, held_out_error_after=1.0, p_value=0.0005,
)  # fmt: skip


def document(verdict: str | DiagnosisVerdict, *named: EffectDocument, **more: object) -> DiagnosisDocument:
    content: dict[str, object] = {
        "verdict": verdict, "named": [one.name for one in named], "effects": [ENCODER, PAYLOAD], "confusable": (),
        "noise_floor": 1.0, "held_out_error_before": 9.0, "held_out_error_after": 1.5, "error_unit": "N m",
        "model": {"name": "nominal", "digest": ""}, "runs": {"digest": "", "trials": 12, "conditions": []},
    }  # fmt: skip
    return DiagnosisDocument.model_validate(content | more)


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (ENCODER,
         ["joint 2 reads 0.510 degrees too little [0.500, 0.520]", "joint 3 reads 0.50 mm too much [0.30, 0.70]"]),
        (effect("gain", GAIN, gain_joint4=value(0.93, 0.01, "-", 1.0, joint="joint4")),
         ["the torque of joint 4 reads 7.0 % too little [6.0, 8.0]"]),
        (effect("delay", DELAY, delay=value(-0.02, 1e-3, "s")), ["torques are recorded 20.0 ms early [19.0, 21.0]"]),
        (effect("delay", DELAY, delay=value(0.02, None, "s")), ["torques are recorded 20 ms late"]),
        (effect("tracker_frame", FRAME, x=value(-0.008, 2e-4, "m"), y=value(1e-4, 2e-4, "m"),
                yaw=value(math.radians(1.6), math.radians(0.1), "rad")),
         ["the tracker's frame is off by x -8.00 mm [-8.20, -7.80], yaw 1.60 degrees [1.50, 1.70]"]),
        (effect("zero", "", zero=value(0.3, 0.1, "N m", meaning="reading without torque")),
         ["reading without torque: 0.30 N m [0.20, 0.40]"]),
        (effect("offset", OFFSET, offset_left_joint2=value(0.01, 1e-3, "rad", joint="joint2", arm="left")),
         ["joint 2 of left reads 0.573 degrees too much [0.516, 0.630]"]),
        (effect("crosstalk", "{joint} reads its neighbours: {size}",
                from_next_joint1=value(0.03, 0.001, "-", joint="joint1"),
                from_previous_joint2=value(0.0, 0.001, "-", joint="joint2"),
                from_next_joint2=value(-0.02, 0.001, "-", joint="joint2")),
         ["joint 1 reads its neighbours: from next 3.00 % [2.90, 3.10]",
          "joint 2 reads its neighbours: from next -2.00 % [-2.10, -1.90]"]),
        (effect("offset", OFFSET, offset_joint1=value(1e-4, 2e-4, "rad", scale=2e-3, joint="joint1"),
                offset_joint2=value(-3e-4, 4e-4, "rad", scale=2e-3, joint="joint2")),
         ["joint 2 reads 0.017 degrees too little [-0.006, 0.040]"]),
    ],
)  # fmt: skip
def test_a_fault_in_units_and_directions_of_a_laboratory(found: EffectDocument, words: list[str]) -> None:
    """Kills: a sign, a factor or ends that are not exchanged; joints whose interval holds the nominal value."""
    assert clauses_of(found) == words


def test_a_joint_that_is_confirmed_hides_those_whose_interval_just_excludes_nominal() -> None:
    """Of seven intervals of 95 % one misses the truth in three campaigns of ten; kills a list by intervals alone."""
    joints = {
        "offset_joint1": value(0.0008, 0.0006, "rad", joint="joint1", verdict="NO-IMPROVEMENT"),
        "offset_joint4": value(0.0126, 0.0006, "rad", joint="joint4", verdict="CONFIRMED"),
    }
    assert clauses_of(effect("encoder_offset", OFFSET, **joints)) == [
        "joint 4 reads 0.722 degrees too much [0.688, 0.756]"
    ]


def test_the_measurement_is_said_first_and_the_physics_is_not_blamed() -> None:
    """Kills: ``lacks`` beside a fault, or "nothing is missing" where something is missing, tied or open."""
    said = "The measurement: joint 2 reads 0.510 degrees too little [0.500, 0.520]; joint 3 reads 0.50 mm too much"
    alone = summary_of(document("encoder_offset", ENCODER))
    assert alone.startswith(said) and "(encoder_offset). No physical effect is missing. Held-out" in alone
    assert "lacks" not in alone
    both = summary_of(document("encoder_offset+object_mass", ENCODER, PAYLOAD))
    assert both.startswith(said) and "object_mass is missing in the physics." in both and "lacks" not in both
    partly = summary_of(document("PARTLY{encoder_offset}", ENCODER))
    assert partly.startswith(said) and "nothing" not in partly
    assert "At least one more effect, of the measurement or of the physics" in partly
    small = summary_of(document(SMALL, ENCODER))
    assert small.startswith(said) and "Neither calibration nor model needs a change." in small
    tied = summary_of(document("encoder_offset", ENCODER, confusable=[["encoder_offset", "object_mass"]]))
    assert tied.startswith(said) and "nothing is missing" not in tied
    assert "These data cannot distinguish encoder_offset from object_mass." in tied
    other = summary_of(document("object_mass", PAYLOAD, confusable=[["object_mass", "encoder_offset"]]))
    assert other.startswith("The measurement may be at fault. These data cannot distinguish object_mass from")
    assert "Model 'nominal' lacks object_mass." in other
    nothing = document(NONE, ENCODER)
    assert measurement_of(nothing) == "" and summary_of(nothing).startswith("No effect in the library")
    suspected = summary_of(document("NOTHING-MISSING", suspected=["object_mass", "encoder_offset"]))
    assert "The measurement may be at fault (encoder_offset) and object_mass may be missing: with them" in suspected


def test_faults_that_are_named_tied_or_suspected_have_their_experiment() -> None:
    for found in (
        document("encoder_offset", ENCODER),
        document("object_mass", PAYLOAD, confusable=[["object_mass", "encoder_offset"]]),
        document("NOTHING-MISSING", suspected=["encoder_offset"]),
    ):
        (one,) = experiments_of(found)
        assert (one.effect, one.experiment) == ("encoder_offset", "hold still in six poses")
    assert experiments_of(document("object_mass", PAYLOAD)) == ()


@pytest.mark.parametrize("name", [name for name, one in library().items() if one.reading])
def test_clauses_of_the_library_have_no_other_places(name: str) -> None:
    """Kills: a place that no formatter fills, and a direction beside several sizes."""
    one = library()[name]
    assert one.of_measurement and one.calibration and not one.calibration.endswith(".")
    words = {"joint": "J", "size": "S", "more": "M", "late": "L"}
    assert "S" in one.reading.format(**words)
    if len(one.parameters) > 1:
        assert "{more}" not in one.reading and "{late}" not in one.reading


def test_arms_of_their_own_and_circumstances_keep_what_is_said_of_a_reading() -> None:
    one = library()["torque_delay"]
    for other in (of_each(one, {"left": 7, "right": 6}), Depending(one, "session", Levels(("A", "B")))):
        assert other.of_measurement and (other.reading, other.calibration) == (one.reading, one.calibration)
