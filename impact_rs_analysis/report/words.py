"""What a diagnosis says, in words."""

from __future__ import annotations

from impact_rs_analysis.diagnosis.document import NONE, NOTHING, DiagnosisDocument


def verdict_in_words(document: DiagnosisDocument) -> str:
    """Two or three sentences for a reader who sees nothing else."""
    before, after = document.held_out_error_before, document.held_out_error_after
    fall = (
        f"The error on conditions that the fit has not seen falls from {before:.3g} to {after:.3g} times what "
        f"repetition explains (repetition alone gives {document.noise_floor:.3g})."
    )
    if document.verdict == NOTHING:
        return (
            f"Nothing is missing in model '{document.model.name}' that these {document.runs.trials} trials could show: "
            f"its error is {before:.3g} times what repetition explains, repetition alone gives "
            f"{document.noise_floor:.3g}."
        )
    if document.verdict == NONE:
        if document.named:
            return (
                f"Nothing in the library explains these trials. {' and '.join(document.named)} helps, but a difference "
                f"stays that repetition does not explain. {fall}"
            )
        return (
            f"Model '{document.model.name}' fails, and nothing in the library explains why: its error is {before:.3g} "
            f"times what repetition explains, and no effect lowers it on conditions that the fit has not seen."
        )
    names = " and ".join(document.named)
    text = f"Model '{document.model.name}' lacks {names}. {fall}"
    for group in document.confusable:
        others = ", ".join(name for name in group if name != group[0])
        text += f" These trials cannot tell {group[0]} from {others}."
    return text
