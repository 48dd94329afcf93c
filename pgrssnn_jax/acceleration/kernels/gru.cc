// The recurrence of a gated recurrent unit and its gradient, members one after another.
//
//   r = s(p_r + W_hr h + b_hr)    z = s(p_z + W_hz h + b_hz)    n = tanh(p_n + r (W_hn h + b_hn))    h+ = (1 - z) n + z h
//
// Equations and order of gates as in models/gru.py, whose scan is the reference. Dense row-major float32 arrays:
// kernel [.., H, 3H], bias [.., 3H], projected [.., T, S, 3H], start [.., S, H], states [.., T, S, H]; leading axes are
// members.
// The forward pass keeps the states alone: to compute the gates again costs less than to write them to memory.

#include <vector>

#include "small_products.h"
#include "xla/ffi/api/ffi.h"

namespace ffi = xla::ffi;
using namespace small;

namespace {

// r, z and n of one row from its projected input p and its recurrent part
inline void gate(const float* __restrict p, const float* __restrict recurrent, int64_t H, float* __restrict gates) {
  for (int64_t i = 0; i < 2 * H; ++i) gates[i] = sigmoid(p[i] + recurrent[i]);
  for (int64_t i = 0; i < H; ++i) gates[2 * H + i] = hyperbolic_tangent(p[2 * H + i] + gates[i] * recurrent[2 * H + i]);
}

struct Shape {
  int64_t time, sequences, hidden;
};

template <int64_t kHidden>  // known to the compiler, or 0
void forward(Shape shape, const float* kernel, const float* bias, const float* projected, const float* start,
             float* states) {
  const int64_t H = kHidden ? kHidden : shape.hidden, S = shape.sequences;
  std::vector<float> recurrent(S * 3 * H), gates(3 * H);
  const float* before = start;
  for (int64_t t = 0; t < shape.time; ++t) {
    affine({before, H, 1}, kernel, bias, S, H, 3 * H, recurrent.data());
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
void backward(Shape shape, const float* kernel, const float* bias, const float* projected, const float* start,
              const float* states, const float* cotangent, float* d_kernel, float* d_bias, float* d_projected,
              float* d_start) {
  const int64_t H = kHidden ? kHidden : shape.hidden, S = shape.sequences;
  const int64_t chunk = std::max<int64_t>(1, kChunkRows / std::max<int64_t>(1, S)), most = chunk * S;
  std::vector<float> transposed(3 * H * H);
  std::vector<float> before(most * H), recurrent(most * 3 * H), gates(most * 3 * H), d_recurrent(most * 3 * H);
  transpose(kernel, H, 3 * H, transposed.data());
  std::fill_n(d_kernel, 3 * H * H, 0.0f);
  std::fill_n(d_bias, 3 * H, 0.0f);
  std::fill_n(d_start, S * H, 0.0f);  // the derivative with respect to the state that a step begins with
  for (int64_t end = shape.time; end > 0; end -= chunk) {
    const int64_t first = std::max<int64_t>(0, end - chunk), rows = (end - first) * S;
    const int64_t outside = first ? 0 : S;  // rows whose state before is the start
    std::copy_n(start, outside * H, before.data());
    std::copy_n(states + (first * S - S + outside) * H, (rows - outside) * H, before.data() + outside * H);
    affine({before.data(), H, 1}, kernel, bias, rows, H, 3 * H, recurrent.data());
    for (int64_t s = 0; s < rows; ++s)
      gate(projected + (first * S + s) * 3 * H, recurrent.data() + s * 3 * H, H, gates.data() + s * 3 * H);
    for (int64_t t = end - first - 1; t >= 0; --t) {
      for (int64_t s = 0; s < S; ++s) {
        const int64_t row = t * S + s, at = first * S + row;
        const float *__restrict r = gates.data() + row * 3 * H, *__restrict z = r + H, *__restrict n = z + H;
        const float *__restrict h = before.data() + row * H, *__restrict rec_n = recurrent.data() + row * 3 * H + 2 * H;
        const float* __restrict outer = cotangent + at * H;
        float *__restrict carry = d_start + s * H, *__restrict d_p = d_projected + at * 3 * H;
        float* __restrict d_rec = d_recurrent.data() + row * 3 * H;
        for (int64_t i = 0; i < H; ++i) {
          const float d_h = carry[i] + outer[i];
          const float d_n = d_h * (1.0f - z[i]) * (1.0f - n[i] * n[i]);
          d_p[i] = d_rec[i] = d_n * rec_n[i] * r[i] * (1.0f - r[i]);
          d_p[H + i] = d_rec[H + i] = d_h * (h[i] - n[i]) * z[i] * (1.0f - z[i]);
          d_p[2 * H + i] = d_n;
          d_rec[2 * H + i] = d_n * r[i];
          carry[i] = z[i] * d_h;
        }
      }
      multiply_add({d_recurrent.data() + t * S * 3 * H, 3 * H, 1}, transposed.data(), S, 3 * H, H, d_start);
    }
    multiply_add({before.data(), 1, H}, d_recurrent.data(), H, rows, 3 * H, d_kernel);
    add_rows(d_recurrent.data(), rows, 3 * H, d_bias);
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

ffi::Error Forward(In kernel, In bias, In projected, In start, Out states) {
  return for_members(projected, [&](Shape shape, int64_t m) {
    const int64_t H = shape.hidden, at = m * shape.time * shape.sequences * H;
    const auto pass = H == 16 ? forward<16> : H == 64 ? forward<64> : forward<0>;
    pass(shape, kernel.typed_data() + m * 3 * H * H, bias.typed_data() + m * 3 * H, projected.typed_data() + 3 * at,
         start.typed_data() + m * shape.sequences * H, states->typed_data() + at);
  });
}

ffi::Error Backward(In kernel, In bias, In projected, In start, In states, In cotangent, Out d_kernel, Out d_bias,
                    Out d_projected, Out d_start) {
  return for_members(projected, [&](Shape shape, int64_t m) {
    const int64_t H = shape.hidden, at = m * shape.time * shape.sequences * H;
    const auto pass = H == 16 ? backward<16> : H == 64 ? backward<64> : backward<0>;
    pass(shape, kernel.typed_data() + m * 3 * H * H, bias.typed_data() + m * 3 * H, projected.typed_data() + 3 * at,
         start.typed_data() + m * shape.sequences * H, states.typed_data() + at, cotangent.typed_data() + at,
         d_kernel->typed_data() + m * 3 * H * H, d_bias->typed_data() + m * 3 * H, d_projected->typed_data() + 3 * at,
         d_start->typed_data() + m * shape.sequences * H);
  });
}

}  // namespace

XLA_FFI_DEFINE_HANDLER_SYMBOL(pgrssnn_gru_forward, Forward,
                              ffi::Ffi::Bind().Arg<In>().Arg<In>().Arg<In>().Arg<In>().Ret<In>());
XLA_FFI_DEFINE_HANDLER_SYMBOL(pgrssnn_gru_backward, Backward,
                              ffi::Ffi::Bind()
                                  .Arg<In>().Arg<In>().Arg<In>().Arg<In>().Arg<In>().Arg<In>()
                                  .Ret<In>().Ret<In>().Ret<In>().Ret<In>());
