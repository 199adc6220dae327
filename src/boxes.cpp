// SPDX-License-Identifier: Apache-2.0

#include "boxes.hpp"

namespace impact_rs {

namespace {

int largest(const Vector& values) {
  int axis = 0;
  for (int i = 1; i < 3; ++i)
    if (std::abs(values[i]) > std::abs(values[axis])) axis = i;
  return axis;
}

// Half the diagonal of a box's face across an axis [m].
double extent(const Box& box, const Vector& axis) {
  const int along = largest(transposed_times(box.rotation, axis));
  return std::hypot(box.half[(along + 1) % 3], box.half[(along + 2) % 3]);
}

double reach(const Box& box, const Vector& axis) {
  const Vector local = transposed_times(box.rotation, axis);
  return std::abs(local[0]) * box.half[0] + std::abs(local[1]) * box.half[1] + std::abs(local[2]) * box.half[2];
}

// Four corners and one more for each of four cuts; more only where rounding bends an edge.
struct Polygon {
  std::array<Vector, 16> corners;
  int count = 0;
};

// Corners of the face that looks most along `direction`, in order around it, in A.
Polygon corners_of(const Box& box, const Vector& direction) {
  const Vector local = transposed_times(box.rotation, direction);
  const int axis = largest(local);
  const int u = axis == 0 ? 1 : 0, v = axis == 2 ? 1 : 2;
  const double first[] = {1.0, -1.0, -1.0, 1.0}, second[] = {1.0, 1.0, -1.0, -1.0};
  Polygon face;
  for (face.count = 0; face.count < 4; ++face.count) {
    Vector corner;
    corner[axis] = std::copysign(box.half[axis], local[axis]);
    corner[u] = first[face.count] * box.half[u];
    corner[v] = second[face.count] * box.half[v];
    face.corners[face.count] = box.centre + box.rotation * corner;
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
    if ((here <= 0.0) != (previous <= 0.0))
      kept.corners[kept.count++] = last + (previous / (previous - here)) * (corner - last);
    if (here <= 0.0) kept.corners[kept.count++] = corner;
  }
  polygon = kept;
}

constexpr double PARALLEL = 1e-2;  // sine of the angle of two edges

// Middle of the edge along `axis` that is furthest along `direction`.
Vector edge(const Box& box, int axis, const Vector& direction) {
  Vector place = box.centre;
  for (int k = 0; k < 3; ++k) {
    const Vector side = column(box.rotation, k);
    if (k != axis) place = place + std::copysign(box.half[k], dot(side, direction)) * side;
  }
  return place;
}

}  // namespace

Face separating_face(const Box& partner, const Box& object, double aligned) {
  const Vector apart = object.centre - partner.centre;
  Vector axes[6];
  double distance[6], separation[6], best = -INFINITY;
  for (int i = 0; i < 6; ++i) {
    axes[i] = column(i < 3 ? partner.rotation : object.rotation, i % 3);
    distance[i] = dot(axes[i], apart);
    separation[i] = std::abs(distance[i]) - (reach(partner, axes[i]) + reach(object, axes[i]));
    best = std::max(best, separation[i]);
  }
  int chosen = 0;
  double least = INFINITY;
  for (int i = 0; i < 6; ++i) {
    if (!(separation[i] >= best - aligned)) continue;
    const double across = extent(i >= 3 ? partner : object, axes[i]);
    if (across < least) {
      least = across;
      chosen = i;
    }
  }
  const double sign = distance[chosen] >= 0.0 ? 1.0 : -1.0;
  return {separation[chosen], sign * axes[chosen], chosen >= 3};
}

void touching(const Box& partner, const Box& object, const Face& face, double tolerance, std::vector<Touch>& found) {
  // The reference face owns the normal; the incident face of the other box is clipped to it.
  const Box& reference = face.on_object ? object : partner;
  const Box& incident = face.on_object ? partner : object;
  const Vector outward = face.on_object ? -1.0 * face.normal : face.normal;
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
    if (face.on_object) position = position - height * outward;
    found.push_back({position, height});
  }
}

std::optional<Crossing> crossing_edges(const Box& partner, const Box& object) {
  const Vector apart = object.centre - partner.centre;
  std::optional<Crossing> best;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      const Vector a = column(partner.rotation, i), b = column(object.rotation, j), across = cross(a, b);
      const double sine = norm(across);
      if (sine < PARALLEL) continue;
      const Vector normal = std::copysign(1.0 / sine, dot(across, apart)) * across;
      const double separation = dot(normal, apart) - (reach(partner, normal) + reach(object, normal));
      if (best && separation <= best->separation) continue;
      // The points of both lines that are nearest to each other.
      const Vector own = edge(object, j, -1.0 * normal), between = own - edge(partner, i, normal);
      const double cosine = dot(a, b), along_a = dot(between, a), along_b = dot(between, b);
      const double on_a = (along_a - cosine * along_b) / (sine * sine), on_b = (cosine * along_a - along_b) / (sine * sine);
      if (std::abs(on_a) > partner.half[i] || std::abs(on_b) > object.half[j]) continue;
      best = Crossing{separation, normal, {own + on_b * b, separation}};
    }
  }
  return best;
}

}  // namespace impact_rs
