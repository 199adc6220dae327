// SPDX-License-Identifier: Apache-2.0

#include "boxes.hpp"

#include <algorithm>

#include "shapes.hpp"

namespace impact_rs {

namespace {

int largest(const Vector& values) {
  int axis = 0;
  for (int i = 1; i < 3; ++i)
    if (std::abs(values[i]) > std::abs(values[axis])) axis = i;
  return axis;
}

// Half the diagonal of a box's face across an axis [m].
double extent(const ConvexBody& box, const Vector& axis) {
  const int along = largest(transposed_times(box.rotation, axis));
  return std::hypot(box.half[(along + 1) % 3], box.half[(along + 2) % 3]);
}

double half_width(const ConvexBody& box, const Vector& axis) {
  const Vector local = transposed_times(box.rotation, axis);
  return std::abs(local[0]) * box.half[0] + std::abs(local[1]) * box.half[1] + std::abs(local[2]) * box.half[2];
}

// Four corners and one more for each of four cuts. Where rounding bends an edge, a cut may add more; what does not fit is
// left out.
struct Polygon {
  std::array<Vector, 16> corners;
  int count = 0;

  void add(const Vector& corner) {
    if (count < static_cast<int>(corners.size())) corners[count++] = corner;
  }
};

// Corners of the face whose normal is nearest to `direction`, in order around it, in A.
Polygon corners_of(const ConvexBody& box, const Vector& direction) {
  const Vector local = transposed_times(box.rotation, direction);
  const int axis = largest(local);
  const int u = axis == 0 ? 1 : 0, v = axis == 2 ? 1 : 2;
  const double first[] = {1.0, -1.0, -1.0, 1.0}, second[] = {1.0, 1.0, -1.0, -1.0};
  Polygon face;
  for (int i = 0; i < 4; ++i) {
    Vector corner;
    corner[axis] = std::copysign(box.half[axis], local[axis]);
    corner[u] = first[i] * box.half[u];
    corner[v] = second[i] * box.half[v];
    face.add(box.centre + box.rotation * corner);
  }
  return face;
}

// The part with sign * coordinate <= limit.
void clip(Polygon& polygon, int axis, double sign, double limit) {
  bool inside = true;
  for (int i = 0; i < polygon.count; ++i) inside = inside && sign * polygon.corners[i][axis] - limit <= 0.0;
  if (inside) return;
  Polygon kept;
  for (int i = 0; i < polygon.count; ++i) {
    const Vector& corner = polygon.corners[i];
    const Vector& last = polygon.corners[(i + polygon.count - 1) % polygon.count];
    const double here = sign * corner[axis] - limit, previous = sign * last[axis] - limit;
    if ((here <= 0.0) != (previous <= 0.0)) kept.add(last + (previous / (previous - here)) * (corner - last));
    if (here <= 0.0) kept.add(corner);
  }
  polygon = kept;
}

constexpr double PARALLEL_SINE = 1e-2;  // sine of the angle of two edges, below which they do not cross
constexpr double SAME_NORMAL_COSINE = 0.995;  // cosine, above which a common normal of edges is that of a face

// The six directions of faces, the partner's first.
struct Faces {
  Vector axes[6];
  double distance[6], separation[6];
  int chosen = 0;

  Vector normal() const { return (distance[chosen] >= 0.0 ? 1.0 : -1.0) * axes[chosen]; }
};

// Of faces that separate as well as the best one up to `aligned` [m] the larger one is chosen.
Faces compare_faces(const ConvexBody& partner, const ConvexBody& object, double aligned) {
  const Vector apart = object.centre - partner.centre;
  Faces faces;
  double best = -INFINITY;
  for (int i = 0; i < 6; ++i) {
    faces.axes[i] = column(i < 3 ? partner.rotation : object.rotation, i % 3);
    faces.distance[i] = dot(faces.axes[i], apart);
    faces.separation[i] =
        std::abs(faces.distance[i]) - (half_width(partner, faces.axes[i]) + half_width(object, faces.axes[i]));
    best = std::max(best, faces.separation[i]);
  }
  double least = INFINITY;
  for (int i = 0; i < 6; ++i) {
    if (!(faces.separation[i] >= best - aligned)) continue;
    const double across = extent(i >= 3 ? partner : object, faces.axes[i]);
    if (across < least) {
      least = across;
      faces.chosen = i;
    }
  }
  return faces;
}

// Middle of the edge along `axis` that is furthest along `direction`.
Vector edge(const ConvexBody& box, int axis, const Vector& direction) {
  Vector middle = box.centre;
  for (int k = 0; k < 3; ++k) {
    const Vector side = column(box.rotation, k);
    if (k != axis) middle = middle + std::copysign(box.half[k], dot(side, direction)) * side;
  }
  return middle;
}

// Distance of two boxes along a direction, negative: overlap [m].
double separation_along(const ConvexBody& partner, const ConvexBody& object, const Vector& normal) {
  return dot(normal, object.centre - partner.centre) - (half_width(partner, normal) + half_width(object, normal));
}

// Where the foremost edges along two axes are nearest to each other; nowhere: beyond their ends.
std::optional<ManifoldPoint> crossing(const ConvexBody& partner, const ConvexBody& object, Edges edges,
                                      const Vector& normal, double separation) {
  const Vector a = column(partner.rotation, edges.partner), b = column(object.rotation, edges.object);
  const double sine = norm(cross(a, b)), cosine = dot(a, b);
  const Vector own = edge(object, edges.object, -1.0 * normal), between = own - edge(partner, edges.partner, normal);
  const double along_a = dot(between, a), along_b = dot(between, b);
  const double on_a = (along_a - cosine * along_b) / (sine * sine), on_b = (cosine * along_a - along_b) / (sine * sine);
  if (std::abs(on_a) > partner.half[edges.partner] || std::abs(on_b) > object.half[edges.object]) return std::nullopt;
  return ManifoldPoint{own + on_b * b, separation};
}

// Separating axis of two boxes whose faces were compared: that of two edges that cross, if it separates better than every
// face. Edges that cross at a small angle to a face are corners of the faces, clipped to each other.
SeparatingAxis best_axis(const ConvexBody& partner, const ConvexBody& object, const Faces& faces) {
  const Vector apart = object.centre - partner.centre, facing = faces.normal();
  SeparatingAxis best{faces.separation[faces.chosen], facing, faces.chosen >= 3, std::nullopt};
  std::optional<Edges> edges;
  Vector common{};
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      const Vector across = cross(column(partner.rotation, i), column(object.rotation, j));
      const double sine = norm(across);
      if (sine < PARALLEL_SINE) continue;
      const Vector normal = std::copysign(1.0 / sine, dot(across, apart)) * across;
      const double separation = separation_along(partner, object, normal);
      if (separation <= best.separation || !crossing(partner, object, {i, j}, normal, separation)) continue;
      best.separation = separation;
      common = normal;
      edges = Edges{i, j};
    }
  }
  if (edges && dot(common, facing) < SAME_NORMAL_COSINE) {
    best.normal = common;
    best.on_object = false;
    best.edges = edges;
  }
  return best;
}

// Whether the separating axis is a face normal, so that edges need no test. Boxes that are turned against each
// other by less than PARALLEL have edges that are parallel, and others whose common normal is within 2 PARALLEL of that
// of a face. Along it the separation differs by no more than this angle times the distances of centres and corners.
bool faces_decide(const ConvexBody& partner, const ConvexBody& object, const Faces& faces) {
  const Vector facing = faces.axes[faces.chosen];
  const double least = std::sqrt(1.0 - PARALLEL_SINE * PARALLEL_SINE);
  const double changed =
      2.0 * PARALLEL_SINE * (norm(object.centre - partner.centre) + norm(partner.half) + norm(object.half));
  for (int i = 0; i < 3; ++i) {
    double along = 0.0;
    for (int j = 3; j < 6; ++j) along = std::max(along, std::abs(dot(faces.axes[i], faces.axes[j])));
    if (along < least) return false;
    const bool own = std::abs(dot(faces.axes[i], facing)) > SAME_NORMAL_COSINE;
    if (!own && faces.separation[i] + changed >= faces.separation[faces.chosen]) return false;
  }
  return true;
}

bool both_boxes(const ConvexBody& partner, const ConvexBody& object) {
  return partner.shape.kind == ShapeKind::box && object.shape.kind == ShapeKind::box;
}

}  // namespace

SeparatingAxis separating_axis(const ConvexBody& partner, const ConvexBody& object, double aligned) {
  if (!both_boxes(partner, object)) return separating_axis_convex(partner, object, aligned);
  return best_axis(partner, object, compare_faces(partner, object, aligned));
}

void contact_manifold(const ConvexBody& partner, const ConvexBody& object, const SeparatingAxis& separating,
                      double tolerance, std::vector<ManifoldPoint>& found) {
  if (!both_boxes(partner, object)) return contact_manifold_convex(partner, object, separating.normal, tolerance, found);
  if (separating.edges) {
    const double separation = separation_along(partner, object, separating.normal);
    if (separation > tolerance) return;
    const auto candidate = crossing(partner, object, *separating.edges, separating.normal, separation);
    if (candidate) found.push_back(*candidate);
    return;
  }
  // The reference face owns the normal; the incident face of the other box is clipped to it.
  const ConvexBody& reference = separating.on_object ? object : partner;
  const ConvexBody& incident = separating.on_object ? partner : object;
  const Vector outward = separating.on_object ? -1.0 * separating.normal : separating.normal;
  const int axis = largest(transposed_times(reference.rotation, outward));
  const double facing = std::copysign(1.0, dot(column(reference.rotation, axis), outward));
  Polygon polygon = corners_of(incident, -1.0 * outward);
  for (int i = 0; i < polygon.count; ++i)
    polygon.corners[i] = transposed_times(reference.rotation, polygon.corners[i] - reference.centre);
  for (int side = 0; side < 3; ++side) {
    if (side == axis) continue;
    clip(polygon, side, 1.0, reference.half[side]);
    clip(polygon, side, -1.0, reference.half[side]);
  }
  for (int i = 0; i < polygon.count; ++i) {
    const Vector& point = polygon.corners[i];
    const double height = facing * point[axis] - reference.half[axis];
    if (height > tolerance) continue;
    Vector position = reference.centre + reference.rotation * point;
    if (separating.on_object) position = position - height * outward;
    found.push_back({position, height});
  }
}

Vector collide(const ConvexBody& partner, const ConvexBody& object, double aligned, double margin, double tolerance,
             std::vector<ManifoldPoint>& found) {
  if (!both_boxes(partner, object)) {
    const SeparatingAxis separating = separating_axis_convex(partner, object, aligned);
    if (separating.separation < margin) contact_manifold_convex(partner, object, separating.normal, tolerance, found);
    return separating.normal;
  }
  const Faces faces = compare_faces(partner, object, aligned);
  const double separation = faces.separation[faces.chosen];
  SeparatingAxis separating{separation, faces.normal(), faces.chosen >= 3, std::nullopt};
  if (separation >= margin) return separating.normal;
  if (!faces_decide(partner, object, faces)) separating = best_axis(partner, object, faces);
  contact_manifold(partner, object, separating, tolerance, found);
  return separating.normal;
}

}  // namespace impact_rs
