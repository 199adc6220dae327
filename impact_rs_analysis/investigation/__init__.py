# SPDX-License-Identifier: Apache-2.0
"""An investigation: design, predict, measure, compare, diagnose and add, until nothing is missing.

The folder is the state. Every step reads the existing files and writes the first missing one atomically, so that an
interrupted investigation goes on where it stopped:

    investigation.yaml              settings
    runs/round_NN/FOLDER/TRIAL      bags
    rounds/NN/plan.yaml             which trials, and why
    rounds/NN/prediction.json       what the model predicts for them, written before they are measured
    rounds/NN/prediction_error.json predictions against the trials measured afterwards
    rounds/NN/compare.json          the model against all trials
    rounds/NN/diagnosis.json        missing effects of the model
    rounds/NN/again.json            missing effects of the first model, if the present one does not hold
    rounds/NN/discovery.json        a law, if no effect of the library explains the trials
    rounds/NN/decision.json         next action, with its reason
    model_N.yaml                    models, each with its parent
    ending.json, log.md             the end, and all steps in words

Every new model is the first model plus the effects that one diagnosis of all trials names. The estimates of earlier
models are not kept: an effect that only compensates their errors would otherwise explain later trials. A new model is
then tested on trials that were measured after it was made.

settings -> rounds on disk -> quantities of a decision -> policy -> decision -> next step
"""
