# SPDX-License-Identifier: Apache-2.0
"""An investigation: design, predict, measure, compare, diagnose and add, again and again, until nothing is missing.

The folder is the state. Every step reads what is there, makes one file that is missing, and writes it whole, so that an
investigation that was interrupted anywhere goes on where it stopped:

    investigation.yaml              what was asked
    runs/round_NN/FOLDER/TRIAL      bags
    rounds/NN/plan.yaml             which trials, and why
    rounds/NN/prediction.json       what the model predicts for them, written before they are measured
    rounds/NN/prediction_error.json the same held against what was then measured
    rounds/NN/compare.json          the model against all trials
    rounds/NN/diagnosis.json        what the model lacks
    rounds/NN/again.json            what the first model lacks, where the present one does not hold
    rounds/NN/discovery.json        a law, where no effect of the library explains the trials
    rounds/NN/decision.json         what to do next, and why
    model_N.yaml                    models, each with its parent
    ending.json, log.md             the end, and the whole story in words

A model is made from the first one by one diagnosis of all trials: estimates of an early model are not kept, so no later
trial has to be explained by an effect that only makes up for their error. It is then tried on trials that were measured
after it was made.

settings -> rounds on disk -> quantities of a decision -> policy -> decision -> next step
"""
