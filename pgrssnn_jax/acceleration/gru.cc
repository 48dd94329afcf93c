// The recurrence of a gated recurrent unit and its gradient, members one after another.
//
//   r = s(p_r + W_hr h + b_hr)    z = s(p_z + W_hz h + b_hz)    n = tanh(p_n + r (W_hn h + b_hn))    h+ = (1 - z) n + z h
//
// Equations and order of gates as in models/gru.py, whose scan is the reference. Dense row-major float32 arrays:
// kernel [.., H, 3H], bias [.., 3H], projected [.., T, S, 3H], states [.., T, S, H]; leading axes are members.
// The forward pass keeps the states alone: to compute the gates again costs less than to write them to memory.

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <vector>

#include "xla/ffi/api/ffi.h"

namespace ffi = xla::ffi;

namespace {

constexpr int64_t kLanes = 16;         // floats of a vector: one register of AVX-512, two of AVX2, four of NEON
constexpr int64_t kChunkRows = 64;     // time steps x sequences whose gates are held at once: they stay in the cache
using Vector = float __attribute__((vector_size(kLanes * sizeof(float)), aligned(sizeof(float)), may_alias));

// exp(x) to 2e-7: x = k ln 2 + r, a polynomial of degree 6 in r. Source: Cephes library, expf.
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
  const int32_t exponent = (static_cast<int32_t>(k) + 127) << 23;
  float scale;
  std::memcpy(&scale, &exponent, sizeof scale);
  return p * scale;
}

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

// out[s, :] += sum_i a[s, i] b[i, :] for kRows rows and kWidth vectors of columns, whose sums stay in registers
template <int kRows, int kWidth>
inline void block(Matrix a, const float* b, int64_t inner, int64_t columns, float* out) {
  Vector sum[kRows][kWidth];
#pragma GCC unroll 8
  for (int s = 0; s < kRows; ++s)
#pragma GCC unroll 4
    for (int c = 0; c < kWidth; ++c) sum[s][c] = vector_at(out + s * columns + c * kLanes);
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
inline void block<1, 1>(Matrix a, const float* b, int64_t inner, int64_t columns, float* out) {
  Vector sum[4] = {vector_at(out)};
  int64_t i = 0;
  for (; i + 4 <= inner; i += 4)
#pragma GCC unroll 4
    for (int j = 0; j < 4; ++j) sum[j] += a(0, i + j) * vector_at(b + (i + j) * columns);
  for (; i < inner; ++i) sum[0] += a(0, i) * vector_at(b + i * columns);
  vector_at(out) = (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

template <int kRows>
inline void strip(Matrix a, const float* b, int64_t inner, int64_t columns, float* out) {
  int64_t c = 0;
  for (; c + 3 * kLanes <= columns; c += 3 * kLanes) block<kRows, 3>(a, b + c, inner, columns, out + c);
  for (; c + kLanes <= columns; c += kLanes) block<kRows, 1>(a, b + c, inner, columns, out + c);
  for (; c < columns; ++c)
    for (int s = 0; s < kRows; ++s)
      for (int64_t i = 0; i < inner; ++i) out[s * columns + c] += a(s, i) * b[i * columns + c];
}

// out [rows, columns] += a [rows, inner] b [inner, columns]
inline void multiply_add(Matrix a, const float* b, int64_t rows, int64_t inner, int64_t columns, float* out) {
  int64_t s = 0;
  for (; s + 8 <= rows; s += 8) strip<8>(a.from_row(s), b, inner, columns, out + s * columns);
  for (; s + 4 <= rows; s += 4) strip<4>(a.from_row(s), b, inner, columns, out + s * columns);
  for (; s < rows; ++s) strip<1>(a.from_row(s), b, inner, columns, out + s * columns);
}

// recurrent [rows, 3H] = bias + before [rows, H] kernel
inline void recur(const float* before, const float* kernel, const float* bias, int64_t rows, int64_t H, float* recurrent) {
  for (int64_t s = 0; s < rows; ++s) std::copy_n(bias, 3 * H, recurrent + s * 3 * H);
  multiply_add({before, H, 1}, kernel, rows, H, 3 * H, recurrent);
}

// r, z and n of one row from its projected input p and its recurrent part
inline void gate(const float* __restrict p, const float* __restrict recurrent, int64_t H, float* __restrict gates) {
  for (int64_t i = 0; i < 2 * H; ++i) gates[i] = sigmoid(p[i] + recurrent[i]);
  for (int64_t i = 0; i < H; ++i) gates[2 * H + i] = hyperbolic_tangent(p[2 * H + i] + gates[i] * recurrent[2 * H + i]);
}

struct Shape {
  int64_t time, sequences, hidden;
};

template <int64_t kHidden>  // known to the compiler, or 0
void forward(Shape shape, const float* kernel, const float* bias, const float* projected, float* states) {
  const int64_t H = kHidden ? kHidden : shape.hidden, S = shape.sequences;
  std::vector<float> start(S * H, 0.0f), recurrent(S * 3 * H), gates(3 * H);
  const float* before = start.data();
  for (int64_t t = 0; t < shape.time; ++t) {
    recur(before, kernel, bias, S, H, recurrent.data());
    for (int64_t s = 0; s < S; ++s) {
      gate(projected + (t * S + s) * 3 * H, recurrent.data() + s * 3 * H, H, gates.data());
      const float *__restrict z = gates.data() + H, *__restrict n = gates.data() + 2 * H, *__restrict h = before + s * H;
      float* __restrict after = states + (t * S + s) * H;
      for (int64_t i = 0; i < H; ++i) after[i] = n[i] + z[i] * (h[i] - n[i]);
    }
    before = states + t * S * H;
  }
}

// Chunks of time from the last to the first: the gates of a chunk in one product, then its steps backwards.
template <int64_t kHidden>
void backward(Shape shape, const float* kernel, const float* bias, const float* projected, const float* states,
              const float* cotangent, float* d_kernel, float* d_bias, float* d_projected) {
  const int64_t H = kHidden ? kHidden : shape.hidden, S = shape.sequences;
  const int64_t chunk = std::max<int64_t>(1, kChunkRows / S), most = chunk * S;
  std::vector<float> transposed(3 * H * H), carry(S * H, 0.0f);
  std::vector<float> before(most * H), recurrent(most * 3 * H), gates(most * 3 * H), d_recurrent(most * 3 * H);
  for (int64_t i = 0; i < H; ++i)
    for (int64_t c = 0; c < 3 * H; ++c) transposed[c * H + i] = kernel[i * 3 * H + c];
  std::fill_n(d_kernel, 3 * H * H, 0.0f);
  std::fill_n(d_bias, 3 * H, 0.0f);
  for (int64_t end = shape.time; end > 0; end -= chunk) {
    const int64_t first = std::max<int64_t>(0, end - chunk), rows = (end - first) * S;
    const int64_t missing = first ? 0 : S;  // the state before the first step is zero
    std::fill_n(before.data(), missing * H, 0.0f);
    std::copy_n(states + (first * S - S + missing) * H, (rows - missing) * H, before.data() + missing * H);
    recur(before.data(), kernel, bias, rows, H, recurrent.data());
    for (int64_t s = 0; s < rows; ++s)
      gate(projected + (first * S + s) * 3 * H, recurrent.data() + s * 3 * H, H, gates.data() + s * 3 * H);
    for (int64_t t = end - first - 1; t >= 0; --t) {
      for (int64_t s = 0; s < S; ++s) {
        const int64_t row = t * S + s, at = first * S + row;
        const float *__restrict r = gates.data() + row * 3 * H, *__restrict z = r + H, *__restrict n = z + H;
        const float *__restrict h = before.data() + row * H, *__restrict rec_n = recurrent.data() + row * 3 * H + 2 * H;
        const float* __restrict outer = cotangent + at * H;
        float *__restrict to_carry = carry.data() + s * H, *__restrict d_p = d_projected + at * 3 * H;
        float* __restrict d_rec = d_recurrent.data() + row * 3 * H;
        for (int64_t i = 0; i < H; ++i) {
          const float d_h = to_carry[i] + outer[i];
          const float d_n = d_h * (1.0f - z[i]) * (1.0f - n[i] * n[i]);
          d_p[i] = d_rec[i] = d_n * rec_n[i] * r[i] * (1.0f - r[i]);
          d_p[H + i] = d_rec[H + i] = d_h * (h[i] - n[i]) * z[i] * (1.0f - z[i]);
          d_p[2 * H + i] = d_n;
          d_rec[2 * H + i] = d_n * r[i];
          to_carry[i] = z[i] * d_h;
        }
      }
      multiply_add({d_recurrent.data() + t * S * 3 * H, 3 * H, 1}, transposed.data(), S, 3 * H, H, carry.data());
    }
    multiply_add({before.data(), 1, H}, d_recurrent.data(), H, rows, 3 * H, d_kernel);
    for (int64_t s = 0; s < rows; ++s)
      for (int64_t c = 0; c < 3 * H; ++c) d_bias[c] += d_recurrent[s * 3 * H + c];
  }
}

using In = ffi::Buffer<ffi::F32>;
using Out = ffi::ResultBuffer<ffi::F32>;

// Calls one(shape, member) for every member of projected [.., T, S, 3H]. 16 and 64 are the published numbers of units.
template <typename One>
ffi::Error for_members(const In& projected, One one) {
  const auto dimensions = projected.dimensions();
  const size_t rank = dimensions.size();
  const Shape shape{dimensions[rank - 3], dimensions[rank - 2], dimensions[rank - 1] / 3};
  int64_t members = 1;
  for (size_t i = 0; i + 3 < rank; ++i) members *= dimensions[i];
  for (int64_t m = 0; m < members; ++m) one(shape, m);
  return ffi::Error::Success();
}

ffi::Error Forward(In kernel, In bias, In projected, Out states) {
  return for_members(projected, [&](Shape shape, int64_t m) {
    const int64_t H = shape.hidden, at = m * shape.time * shape.sequences * H;
    const auto pass = H == 16 ? forward<16> : H == 64 ? forward<64> : forward<0>;
    pass(shape, kernel.typed_data() + m * 3 * H * H, bias.typed_data() + m * 3 * H, projected.typed_data() + 3 * at,
         states->typed_data() + at);
  });
}

ffi::Error Backward(In kernel, In bias, In projected, In states, In cotangent, Out d_kernel, Out d_bias,
                    Out d_projected) {
  return for_members(projected, [&](Shape shape, int64_t m) {
    const int64_t H = shape.hidden, at = m * shape.time * shape.sequences * H;
    const auto pass = H == 16 ? backward<16> : H == 64 ? backward<64> : backward<0>;
    pass(shape, kernel.typed_data() + m * 3 * H * H, bias.typed_data() + m * 3 * H, projected.typed_data() + 3 * at,
         states.typed_data() + at, cotangent.typed_data() + at, d_kernel->typed_data() + m * 3 * H * H,
         d_bias->typed_data() + m * 3 * H, d_projected->typed_data() + 3 * at);
  });
}

}  // namespace

XLA_FFI_DEFINE_HANDLER_SYMBOL(pgrssnn_gru_forward, Forward,
                              ffi::Ffi::Bind().Arg<In>().Arg<In>().Arg<In>().Ret<In>());
XLA_FFI_DEFINE_HANDLER_SYMBOL(
    pgrssnn_gru_backward, Backward,
    ffi::Ffi::Bind().Arg<In>().Arg<In>().Arg<In>().Arg<In>().Arg<In>().Ret<In>().Ret<In>().Ret<In>());
