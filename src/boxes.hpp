// SPDX-License-Identifier: Apache-2.0
// Convex bodies, and contact points of two boxes; rules in impact_rs_sim/impact_map/contacts.py.

#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "dense.hpp"

namespace impact_rs {

struct Hull;

enum class ShapeKind : char { box, sphere, capsule, cylinder, hull };  // the last two round ones have z as their axis

struct Shape {
  ShapeKind kind = ShapeKind::box;
  std::shared_ptr<const Hull> hull;  // of a hull
};

struct ConvexBody {
  Vector centre;    // of its bounding box, in A [m]
  Matrix rotation;  // axes in A
  Vector half;      // half extents of its bounding box [m]
  Shape shape{};
};

struct Edges {
  int partner, object;  // axes of the boxes along which they run
};

// The separating axis of two bodies (Gottschalk et al. 1996).
struct SeparatingAxis {
  double separation;           // along the direction that separates them best, negative: overlap [m]
  Vector normal;               // of the contact, from the partner into the object
  bool on_object;              // whether the normal belongs to a face of the object
  std::optional<Edges> edges;  // of two boxes, that cross and own the normal; without: a face does
};

// A point of the contact manifold.
struct ManifoldPoint {
  Vector position;  // on the object in A [m]
  double gap;       // from the partner's surface along the normal [m]
};

// Of faces that separate two bodies as well as the best one, up to `aligned` [m], the larger face owns the normal. Bodies
// that are not both boxes: shapes.hpp.
SeparatingAxis separating_axis(const ConvexBody& partner, const ConvexBody& object, double aligned);

// Points of the object within `tolerance` [m] of the partner: corners of the incident face, clipped to the reference
// face, or the point where two edges cross.
void contact_manifold(const ConvexBody& partner, const ConvexBody& object, const SeparatingAxis& separating,
                      double tolerance, std::vector<ManifoldPoint>& found);

// Both at once, of bodies whose faces are nearer than `margin` [m], for every step of a simulation; returns the normal.
Vector collide(const ConvexBody& partner, const ConvexBody& object, double aligned, double margin, double tolerance,
               std::vector<ManifoldPoint>& found);

}  // namespace impact_rs
