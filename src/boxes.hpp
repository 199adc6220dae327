// SPDX-License-Identifier: Apache-2.0
// Contact points of two boxes; rules in impact_rs_sim/impact_map/contacts.py.

#pragma once

#include <optional>
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
  Vector normal;      // from the partner into the object
  bool on_object;     // whether the normal belongs to a face of the object
};

struct Touch {
  Vector position;  // on the object in A [m]
  double gap;       // from the partner's surface along the normal [m]
};

// The face direction that separates two boxes best; of those within `aligned` [m] the one of the larger face.
Face separating_face(const Box& partner, const Box& object, double aligned);

// Corners of the incident face, clipped to the reference face, that are within `tolerance` [m] of it.
void touching(const Box& partner, const Box& object, const Face& face, double tolerance, std::vector<Touch>& found);

struct Crossing {
  double separation;  // along the normal [m]
  Vector normal;      // from the partner into the object
  Touch touch;
};

// The two edges whose common normal separates two boxes best, where they cross; parallel ones never do.
std::optional<Crossing> crossing_edges(const Box& partner, const Box& object);

}  // namespace impact_rs
