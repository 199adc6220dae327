// SPDX-License-Identifier: Apache-2.0
// Separation and contact points of convex bodies that are not both boxes; rules in impact_rs_sim/shapes.py.
//
// Along a unit normal n two bodies are s(n) = n . (c_O - c_P) - h_P(n) - h_O(-n) apart, with their support functions h.
// Their separation is the largest s. It lies where features of the bodies face each other: a face and anything, two edges
// that cross, a corner and a curved wall, a rim and an edge. Every such normal but the last has a closed form; the last is
// searched along a great circle, and only where the others leave a gap between the facing features.

#pragma once

#include <vector>

#include "boxes.hpp"

namespace impact_rs {

// A convex polyhedron about the middle of its bounding box; faces have their corners in order, seen from outside
// anticlockwise.
struct Hull {
  struct Face {
    Vector normal;
    double offset;  // along the normal [m]
    double extent;  // of the face from its middle [m]
    std::vector<int> corners;
  };
  struct Edge {
    int start, end;     // corners
    int first, second;  // faces
  };
  std::vector<Vector> corners;
  std::vector<Face> faces;
  std::vector<Edge> edges;
  std::vector<std::vector<int>> faces_of;  // by corner

  // Throws std::invalid_argument where the faces do not close around a body that has the origin inside.
  Hull(std::vector<Vector> corners, const std::vector<std::vector<int>>& faces);
};

// Largest n . (x - centre) over the points x of a body [m].
double support_of(const ConvexBody& body, const Vector& normal);

SeparatingAxis separating_axis_convex(const ConvexBody& partner, const ConvexBody& object, double aligned);
void contact_manifold_convex(const ConvexBody& partner, const ConvexBody& object, const Vector& normal, double tolerance,
                             std::vector<ManifoldPoint>& found);

}  // namespace impact_rs
