"""The diagnosis as a file: written by ``impact-rs diagnose``, read by ``add``, ``blind score`` and the report."""

from __future__ import annotations

import hashlib
import json
import math
import os
from pathlib import Path
from typing import Any

from pydantic import Field

from impact_rs_analysis.diagnosis.diagnose import Diagnosis
from impact_rs_analysis.evidence.runs import Runs, find_bags
from impact_rs_sim.effects.formula import FormulaSpec
from impact_rs_sim.errors import InputError, did_you_mean
from impact_rs_sim.model import JOINT_COUNT, Model, ModelEffect, ParameterValue, check_model
from impact_rs_sim.paths import config_directory
from impact_rs_sim.schema import Schema, validate
from impact_rs_trials.bags.reader import BagError, TrialBag

NOTHING, NONE = "NOTHING-MISSING", "NONE-EXPLAINS"


class EstimateDocument(Schema):
    """One estimated number."""

    estimate: float = Field(description="estimate, in its unit")
    ci95: tuple[float, float] | None = Field(description="95 % interval, in its unit; null: known without one")
    unit: str = Field(description="unit, '-' where it has none")
    meaning: str = Field("", description="what it is")

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval, in its unit; everything where none is known."""
        return (-math.inf, math.inf) if self.ci95 is None else self.ci95


class EffectDocument(Schema):
    """What the diagnosis says of one effect."""

    name: str = Field(description="effect")
    sentence: str = Field("", description="what it is")
    verdict: str = Field(description="CONFIRMED, CONFUSABLE-WITH{...}, NOT-IDENTIFIABLE, NO-IMPROVEMENT or AT-BOUND")
    parameters: dict[str, EstimateDocument] = Field(description="estimates by name")
    held_out_error_before: float = Field(description="error on unseen conditions without it, in multiples of noise")
    held_out_error_after: float = Field(description="error on unseen conditions with it, in multiples of noise")
    p_value: float = Field(description="adjusted for looking at all effects")


class ModelIdentity(Schema):
    """Which model was diagnosed."""

    name: str = Field(description="name of the model")
    digest: str = Field(description="digest of what it says about the physics")


class RunsIdentity(Schema):
    """Which bags were read."""

    digest: str = Field(description="digest of the bags' names, scenarios and seeds")
    trials: int = Field(description="usable trials")
    conditions: tuple[str, ...] = Field(description="conditions that were measured")


class DiagnosisDocument(Schema):
    """``diagnosis.json``."""

    verdict: str = Field(description="NOTHING-MISSING, NONE-EXPLAINS, or the missing effects joined by +")
    named: tuple[str, ...] = Field((), description="effects that the diagnosis chose")
    effects: tuple[EffectDocument, ...] = Field(description="all effects, best first")
    confusable: tuple[tuple[str, ...], ...] = Field(description="effects that the data cannot tell apart")
    unexplained: dict[str, Any] = Field(description="where the largest remaining differences sit")
    next_experiment: dict[str, Any] | None = Field(None, description="what would split a tie")
    model: ModelIdentity = Field(description="diagnosed model")
    runs: RunsIdentity = Field(description="measurements")
    noise_floor: float = Field(description="held-out error that repetition alone would give")
    held_out_error_before: float = Field(description="held-out error of the model")
    held_out_error_after: float = Field(description="held-out error with the chosen effects")
    lack_of_fit: dict[str, float] = Field(description="p of the residuals being pure error, before and after")
    identifiability: dict[str, Any] = Field({}, description="singular values and correlations of the fit")
    remarks: tuple[str, ...] = Field((), description="what a reader should know")
    formulas: tuple[FormulaSpec, ...] = Field((), description="user-defined effects that were considered")

    @property
    def of_recording(self) -> bool:
        """Whether it is a diagnosis of recordings in free motion, not of trials."""
        return not self.runs.digest

    @property
    def error_unit(self) -> str:
        """Unit of the held-out errors, in words."""
        return "N m" if self.of_recording else "times the noise"

    @property
    def runs_are(self) -> str:
        """What the runs are."""
        return "recordings" if self.of_recording else "trials"

    def effect(self, name: str) -> EffectDocument | None:
        """What is said of one effect."""
        return next((effect for effect in self.effects if effect.name == name), None)


def runs_digest(directory: Path) -> str:
    """Identity of the trials in a folder: names, scenarios and seeds; where the folder lies does not count."""
    rows = []
    for path in find_bags(directory):
        try:
            info = TrialBag(path).info
        except BagError:
            continue
        scenario = hashlib.sha256(info.scenario_json.encode()).hexdigest()
        rows.append(f"{path.name} {scenario} {info.seed}")
    return hashlib.sha256("\n".join(sorted(rows)).encode()).hexdigest()[:16]


def document_of(diagnosis: Diagnosis, runs: Runs, model: Model, formulas: tuple[FormulaSpec, ...]) -> DiagnosisDocument:
    """The diagnosis as a document.

    Args:
        diagnosis: What was found.
        runs: Where.
        model: Of which model, as its file says it.
        formulas: User-defined effects that were considered beside it.
    """
    return DiagnosisDocument(
        verdict=diagnosis.verdict,
        named=_named(diagnosis),
        effects=tuple(
            EffectDocument(
                name=effect.name,
                sentence=effect.sentence,
                verdict=effect.verdict,
                parameters={
                    p.name: EstimateDocument(estimate=p.estimate, ci95=(p.low, p.high), unit=p.unit, meaning=p.meaning)
                    for p in effect.parameters
                },
                held_out_error_before=effect.before,
                held_out_error_after=effect.after,
                p_value=effect.p_value,
            )
            for effect in diagnosis.effects
        ),
        confusable=diagnosis.confusable,
        unexplained=_plain(diagnosis.unexplained),
        next_experiment=_plain(diagnosis.next_experiment),
        model=ModelIdentity(name=model.name, digest=model.digest),
        runs=RunsIdentity(
            digest=runs_digest(runs.directory),
            trials=len(runs.trials),
            conditions=tuple(condition.label for condition in runs.conditions),
        ),
        noise_floor=diagnosis.noise,
        held_out_error_before=diagnosis.before,
        held_out_error_after=diagnosis.after,
        lack_of_fit={"before": diagnosis.lack_of_fit_before, "after": diagnosis.lack_of_fit_after},
        identifiability=_plain(diagnosis.identifiability),
        remarks=diagnosis.remarks,
        formulas=formulas,
    )


def _named(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Effects that were chosen, also where they do not explain everything."""
    if diagnosis.verdict == NOTHING:
        return ()
    if diagnosis.verdict != NONE:
        return tuple(diagnosis.verdict.split("+"))
    leading = {group[0] for group in diagnosis.confusable}
    return tuple(
        effect.name
        for effect in diagnosis.effects
        if effect.verdict in ("CONFIRMED", "AT-BOUND") or effect.name in leading
    )


def _plain(value: Any) -> Any:
    """Numbers that are not finite, which JSON does not know, as None."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_document(document: DiagnosisDocument, path: Path) -> None:
    """Write ``diagnosis.json``, at once or not at all; an earlier one is replaced.

    Raises:
        InputError: It cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(json.dumps(document.model_dump(mode="json"), indent=2) + "\n", encoding="utf-8")
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise InputError(f"cannot be written: {error.strerror}", file=path) from None


def read_document(path: Path) -> DiagnosisDocument:
    """Read ``diagnosis.json``.

    Raises:
        InputError: It is missing or no diagnosis.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", file=path) from None
    except json.JSONDecodeError as error:
        raise InputError(f"not valid JSON at line {error.lineno}: {error.msg}", file=path) from None
    if not isinstance(data, dict):
        raise InputError("no diagnosis", file=path)
    if data.get("kind") == "recording":
        data = _of_recording(data, path)
    return validate(DiagnosisDocument, data, path)


def _centre_of_mass(parameters: dict[str, Any]) -> dict[str, Any]:
    """First moments of a payload, which are what a regression sees, as its centre of mass; others as they are."""
    moments = {name: value for name, value in parameters.items() if name.startswith("first_moment_")}
    if not moments:
        return parameters
    mass = parameters["mass"]["estimate"]
    centre = {
        name.replace("first_moment_", "com_"): {
            "estimate": value["estimate"] / mass if mass > 0.0 else 0.0,
            "ci95": None,
            "unit": "m",
            "meaning": "first moment over mass",
        }
        for name, value in moments.items()
    }
    return {name: value for name, value in parameters.items() if name not in moments} | centre


def _of_recording(data: dict[str, Any], path: Path) -> dict[str, Any]:
    """A diagnosis of recordings in the words of one of trials; errors stay in N m, what was not measured has none.

    Raises:
        InputError: It breaks off, or was written by an earlier version.
    """
    fields = {"name", "sentence", "verdict", "parameters", "held_out_error_before", "held_out_error_after", "p_value"}
    try:
        effects = [
            {key: value for key, value in effect.items() if key in fields}
            for effect in data["effects"]
            if effect["p_value"] is not None
        ]
        for effect in effects:
            effect["parameters"] = _centre_of_mass(effect["parameters"])
        files = [Path(name).name for name in data["recording"]["files"]]
        kept = ("verdict", "named", "confusable", "unexplained", "next_experiment", "model", "noise_floor", "remarks")
        return {
            **{key: data[key] for key in (*kept, "held_out_error_before", "held_out_error_after")},
            "effects": effects,
            "runs": {"digest": "", "trials": len(files), "conditions": files},
            "lack_of_fit": {},
            "formulas": data["formulas"],
        }
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"not a whole diagnosis of a recording ({type(error).__name__}: {error})", file=path) from None


def add_effect(
    model: Model, model_file: Path, document: DiagnosisDocument, source: Path, name: str, output: Path, force: bool
) -> Model:
    """The child model with one diagnosed effect, not yet written.

    Args:
        model: Parent.
        model_file: Its file.
        document: Diagnosis of the parent.
        source: File of the diagnosis.
        name: Effect to add.
        output: File of the child, to name the parent relative to it.
        force: Add it even where the diagnosis saw no improvement.

    Raises:
        InputError: The diagnosis is of another model, does not contain the effect, or advises against it.
    """
    if document.model.digest != model.digest:
        raise InputError(
            f"this is a diagnosis of model {document.model.name!r} (digest {document.model.digest}), not of "
            f"{model.name!r} (digest {model.digest}) in {model_file}; diagnose that one, or name the model of this one",
            file=source,
        )
    found = document.effect(name)
    if found is None:
        known = [effect.name for effect in document.effects]
        raise InputError(
            f"no effect {name!r} in this diagnosis{did_you_mean(name, known)}; it considered: {', '.join(known)}",
            file=source,
        )
    if found.verdict == "NOT-IDENTIFIABLE":
        raise InputError(
            f"{name} is NOT-IDENTIFIABLE: these trials do not determine its parameters, so there is nothing to add",
            file=source,
        )
    if found.verdict == "NO-IMPROVEMENT" and not force:
        raise InputError(
            f"{name} is NO-IMPROVEMENT: it predicts unseen conditions no better "
            f"({found.held_out_error_before:.3g} -> {found.held_out_error_after:.3g} {document.error_unit}); "
            "--force adds it all the same",
            file=source,
        )
    formulas = tuple(spec for spec in document.formulas if spec.name == name)
    effect = model.model_copy(update={"formulas": (*model.formulas, *formulas)}).known_effects.get(name)
    scalars = [] if effect is None else effect.scalars(JOINT_COUNT)
    nominal = {scalar.name: ParameterValue(estimate=scalar.nominal, unit=scalar.unit) for scalar in scalars}
    estimated = {
        key: ParameterValue(estimate=value.estimate, unit=value.unit, ci95=value.ci95)
        for key, value in found.parameters.items()
    }
    item = ModelEffect(name=name, parameters={**nominal, **estimated})
    child = model.with_effect(item, output.stem, _parent_name(model_file, output), formulas)
    note = (
        f"{name}: {found.verdict}; held-out error {found.held_out_error_before:.3g} -> "
        f"{found.held_out_error_after:.3g} {document.error_unit} in {document.runs.trials} {document.runs_are}"
    )
    return check_model(child.model_copy(update={"note": note}), source)


def _parent_name(model_file: Path, output: Path) -> str:
    """The parent's file relative to the child's folder; a model that is shipped goes by its name."""
    shipped = config_directory() / "models" / (model_file.name if model_file.suffix else f"{model_file.name}.yaml")
    if not model_file.exists() or (shipped.exists() and shipped.samefile(model_file)):
        return shipped.name
    return os.path.relpath(model_file.resolve(), output.parent.resolve())
