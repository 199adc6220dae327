# SPDX-License-Identifier: Apache-2.0
# Makes the ROS 2 wheels of a pip or uv build environment usable as a CMake prefix.
#
# 1. The wheels unpack into the environment's own lib/ and share/; that prefix is found from where
#    the Python module rosidl_pycommon lies and is announced to CMake and to the ament index.
# 2. The imported targets of the wheels carry include directories of the machine that built them;
#    those that do not exist here are dropped once all targets are known.
# 3. Python needs the C interfaces alone: without those for C++ the interfaces take half of the time to build.

find_package(Python3 REQUIRED COMPONENTS Interpreter Development.Module NumPy)

execute_process(
  COMMAND "${Python3_EXECUTABLE}" -c
    "import importlib.util, pathlib; print(pathlib.Path(importlib.util.find_spec('rosidl_pycommon').origin).parents[4])"
  OUTPUT_VARIABLE ros_wheels_prefix
  OUTPUT_STRIP_TRAILING_WHITESPACE
  RESULT_VARIABLE ros_wheels_result
)
if(NOT ros_wheels_result EQUAL 0)
  message(FATAL_ERROR
    "The ROS 2 wheels named in pyproject.toml's [build-system] are not installed for ${Python3_EXECUTABLE}.")
endif()

set(ENV{AMENT_PREFIX_PATH} "${ros_wheels_prefix}")
list(PREPEND CMAKE_PREFIX_PATH "${ros_wheels_prefix}")

# Drops the include directories that do not exist from every target imported in `directory` and
# below it.
function(drop_missing_include_directories directory)
  get_directory_property(targets DIRECTORY "${directory}" IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    foreach(property INTERFACE_INCLUDE_DIRECTORIES INTERFACE_SYSTEM_INCLUDE_DIRECTORIES)
      get_target_property(recorded ${target} ${property})
      if(recorded)
        set(existing "")
        foreach(path IN LISTS recorded)
          if(path MATCHES "^\\$<" OR EXISTS "${path}")
            list(APPEND existing "${path}")
          endif()
        endforeach()
        set_target_properties(${target} PROPERTIES ${property} "${existing}")
      endif()
    endforeach()
  endforeach()
  get_directory_property(subdirectories DIRECTORY "${directory}" SUBDIRECTORIES)
  foreach(subdirectory IN LISTS subdirectories)
    drop_missing_include_directories("${subdirectory}")
  endforeach()
endfunction()

cmake_language(DEFER CALL drop_missing_include_directories "${CMAKE_CURRENT_SOURCE_DIR}")

# Leaves the generators for C++ out; called by CMakeLists.txt once the generators are registered.
macro(generate_no_cpp_interfaces)
  list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp:")
endmacro()
