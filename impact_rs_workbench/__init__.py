# SPDX-License-Identifier: Apache-2.0
"""The workbench: a page on this machine that walks from a prediction to a better model, with the mouse."""
