# SPDX-License-Identifier: Apache-2.0
# Writes the revision of the repository in SOURCES, with + where it has uncommitted changes, into FILE; an empty one
# where SOURCES is no repository. Run with cmake -P.

set(revision "")
if(EXISTS "${SOURCES}/.git")
  execute_process(
    COMMAND git describe --always --dirty=+ --abbrev=12
    WORKING_DIRECTORY "${SOURCES}"
    OUTPUT_VARIABLE revision
    OUTPUT_STRIP_TRAILING_WHITESPACE
    ERROR_QUIET
  )
endif()
file(WRITE "${FILE}" "${revision}\n")
