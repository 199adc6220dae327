// SPDX-License-Identifier: Apache-2.0

#include "shapes.hpp"

#include <algorithm>
#include <stdexcept>
#include <utility>

namespace impact_rs {

namespace {

constexpr double FACE_NORMAL_TOLERANCE = 1e-12;  // 1 - cosine of the angle of a face and a normal that is its own
constexpr double PARALLEL_TOLERANCE = 1e-6;      // of a direction along an edge or wall over its length
constexpr double CAP_COSINE = 0.7;               // of normal and axis; above: cap of a cylinder, below: its wall
constexpr double FLAT_CAP_SINE = 1e-3;           // sine of the tilt of a cap below which eight points stand for its rim
// Points of the rim of a cap, fixed to its body, over its radius.
constexpr double DIAGONAL = 0.70710678118654752440;
constexpr double RIM[8][2] = {{1.0, 0.0},  {DIAGONAL, DIAGONAL},   {0.0, 1.0},  {-DIAGONAL, DIAGONAL},
                              {-1.0, 0.0}, {-DIAGONAL, -DIAGONAL}, {0.0, -1.0}, {DIAGONAL, -DIAGONAL}};
constexpr int MAX_FACE_CORNERS = 12;          // of a face of a hull; of a larger one every n-th corner and the furthest
constexpr double FACING_TOLERANCE = 1e-5;     // of the extents of two bodies, between points that face each other
constexpr double MAX_ROTATION = 0.8;          // rad, over which the normal of a rim on an edge is sought
constexpr double SAME_NORMAL_COSINE = 0.995;  // as in boxes.cpp, for edges and walls
constexpr int SWEEPS = 8;                     // of the search for the normal of two rims
constexpr int COARSE_STEPS = 8;               // in which the interval is divided to either side
constexpr int GOLDEN_STEPS = 40;              // of the interval by the golden ratio

Vector unit(const Vector& a) { return (1.0 / norm(a)) * a; }

bool is_round(ShapeKind kind) {
  return kind == ShapeKind::sphere || kind == ShapeKind::capsule || kind == ShapeKind::cylinder;
}

// Half the length of the segment inside a sphere, capsule or cylinder [m].
double core(const ConvexBody& body) {
  switch (body.shape.kind) {
    case ShapeKind::capsule: return body.half[2] - body.half[0];
    case ShapeKind::cylinder: return body.half[2];
    default: return 0.0;
  }
}

Vector axis_of(const ConvexBody& body) { return column(body.rotation, 2); }

// Part of a direction across the axis of a round body; unit vector, of a direction along the axis any one across it.
Vector across(const ConvexBody& body, const Vector& direction) {
  const Vector axis = axis_of(body), radial = direction - dot(direction, axis) * axis;
  const double size = norm(radial);
  return size > 1e-12 * norm(direction) ? (1.0 / size) * radial : column(body.rotation, 0);
}

struct Corners {
  std::array<Vector, 64> points;
  int count = 0;

  void add(const Vector& point) {
    if (count < static_cast<int>(points.size())) points[count++] = point;
  }
};

// Rim of the cap on the side of a unit vector: points that are fixed to the body and, where it is tilted, the furthest.
void add_cap(const ConvexBody& body, const Vector& direction, Corners& found) {
  const Vector local = transposed_times(body.rotation, direction);
  const double radius = body.half[0], height = std::copysign(body.half[2], local[2]);
  const double tilt = std::hypot(local[0], local[1]);
  const Vector furthest = tilt > FLAT_CAP_SINE ? Vector{local[0] / tilt, local[1] / tilt, 0.0} : Vector{};
  const auto put = [&](double x, double y) {
    found.add(body.centre + body.rotation * Vector{radius * x, radius * y, height});
  };
  for (int i = 0; i < 8; ++i) {
    const double *here = RIM[i], *next = RIM[(i + 1) % 8];
    put(here[0], here[1]);
    const double after = here[0] * furthest[1] - here[1] * furthest[0];
    const double before = furthest[0] * next[1] - furthest[1] * next[0];
    if (after > FLAT_CAP_SINE && before > FLAT_CAP_SINE) put(furthest[0], furthest[1]);
  }
}

int support_corner(const Hull& hull, const Vector& local) {
  int corner = 0;
  for (int i = 1; i < static_cast<int>(hull.corners.size()); ++i)
    if (dot(hull.corners[i], local) > dot(hull.corners[corner], local)) corner = i;
  return corner;
}

// Supporting feature of a body along `direction`: a point, the ends of a segment, or the corners of a face in order.
void supporting_face(const ConvexBody& body, const Vector& direction, Corners& found) {
  const Vector local = transposed_times(body.rotation, direction);
  switch (body.shape.kind) {
    case ShapeKind::box: {
      int axis = 0;
      for (int i = 1; i < 3; ++i)
        if (std::abs(local[i]) > std::abs(local[axis])) axis = i;
      const int u = (axis + 1) % 3, v = (axis + 2) % 3;
      const double first[] = {1.0, -1.0, -1.0, 1.0}, second[] = {1.0, 1.0, -1.0, -1.0};
      for (int i = 0; i < 4; ++i) {
        Vector corner;
        corner[axis] = std::copysign(body.half[axis], local[axis]);
        corner[u] = first[i] * body.half[u];
        corner[v] = second[i] * body.half[v];
        found.add(body.centre + body.rotation * corner);
      }
      return;
    }
    case ShapeKind::sphere: found.add(body.centre + body.half[0] * direction); return;
    case ShapeKind::capsule:
      for (const double side : {-1.0, 1.0})
        found.add(body.centre + side * core(body) * axis_of(body) + body.half[0] * direction);
      return;
    case ShapeKind::cylinder:
      if (std::abs(local[2]) > CAP_COSINE * norm(direction)) return add_cap(body, direction, found);
      for (const double side : {-1.0, 1.0})
        found.add(body.centre + side * body.half[2] * axis_of(body) + body.half[0] * across(body, direction));
      return;
    case ShapeKind::hull: {
      const Hull& hull = *body.shape.hull;
      const int corner = support_corner(hull, local);  // the face nearest to `direction` may not contain it
      const Hull::Face* face = &hull.faces[hull.faces_of[corner][0]];
      for (const int other : hull.faces_of[corner])
        if (dot(hull.faces[other].normal, local) > dot(face->normal, local)) face = &hull.faces[other];
      const int all = static_cast<int>(face->corners.size()), step = (all + MAX_FACE_CORNERS - 1) / MAX_FACE_CORNERS;
      for (int i = 0; i < all; ++i)
        if (i % step == 0 || face->corners[i] == corner)
          found.add(body.centre + body.rotation * hull.corners[face->corners[i]]);
      return;
    }
  }
}

// The face of a body that a normal belongs to: its extent [m]; negative: there is none.
double extent_of_face(const ConvexBody& body, const Vector& normal) {
  const Vector local = transposed_times(body.rotation, normal);
  if (body.shape.kind == ShapeKind::box) {
    for (int i = 0; i < 3; ++i)
      if (std::abs(local[i]) > 1.0 - FACE_NORMAL_TOLERANCE)
        return std::hypot(body.half[(i + 1) % 3], body.half[(i + 2) % 3]);
  } else if (body.shape.kind == ShapeKind::cylinder) {
    if (std::abs(local[2]) > 1.0 - FACE_NORMAL_TOLERANCE) return body.half[0];
  } else if (body.shape.kind == ShapeKind::hull) {
    for (const Hull::Face& face : body.shape.hull->faces)
      if (dot(face.normal, local) > 1.0 - FACE_NORMAL_TOLERANCE) return face.extent;
  }
  return -1.0;
}

// Support points of a body along `direction`: one point or the ends of a segment.
void support_segment(const ConvexBody& body, const Vector& direction, Corners& found) {
  const Vector local = transposed_times(body.rotation, direction);
  switch (body.shape.kind) {
    case ShapeKind::box: {
      Vector corner;
      int along = -1;
      for (int i = 0; i < 3; ++i) {
        corner[i] = std::copysign(body.half[i], local[i]);
        if (std::abs(local[i]) < PARALLEL_TOLERANCE) along = i;
      }
      found.add(body.centre + body.rotation * corner);
      if (along < 0) return;
      corner[along] = -corner[along];
      found.add(body.centre + body.rotation * corner);
      return;
    }
    case ShapeKind::hull: {
      const Hull& hull = *body.shape.hull;
      double most = -INFINITY;
      for (const Vector& corner : hull.corners) most = std::max(most, dot(corner, local));
      std::size_t first = 0, last = hull.corners.size() - 1;  // of those that are furthest, or nearly
      while (dot(hull.corners[first], local) < most - PARALLEL_TOLERANCE * norm(body.half)) ++first;
      while (dot(hull.corners[last], local) < most - PARALLEL_TOLERANCE * norm(body.half)) --last;
      found.add(body.centre + body.rotation * hull.corners[first]);
      if (last != first) found.add(body.centre + body.rotation * hull.corners[last]);
      return;
    }
    case ShapeKind::sphere: found.add(body.centre + body.half[0] * direction); return;
    default: {
      const Vector out = body.shape.kind == ShapeKind::capsule ? direction : across(body, direction);
      const Vector middle = body.centre + body.half[0] * out;
      const Vector end = core(body) * axis_of(body);
      if (local[2] > -PARALLEL_TOLERANCE) found.add(middle + end);
      if (local[2] < PARALLEL_TOLERANCE) found.add(middle - end);
    }
  }
}

double between(double value, double low, double high) { return std::min(std::max(value, low), high); }

Vector point_at(const Corners& segment, double share) {
  return segment.points[0] + between(share, 0.0, 1.0) * (segment.points[segment.count - 1] - segment.points[0]);
}

// Points of the second segment that are nearest to the first; of parallel ones the ends of what they share.
void nearest_points(const Corners& partner, const Corners& object, Corners& found) {
  if (object.count == 1) return found.add(object.points[0]);
  const Vector a = partner.points[partner.count - 1] - partner.points[0];
  const Vector b = object.points[object.count - 1] - object.points[0];
  const Vector apart = object.points[0] - partner.points[0];
  const double bb = dot(b, b), aa = dot(a, a), ab = dot(a, b), determinant = aa * bb - ab * ab;
  if (partner.count == 1) return found.add(point_at(object, -dot(apart, b) / bb));
  if (determinant > PARALLEL_TOLERANCE * aa * bb)
    return found.add(point_at(object, (ab * dot(apart, a) - aa * dot(apart, b)) / determinant));
  const double first = -dot(apart, b) / bb, last = first + ab / bb;
  if (std::max(first, last) < 0.0 || std::min(first, last) > 1.0) return;
  found.add(point_at(object, std::min(first, last)));
  found.add(point_at(object, std::max(first, last)));
}

// Part of a polygon, or of a segment or point, within `limit` along `outward`.
void clip(Corners& polygon, const Vector& outward, double limit) {
  Corners kept;
  for (int i = 0; i < polygon.count; ++i) {
    const Vector& corner = polygon.points[i];
    const double here = dot(outward, corner) - limit;
    if (i > 0 || polygon.count > 2) {  // a segment is not closed
      const Vector& last = polygon.points[(i + polygon.count - 1) % polygon.count];
      const double previous = dot(outward, last) - limit;
      if ((here <= 0.0) != (previous <= 0.0)) kept.add(last + (previous / (previous - here)) * (corner - last));
    }
    if (here <= 0.0) kept.add(corner);
  }
  polygon = kept;
}

// Separation along a normal, negative: overlap [m].
double separation_along(const ConvexBody& partner, const ConvexBody& object, const Vector& normal) {
  return dot(normal, object.centre - partner.centre) - support_of(partner, normal) - support_of(object, -1.0 * normal);
}

// Direction from a body to a point outside, or from the axis of a round body to a point inside; zero: there is none.
Vector direction_to(const ConvexBody& body, const Vector& point) {
  const Vector local = transposed_times(body.rotation, point - body.centre);
  Vector apart{};
  if (body.shape.kind == ShapeKind::box) {
    for (int i = 0; i < 3; ++i) apart[i] = local[i] - between(local[i], -body.half[i], body.half[i]);
  } else if (body.shape.kind == ShapeKind::hull) {
    // The nearest point lies on a face that sees the point, by Voronoi regions of its edges and corners.
    const Hull& hull = *body.shape.hull;
    double least = INFINITY;
    for (const Hull::Face& face : hull.faces) {
      const double height = dot(face.normal, local) - face.offset;
      if (height <= 0.0) continue;
      Vector foot = local - height * face.normal;
      const std::size_t count = face.corners.size();
      bool within = true;
      double nearest = INFINITY;
      Vector on_edge{};
      for (std::size_t i = 0; i < count; ++i) {
        const Vector& start = hull.corners[face.corners[i]];
        const Vector side = hull.corners[face.corners[(i + 1) % count]] - start;
        within = within && dot(cross(face.normal, side), foot - start) >= 0.0;
        const Vector on = start + between(dot(local - start, side) / dot(side, side), 0.0, 1.0) * side;
        if (const double distance = norm(local - on); distance < nearest) {
          nearest = distance;
          on_edge = on;
        }
      }
      if (!within) foot = on_edge;
      if (const double distance = norm(local - foot); distance < least) {
        least = distance;
        apart = local - foot;
      }
    }
  } else {
    const double length = core(body), radius = std::hypot(local[0], local[1]);
    const double beyond = local[2] - between(local[2], -length, length);
    // Of a cylinder the rim is nearest to points beyond its cap and its wall, the wall to all others.
    const bool over_cap = body.shape.kind == ShapeKind::cylinder && beyond != 0.0;
    const double share = over_cap ? std::max(radius - body.half[0], 0.0) : radius;
    if (radius > 0.0) apart = {share / radius * local[0], share / radius * local[1], 0.0};
    apart[2] = beyond;
  }
  const double size = norm(apart);
  return size > 1e-12 * norm(body.half) ? body.rotation * ((1.0 / size) * apart) : Vector{};
}

// The search for the normal along which two bodies are furthest apart.
struct Search {
  const ConvexBody &partner, &object;
  double aligned;
  double separation = -INFINITY, extent = 0.0;
  Vector normal{};

  // Keep a normal that separates better than the best one; of equally good faces the larger one.
  void try_normal(const Vector& other, double own, double size) {
    const bool as_good = size > extent && own > separation - aligned;
    if (!(own > separation + aligned || as_good)) return;
    separation = own;
    normal = other;
    extent = size;
  }
  void try_normal(const Vector& other, double size = 0.0) {
    try_normal(other, separation_along(partner, object, other), size);
  }

  void try_face_normals(const ConvexBody& body, double sign) {
    const Vector apart = object.centre - partner.centre;
    if (body.shape.kind == ShapeKind::hull) {
      // The other body has its middle inside, so that no face separates by more than the height of that above it.
      const ConvexBody& other = sign > 0.0 ? object : partner;
      const Vector middle = transposed_times(body.rotation, sign * apart);
      for (const Hull::Face& face : body.shape.hull->faces) {
        const double height = dot(face.normal, middle) - face.offset;
        if (height < separation - aligned) continue;
        const Vector outward = body.rotation * face.normal;
        try_normal(sign * outward, height - support_of(other, -1.0 * outward), face.extent);
      }
      return;
    }
    for (int i = body.shape.kind == ShapeKind::cylinder ? 2 : 0; i < 3; ++i) {
      const Vector axis = column(body.rotation, i);
      const Vector own = (dot(axis, apart) >= 0.0 ? 1.0 : -1.0) * axis;
      const double size =
          body.shape.kind == ShapeKind::cylinder ? body.half[0] : std::hypot(body.half[(i + 1) % 3], body.half[(i + 2) % 3]);
      try_normal(own, size);
    }
  }

  // Directions of edges of boxes and of walls.
  void add_edges(const ConvexBody& body, Corners& found) const {
    if (body.shape.kind == ShapeKind::box) {
      for (int i = 0; i < 3; ++i) found.add(column(body.rotation, i));
    } else if (core(body) > 0.0) {
      found.add(axis_of(body));
    }
  }

  void try_edge_pair(const Vector& a, const Vector& b) {
    const Vector across = cross(a, b);
    const double sine = norm(across);
    if (sine < 1e-2) return;
    try_normal((dot(across, object.centre - partner.centre) >= 0.0 ? 1.0 : -1.0) / sine * across);
  }

  // Edges of a hull whose arc on its sphere of normals crosses that of an edge of the other body; `sign` as above.
  void try_hull_edges(const ConvexBody& body, const ConvexBody& other, double sign) {
    const Hull& hull = *body.shape.hull;
    const Vector apart = sign * (object.centre - partner.centre), middle = transposed_times(body.rotation, apart);
    const double least = std::min(separation, 0.0);
    const auto sees = [&](int face) { return dot(hull.faces[face].normal, middle) - hull.faces[face].offset > least; };
    std::vector<const Hull::Edge*> seen;  // the height above an edge is at most that above one of its faces, or 0
    for (const Hull::Edge& edge : hull.edges)
      if (sees(edge.first) || sees(edge.second)) seen.push_back(&edge);
    const auto cross_with = [&](const Vector& along) {  // in A
      const Vector local = transposed_times(body.rotation, along);
      for (const Hull::Edge* next : seen) {
        const Hull::Edge& edge = *next;
        const Vector &first = hull.faces[edge.first].normal, &second = hull.faces[edge.second].normal;
        const double here = dot(first, local), there = dot(second, local);
        if (here * there >= 0.0) continue;
        const Vector own = (here > 0.0 ? 1.0 : -1.0) * (here * second - there * first);
        const Vector outward = body.rotation * unit(own);
        if (dot(outward, apart) <= 0.0) continue;
        const double offset = dot(transposed_times(body.rotation, outward), hull.corners[edge.start]);
        try_normal(sign * outward, dot(outward, apart) - offset - support_of(other, -1.0 * outward), 0.0);
      }
    };
    if (other.shape.kind == ShapeKind::hull) {
      for (const Hull::Edge& edge : other.shape.hull->edges)
        cross_with(other.rotation * (other.shape.hull->corners[edge.end] - other.shape.hull->corners[edge.start]));
      return;
    }
    Corners edges;
    add_edges(other, edges);
    for (int i = 0; i < edges.count; ++i) cross_with(edges.points[i]);
  }

  // Corners of a body, and middles of balls, towards the surface of the other; `sign` is 1 for those of the object.
  void try_vertices(const ConvexBody& body, const ConvexBody& other, double sign) {
    const auto towards = [&](const Vector& point) {
      const Vector direction = direction_to(other, point);
      if (dot(direction, direction) > 0.0) try_normal(sign * direction);
    };
    const ShapeKind kind = body.shape.kind;
    if (kind == ShapeKind::sphere) towards(body.centre);
    if (kind == ShapeKind::capsule) {
      for (const double side : {-1.0, 1.0}) towards(body.centre + side * core(body) * axis_of(body));
    }
    if (!is_round(other.shape.kind)) return;
    if (kind == ShapeKind::box) {
      for (int i = 0; i < 8; ++i) {
        const Vector signs{i & 1 ? 1.0 : -1.0, i & 2 ? 1.0 : -1.0, i & 4 ? 1.0 : -1.0}, &half = body.half;
        towards(body.centre + body.rotation * Vector{signs[0] * half[0], signs[1] * half[1], signs[2] * half[2]});
      }
    }
    if (kind == ShapeKind::hull)
      for (const Vector& corner : body.shape.hull->corners) towards(body.centre + body.rotation * corner);
    if (kind == ShapeKind::cylinder)
      for (const double side : {-1.0, 0.0, 1.0}) towards(body.centre + side * body.half[2] * axis_of(body));
  }

  // A rim of a body on the edges and walls of the other: the normal is across one, where it separates best.
  void try_rims(const ConvexBody& other, double sign) {
    Corners edges;
    add_edges(other, edges);
    if (other.shape.kind == ShapeKind::hull) {  // those that end in the corner that is furthest
      const Hull& hull = *other.shape.hull;
      const int corner = support_corner(hull, transposed_times(other.rotation, sign * normal));
      for (const Hull::Edge& edge : hull.edges)
        if (edge.start == corner || edge.end == corner)
          edges.add(other.rotation * unit(hull.corners[edge.end] - hull.corners[edge.start]));
    }
    for (int i = 0; i < edges.count; ++i) search_great_circle(edges.points[i]);
  }

  // Two rims: the normal is sought along one great circle after another.
  void try_two_rims() {
    for (int i = 0; i < SWEEPS; ++i) {
      const Vector first = across(partner, normal);
      const Vector along = unit(cross(normal, std::abs(dot(first, normal)) < 0.9 ? first : axis_of(partner)));
      search_great_circle(along);
      search_great_circle(unit(cross(normal, along)));
    }
  }

  void search_great_circle(const Vector& along) {
    const Vector start = normal - dot(normal, along) * along;
    if (norm(start) < 1e-3) return;
    const Vector u = unit(start), v = cross(along, u);
    const auto at = [&](double angle) { return std::cos(angle) * u + std::sin(angle) * v; };
    const auto apart = [&](double angle) { return separation_along(partner, object, at(angle)); };
    const double width = MAX_ROTATION / COARSE_STEPS;
    double middle = 0.0, most = -INFINITY;
    for (int i = -COARSE_STEPS; i <= COARSE_STEPS; ++i)
      if (const double own = apart(i * width); own > most) {
        most = own;
        middle = i * width;
      }
    const double golden = 0.5 * (std::sqrt(5.0) - 1.0);
    double low = middle - width, high = middle + width;
    for (int i = 0; i < GOLDEN_STEPS; ++i) {
      const double left = high - golden * (high - low), right = low + golden * (high - low);
      (apart(left) > apart(right) ? high : low) = apart(left) > apart(right) ? right : left;
    }
    try_normal(at(0.5 * (low + high)));
  }
};

bool is_face_of(const ConvexBody& body, const Vector& normal, double& size) {
  size = extent_of_face(body, normal);
  return size >= 0.0;
}

// Whether the supporting features of both bodies along a normal face each other: no normal nearby separates them better.
bool face_each_other(const ConvexBody& partner, const ConvexBody& object, const Vector& normal, double separation) {
  const double rounding = FACING_TOLERANCE * (norm(partner.half) + norm(object.half));
  double size;
  if (is_face_of(partner, normal, size) || is_face_of(object, -1.0 * normal, size)) {
    std::vector<ManifoldPoint> found;
    contact_manifold_convex(partner, object, normal, separation + rounding, found);
    return !found.empty();
  }
  Corners there, here, nearest, back;
  support_segment(partner, normal, there);
  support_segment(object, -1.0 * normal, here);
  nearest_points(there, here, nearest);
  if (nearest.count == 0) return false;
  Corners point;
  point.add(nearest.points[0]);
  nearest_points(point, there, back);
  return norm(nearest.points[0] - back.points[0] - separation * normal) <= rounding;
}

// Whether the wall of a cylinder or capsule lies on a face of the other body with this normal.
bool wall_lies_on(const ConvexBody& partner, const ConvexBody& object, const Vector& normal) {
  const bool long_one = partner.shape.kind != ShapeKind::sphere && object.shape.kind != ShapeKind::sphere;
  double size;
  if (!long_one || !(is_face_of(partner, normal, size) || is_face_of(object, -1.0 * normal, size))) return false;
  std::vector<ManifoldPoint> found;
  contact_manifold_convex(partner, object, normal, INFINITY, found);
  return found.size() > 1;
}

}  // namespace

Hull::Hull(std::vector<Vector> points, const std::vector<std::vector<int>>& loops) : corners(std::move(points)) {
  const int count = static_cast<int>(corners.size());
  for (const std::vector<int>& loop : loops) {
    if (loop.size() < 3) throw std::invalid_argument("faces: expected three corners or more");
    for (const int corner : loop)
      if (corner < 0 || corner >= count) throw std::invalid_argument("faces: there is no such corner");
    Vector area{}, middle{};
    for (std::size_t i = 0; i < loop.size(); ++i) {
      const Vector &here = corners[loop[i]], &next = corners[loop[(i + 1) % loop.size()]];
      area = area + cross(here - corners[loop[0]], next - corners[loop[0]]);
      middle = middle + (1.0 / static_cast<double>(loop.size())) * here;
    }
    if (!(norm(area) > 0.0)) throw std::invalid_argument("faces: one has no area");
    Face face{unit(area), 0.0, 0.0, loop};
    for (const int corner : loop) {
      face.offset += dot(face.normal, corners[corner]) / static_cast<double>(loop.size());
      face.extent = std::max(face.extent, norm(corners[corner] - middle));
    }
    if (!(face.offset > 0.0)) throw std::invalid_argument("faces: the origin is not inside");
    faces.push_back(face);
  }
  faces_of.resize(corners.size());
  for (int f = 0; f < static_cast<int>(faces.size()); ++f)
    for (const int corner : faces[f].corners) faces_of[corner].push_back(f);
  for (const std::vector<int>& own : faces_of)
    if (own.empty()) throw std::invalid_argument("faces: a corner belongs to none");
  for (int f = 0; f < static_cast<int>(faces.size()); ++f) {
    const std::vector<int>& loop = faces[f].corners;
    for (std::size_t i = 0; i < loop.size(); ++i) {
      const int start = loop[i], end = loop[(i + 1) % loop.size()];
      int other = -1;
      for (int g = 0; g < static_cast<int>(faces.size()); ++g) {
        const std::vector<int>& back = faces[g].corners;
        for (std::size_t k = 0; k < back.size(); ++k)
          if (back[k] == end && back[(k + 1) % back.size()] == start) other = g;
      }
      if (other < 0) throw std::invalid_argument("faces: an edge belongs to one face only");
      if (start < end) edges.push_back({start, end, f, other});
    }
  }
}

double support_of(const ConvexBody& body, const Vector& normal) {
  const Vector local = transposed_times(body.rotation, normal);
  const Vector& half = body.half;
  switch (body.shape.kind) {
    case ShapeKind::box: return std::abs(local[0]) * half[0] + std::abs(local[1]) * half[1] + std::abs(local[2]) * half[2];
    case ShapeKind::sphere: return half[0];
    case ShapeKind::capsule: return half[0] + std::abs(local[2]) * core(body);
    case ShapeKind::cylinder: return half[0] * std::hypot(local[0], local[1]) + std::abs(local[2]) * half[2];
    case ShapeKind::hull: break;
  }
  double most = -INFINITY;
  for (const Vector& corner : body.shape.hull->corners) most = std::max(most, dot(local, corner));
  return most;
}

SeparatingAxis separating_axis_convex(const ConvexBody& partner, const ConvexBody& object, double aligned) {
  Search search{partner, object, aligned};
  const auto has_faces = [](const ConvexBody& body) {
    return body.shape.kind != ShapeKind::sphere && body.shape.kind != ShapeKind::capsule;
  };
  if (has_faces(partner)) search.try_face_normals(partner, 1.0);
  if (has_faces(object)) search.try_face_normals(object, -1.0);
  const Vector facing = search.normal;
  if (partner.shape.kind == ShapeKind::hull) search.try_hull_edges(partner, object, 1.0);
  if (object.shape.kind == ShapeKind::hull && partner.shape.kind != ShapeKind::hull)
    search.try_hull_edges(object, partner, -1.0);
  Corners own, others;
  search.add_edges(partner, own);
  search.add_edges(object, others);
  for (int i = 0; i < own.count; ++i)
    for (int j = 0; j < others.count; ++j) search.try_edge_pair(own.points[i], others.points[j]);
  const auto has_corners = [](const ConvexBody& body) {
    return body.shape.kind == ShapeKind::box || body.shape.kind == ShapeKind::hull;
  };
  const bool both = has_corners(partner) && has_corners(object);
  if (dot(search.normal, facing) > SAME_NORMAL_COSINE && (both || wall_lies_on(partner, object, facing)))
    search.normal = facing;
  search.try_vertices(object, partner, 1.0);
  search.try_vertices(partner, object, -1.0);
  if (search.separation == -INFINITY) search.try_normal({0.0, 0.0, 1.0});  // balls with one centre
  if (partner.shape.kind == ShapeKind::cylinder || object.shape.kind == ShapeKind::cylinder) {
    if (!face_each_other(partner, object, search.normal, search.separation)) {
      if (partner.shape.kind == ShapeKind::cylinder) search.try_rims(object, -1.0);
      if (object.shape.kind == ShapeKind::cylinder) search.try_rims(partner, 1.0);
      if (partner.shape.kind == object.shape.kind) search.try_two_rims();
    }
  }
  double on_partner, on_object;
  const bool of_partner = is_face_of(partner, search.normal, on_partner);
  const bool larger = !(of_partner && on_partner >= extent_of_face(object, -1.0 * search.normal));
  const bool of_object = is_face_of(object, -1.0 * search.normal, on_object) && larger;
  return {search.separation, search.normal, of_object, std::nullopt};
}

void contact_manifold_convex(const ConvexBody& partner, const ConvexBody& object, const Vector& normal, double tolerance,
                             std::vector<ManifoldPoint>& found) {
  double of_partner, of_object;
  const bool partner_owns = is_face_of(partner, normal, of_partner);
  const bool on_object = is_face_of(object, -1.0 * normal, of_object) && !(partner_owns && of_partner >= of_object);
  const double separation = separation_along(partner, object, normal);
  if (!partner_owns && !on_object) {
    if (separation > tolerance) return;
    Corners there, here, nearest;
    support_segment(partner, normal, there);
    support_segment(object, -1.0 * normal, here);
    nearest_points(there, here, nearest);
    for (int i = 0; i < nearest.count; ++i) found.push_back({nearest.points[i], separation});
    return;
  }
  // The reference face owns the normal; what of the other body faces it is clipped to its sides.
  const ConvexBody& reference = on_object ? object : partner;
  const ConvexBody& incident = on_object ? partner : object;
  const Vector outward = on_object ? -1.0 * normal : normal;
  Corners face, polygon;
  supporting_face(reference, outward, face);
  supporting_face(incident, -1.0 * outward, polygon);
  const bool turns_left = dot(cross(face.points[1] - face.points[0], face.points[2] - face.points[1]), outward) > 0.0;
  for (int i = 0; i < face.count && polygon.count > 0; ++i) {
    const Vector& start = face.points[i];
    const Vector side = face.points[(i + 1) % face.count] - start;
    const Vector away = unit((turns_left ? 1.0 : -1.0) * cross(side, outward));
    clip(polygon, away, dot(away, start));
  }
  const double level = dot(outward, reference.centre) + support_of(reference, outward);
  for (int i = 0; i < polygon.count; ++i) {
    const double height = dot(outward, polygon.points[i]) - level;
    if (height > tolerance) continue;
    found.push_back({on_object ? polygon.points[i] - height * outward : polygon.points[i], height});
  }
}

}  // namespace impact_rs
