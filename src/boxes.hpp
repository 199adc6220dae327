// SPDX-License-Identifier: Apache-2.0
// Where two boxes touch; impact_rs_sim/impact_map/contacts.py says by which rules.

#pragma once

#include <vector>

#include "dense.hpp"

namespace impact_rs {

struct Box {
  Vector centre;    // in A [m]
  Matrix rotation;  // axes in A
  Vector half;      // half extents [m]
};

struct Face {
  double separation;  // along the normal, negative: overlap [m]
  Vector normal;      // from the partner into the thing
  bool on_thing;      // whose face the normal belongs to
};

struct Touch {
  Vector position;  // on the thing in A [m]
  double gap;       // from the partner's surface along the normal [m]
};

// The face direction that separates two boxes best; of those within `aligned` [m] the one of the larger face.
Face separating_face(const Box& partner, const Box& thing, double aligned);

// Corners of the incident face, clipped to the reference face, that are within `tolerance` [m] of it.
void touching(const Box& partner, const Box& thing, const Face& face, double tolerance, std::vector<Touch>& found);

}  // namespace impact_rs
