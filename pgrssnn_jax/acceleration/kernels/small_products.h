// Products of small row-major float32 matrices, whose sums stay in registers, and exp(x) by a polynomial.
//
// Eigen, which XLA calls, is made for matrices that do not fit the cache; for 16 to 64 columns its overhead is most of
// the time.

#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <vector>

namespace small {

// kLanes: floats of a register; kSums: registers that hold the sums of a block, of 32 or 16 that there are. A vector of
// two registers, or more sums than registers, go through memory at every addition: ten times slower.
#if defined(__AVX512F__)
constexpr int64_t kLanes = 16, kSums = 24;
#elif defined(__AVX__)
constexpr int64_t kLanes = 8, kSums = 12;
#elif defined(__aarch64__)
constexpr int64_t kLanes = 4, kSums = 24;
#else
constexpr int64_t kLanes = 4, kSums = 12;
#endif
constexpr int64_t kChunkRows = 64;  // rows whose intermediate results are held at once: they stay in the cache
using Vector = float __attribute__((vector_size(kLanes * sizeof(float)), aligned(sizeof(float)), may_alias));

// exp(x) to a relative 2e-7: x = k ln 2 + r, a polynomial of degree 6 in r. Source: Cephes library, expf.
inline float exponential(float x) {
  x = x < -87.0f ? -87.0f : x > 87.0f ? 87.0f : x;  // NaN stays NaN
  const float k = __builtin_floorf(x * 1.44269504f + 0.5f);
  const float r = x - k * 0.693359375f + k * 2.12194440e-4f;
  float p = 1.9875691500e-4f;
  p = p * r + 1.3981999507e-3f;
  p = p * r + 8.3334519073e-3f;
  p = p * r + 4.1665795894e-2f;
  p = p * r + 1.6666665459e-1f;
  p = p * r + 5.0000001201e-1f;
  p = p * r * r + r + 1.0f;
  const float whole = k > -127.0f ? k : -127.0f;  // NaN has no whole number
  const int32_t exponent = (static_cast<int32_t>(whole) + 127) << 23;
  float scale;
  std::memcpy(&scale, &exponent, sizeof scale);
  return p * scale;
}

// absolute errors of 1e-7: the relative error of tanh grows where |x| is small
inline float sigmoid(float x) { return 1.0f / (1.0f + exponential(-x)); }
inline float hyperbolic_tangent(float x) { return 1.0f - 2.0f / (exponential(2.0f * x) + 1.0f); }

// a[row, inner] with any strides
struct Matrix {
  const float* at;
  int64_t row, inner;
  float operator()(int64_t s, int64_t i) const { return at[s * row + i * inner]; }
  Matrix from_row(int64_t s) const { return {at + s * row, row, inner}; }
};

inline Vector& vector_at(float* at) { return *reinterpret_cast<Vector*>(at); }
inline const Vector& vector_at(const float* at) { return *reinterpret_cast<const Vector*>(at); }

// What the sums of a product begin with: the rows of an array, or one row for all (stride 0).
struct Begin {
  const float* at;
  int64_t row;
};

// out[s, :] = begin[s, :] + sum_i a[s, i] b[i, :] for kRows rows and kWidth vectors of columns; the sums stay in registers
template <int kRows, int kWidth>
inline void block(Matrix a, const float* b, Begin begin, int64_t inner, int64_t columns, float* out) {
  Vector sum[kRows][kWidth];
#pragma GCC unroll 8
  for (int s = 0; s < kRows; ++s)
#pragma GCC unroll 4
    for (int c = 0; c < kWidth; ++c) sum[s][c] = vector_at(begin.at + s * begin.row + c * kLanes);
  for (int64_t i = 0; i < inner; ++i) {
    Vector row[kWidth];
#pragma GCC unroll 4
    for (int c = 0; c < kWidth; ++c) row[c] = vector_at(b + i * columns + c * kLanes);
#pragma GCC unroll 8
    for (int s = 0; s < kRows; ++s)
#pragma GCC unroll 4
      for (int c = 0; c < kWidth; ++c) sum[s][c] += a(s, i) * row[c];
  }
#pragma GCC unroll 8
  for (int s = 0; s < kRows; ++s)
#pragma GCC unroll 4
    for (int c = 0; c < kWidth; ++c) vector_at(out + s * columns + c * kLanes) = sum[s][c];
}

// the same for one row and one vector: four sums, because one would wait for its own last addition
template <>
inline void block<1, 1>(Matrix a, const float* b, Begin begin, int64_t inner, int64_t columns, float* out) {
  Vector sum[4] = {vector_at(begin.at)};
  int64_t i = 0;
  for (; i + 4 <= inner; i += 4)
#pragma GCC unroll 4
    for (int j = 0; j < 4; ++j) sum[j] += a(0, i + j) * vector_at(b + (i + j) * columns);
  for (; i < inner; ++i) sum[0] += a(0, i) * vector_at(b + i * columns);
  vector_at(out) = (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

// kWidth vectors of columns of all rows
template <int kWidth>
inline void panel(Matrix a, const float* b, Begin begin, int64_t rows, int64_t inner, int64_t columns, float* out) {
  constexpr int kTall = std::min<int64_t>(8, kSums / kWidth);
  int64_t s = 0;
  const auto from = [&] { return Begin{begin.at + s * begin.row, begin.row}; };
  for (; s + kTall <= rows; s += kTall) block<kTall, kWidth>(a.from_row(s), b, from(), inner, columns, out + s * columns);
  for (; s + 2 <= rows; s += 2) block<2, kWidth>(a.from_row(s), b, from(), inner, columns, out + s * columns);
  for (; s < rows; ++s) block<1, kWidth>(a.from_row(s), b, from(), inner, columns, out + s * columns);
}

// column after column, because there are few
inline void copy_columns(const float* __restrict from, int64_t from_row, int64_t rows, int64_t columns, float* __restrict to,
                         int64_t to_row) {
  for (int64_t c = 0; c < columns; ++c)
    for (int64_t s = 0; s < rows; ++s) to[s * to_row + c] = from[s * from_row + c];
}

// out [rows, columns] = begin + a [rows, inner] b [inner, columns]; begin may be out
inline void product(Matrix a, const float* b, Begin begin, int64_t rows, int64_t inner, int64_t columns, float* out) {
  int64_t c = 0;
  const auto from = [&] { return Begin{begin.at + c, begin.row}; };
  for (; c + 3 * kLanes <= columns; c += 3 * kLanes) panel<3>(a, b + c, from(), rows, inner, columns, out + c);
  for (; c + 2 * kLanes <= columns; c += 2 * kLanes) panel<2>(a, b + c, from(), rows, inner, columns, out + c);
  for (; c + kLanes <= columns; c += kLanes) panel<1>(a, b + c, from(), rows, inner, columns, out + c);
  if (c == columns) return;
  const int64_t rest = columns - c;  // fewer columns than a vector has floats: zeros beside them
  const int64_t begins = begin.row ? rows : 1, begin_row = begin.row ? kLanes : 0;
  std::vector<float> b_rest(inner * kLanes), begin_rest(begins * kLanes), out_rest(rows * kLanes);
  copy_columns(b + c, columns, inner, rest, b_rest.data(), kLanes);
  copy_columns(begin.at + c, begin.row, begins, rest, begin_rest.data(), kLanes);
  panel<1>(a, b_rest.data(), {begin_rest.data(), begin_row}, rows, inner, kLanes, out_rest.data());
  copy_columns(out_rest.data(), kLanes, rows, rest, out + c, columns);
}

// out [rows, columns] += a [rows, inner] b [inner, columns]
inline void multiply_add(Matrix a, const float* b, int64_t rows, int64_t inner, int64_t columns, float* out) {
  product(a, b, {out, columns}, rows, inner, columns, out);
}

// out [rows, columns] = bias + a b
inline void affine(Matrix a, const float* b, const float* bias, int64_t rows, int64_t inner, int64_t columns, float* out) {
  product(a, b, {bias, 0}, rows, inner, columns, out);
}

// out += the sum of the rows of a [rows, columns]
inline void add_rows(const float* a, int64_t rows, int64_t columns, float* out) {
  for (int64_t s = 0; s < rows; ++s)
    for (int64_t c = 0; c < columns; ++c) out[c] += a[s * columns + c];
}

// out [columns, rows] = a [rows, columns] transposed
inline void transpose(const float* a, int64_t rows, int64_t columns, float* out) {
  for (int64_t s = 0; s < rows; ++s)
    for (int64_t c = 0; c < columns; ++c) out[c * rows + s] = a[s * columns + c];
}

}  // namespace small
