// SPDX-License-Identifier: Apache-2.0
// Small dense algebra: vectors of three and row-major matrices of some dozens of rows.

#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>
#include <vector>

namespace impact_rs {

using Vector = std::array<double, 3>;
using Matrix = std::array<double, 9>;  // 3 x 3, row by row

inline Vector vector(const double* values) { return {values[0], values[1], values[2]}; }
inline Vector operator+(const Vector& a, const Vector& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
inline Vector operator-(const Vector& a, const Vector& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
inline Vector operator*(double s, const Vector& a) { return {s * a[0], s * a[1], s * a[2]}; }
inline double dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
inline double norm(const Vector& a) { return std::sqrt(dot(a, a)); }

inline Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

inline Matrix transposed(const Matrix& m) { return {m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]}; }
inline Vector row(const Matrix& m, int i) { return {m[3 * i], m[3 * i + 1], m[3 * i + 2]}; }
inline Vector column(const Matrix& m, int j) { return {m[j], m[3 + j], m[6 + j]}; }

inline Vector operator*(const Matrix& m, const Vector& a) {
  return {m[0] * a[0] + m[1] * a[1] + m[2] * a[2], m[3] * a[0] + m[4] * a[1] + m[5] * a[2],
          m[6] * a[0] + m[7] * a[1] + m[8] * a[2]};
}

// m^T a
inline Vector transposed_times(const Matrix& m, const Vector& a) {
  return {m[0] * a[0] + m[3] * a[1] + m[6] * a[2], m[1] * a[0] + m[4] * a[1] + m[7] * a[2],
          m[2] * a[0] + m[5] * a[1] + m[8] * a[2]};
}

inline Matrix operator*(const Matrix& a, const Matrix& b) {
  Matrix c{};
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k)
      for (int j = 0; j < 3; ++j) c[3 * i + j] += a[3 * i + k] * b[3 * k + j];
  return c;
}

constexpr Matrix IDENTITY{1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};

// exp([a]) m: axes turned by a rotation vector [rad].
inline Matrix turned(const Vector& a, const Matrix& m) {
  const double square = dot(a, a), angle = std::sqrt(square);
  const double s = square < 1e-8 ? 1.0 - square / 6.0 : std::sin(angle) / angle;
  const double c = square < 1e-8 ? 0.5 - square / 24.0 : (1.0 - std::cos(angle)) / square;
  Matrix found;
  for (int j = 0; j < 3; ++j) {
    const Vector axis = column(m, j), first = cross(a, axis), second = cross(a, first);
    for (int i = 0; i < 3; ++i) found[3 * i + j] = axis[i] + s * first[i] + c * second[i];
  }
  return found;
}

// Cholesky factor L of a = L L^T in its lower triangle, in place; false where a is not positive definite.
inline bool factorise(double* a, int n) {
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j <= i; ++j) {
      double sum = a[i * n + j];
      for (int k = 0; k < j; ++k) sum -= a[i * n + k] * a[j * n + k];
      if (i != j) {
        a[i * n + j] = sum / a[j * n + j];
      } else if (sum > 0.0) {
        a[i * n + i] = std::sqrt(sum);
      } else {
        return false;
      }
    }
  }
  return true;
}

// L^-1 x of `columns` vectors at once, x (n, columns) in place.
inline void forward(const double* factor, int n, double* x, int columns) {
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k < i; ++k)
      for (int c = 0; c < columns; ++c) x[i * columns + c] -= factor[i * n + k] * x[k * columns + c];
    for (int c = 0; c < columns; ++c) x[i * columns + c] /= factor[i * n + i];
  }
}

// L^-T x, likewise.
inline void backward(const double* factor, int n, double* x, int columns) {
  for (int i = n - 1; i >= 0; --i) {
    for (int k = i + 1; k < n; ++k)
      for (int c = 0; c < columns; ++c) x[i * columns + c] -= factor[k * n + i] * x[k * columns + c];
    for (int c = 0; c < columns; ++c) x[i * columns + c] /= factor[i * n + i];
  }
}

// Solve a x = b in place of both, a (n, n), by elimination with partial pivoting; false where a is singular.
inline bool eliminate(double* a, double* b, int n) {
  for (int k = 0; k < n; ++k) {
    int pivot = k;
    for (int i = k + 1; i < n; ++i)
      if (std::abs(a[i * n + k]) > std::abs(a[pivot * n + k])) pivot = i;
    const double inverse = 1.0 / a[pivot * n + k];
    if (!std::isfinite(inverse)) return false;
    if (pivot != k) {
      std::swap_ranges(a + k * n + k, a + k * n + n, a + pivot * n + k);
      std::swap(b[k], b[pivot]);
    }
    const double* top = a + k * n;
    for (int i = k + 1; i < n; ++i) {
      double* row = a + i * n;
      if (row[k] == 0.0) continue;
      const double factor = row[k] * inverse;
      for (int j = k + 1; j < n; ++j) row[j] -= factor * top[j];
      b[i] -= factor * b[k];
    }
  }
  for (int i = n - 1; i >= 0; --i) {
    for (int j = i + 1; j < n; ++j) b[i] -= a[i * n + j] * b[j];
    b[i] /= a[i * n + i];
  }
  return true;
}

}  // namespace impact_rs
