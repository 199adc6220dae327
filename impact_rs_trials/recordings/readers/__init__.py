# SPDX-License-Identifier: Apache-2.0
"""Files of recordings, of all formats: found, opened, and read as series of one signal each."""
