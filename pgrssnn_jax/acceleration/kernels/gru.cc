// A layer of gated recurrent units and its gradient, members one after another.
//
//   p = W_i phi + b_i
//   r = s(p_r + W_hr h + b_hr)    z = s(p_z + W_hz h + b_hz)    n = tanh(p_n + r (W_hn h + b_hn))    h+ = (1 - z) n + z h
//
// Equations and order of gates as in models/gru.py, whose scan is the reference. Dense row-major float32 arrays:
// W_i [.., n_in, 3H], b_i [.., 3H], W_h [.., H, 3H], b_h [.., 3H], phi [.., T, S, n_in], start [.., S, H],
// states [.., T, S, H]; leading axes are members.
// The forward pass keeps the states alone: to compute projections and gates again costs less than to write them to
// memory. Time is taken in chunks whose projections stay in the cache.

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
  int64_t time, sequences, n_in, hidden;
  int64_t chunk() const { return std::max<int64_t>(1, kChunkRows / std::max<int64_t>(1, sequences)); }
};

struct Weights {  // of one member; or their derivatives
  float *input, *input_bias, *hidden, *hidden_bias;
};

template <int64_t kHidden>  // known to the compiler, or 0
void forward(Shape shape, Weights w, const float* phi, const float* start, float* states) {
  const int64_t H = kHidden ? kHidden : shape.hidden, S = shape.sequences, chunk = shape.chunk();
  std::vector<float> projected(chunk * S * 3 * H), recurrent(S * 3 * H), gates(3 * H);
  const float* before = start;
  for (int64_t first = 0; first < shape.time; first += chunk) {
    const int64_t steps = std::min(chunk, shape.time - first);
    affine({phi + first * S * shape.n_in, shape.n_in, 1}, w.input, w.input_bias, steps * S, shape.n_in, 3 * H,
           projected.data());
    for (int64_t t = 0; t < steps; ++t) {
      float* after = states + (first + t) * S * H;
      affine({before, H, 1}, w.hidden, w.hidden_bias, S, H, 3 * H, recurrent.data());
      for (int64_t s = 0; s < S; ++s) {
        gate(projected.data() + (t * S + s) * 3 * H, recurrent.data() + s * 3 * H, H, gates.data());
        const float *__restrict z = gates.data() + H, *__restrict n = z + H, *__restrict h = before + s * H;
        float* __restrict next = after + s * H;
        for (int64_t i = 0; i < H; ++i) next[i] = n[i] + z[i] * (h[i] - n[i]);
      }
      before = after;
    }
  }
}

// Chunks of time from the last to the first: the gates of a chunk in two products, then its steps backwards.
template <int64_t kHidden>
void backward(Shape shape, Weights w, const float* phi, const float* start, const float* states, const float* cotangent,
              Weights d, float* d_phi, float* d_start) {
  const int64_t H = kHidden ? kHidden : shape.hidden, S = shape.sequences, N = shape.n_in;
  const int64_t chunk = shape.chunk(), most = chunk * S;
  std::vector<float> input_transposed(3 * H * N), transposed(3 * H * H), none(N);
  std::vector<float> before(most * H), projected(most * 3 * H), recurrent(most * 3 * H), gates(most * 3 * H);
  std::vector<float> d_projected(most * 3 * H), d_recurrent(most * 3 * H);
  transpose(w.input, N, 3 * H, input_transposed.data());
  transpose(w.hidden, H, 3 * H, transposed.data());
  std::fill_n(d.input, 3 * H * N, 0.0f);
  std::fill_n(d.input_bias, 3 * H, 0.0f);
  std::fill_n(d.hidden, 3 * H * H, 0.0f);
  std::fill_n(d.hidden_bias, 3 * H, 0.0f);
  std::fill_n(d_start, S * H, 0.0f);  // the derivative with respect to the state that a step begins with
  for (int64_t end = shape.time; end > 0; end -= chunk) {
    const int64_t first = std::max<int64_t>(0, end - chunk), rows = (end - first) * S;
    const int64_t outside = first ? 0 : S;  // rows whose state before is the start
    const Matrix inputs{phi + first * S * N, N, 1};
    std::copy_n(start, outside * H, before.data());
    std::copy_n(states + (first * S - S + outside) * H, (rows - outside) * H, before.data() + outside * H);
    affine(inputs, w.input, w.input_bias, rows, N, 3 * H, projected.data());
    affine({before.data(), H, 1}, w.hidden, w.hidden_bias, rows, H, 3 * H, recurrent.data());
    for (int64_t s = 0; s < rows; ++s)
      gate(projected.data() + s * 3 * H, recurrent.data() + s * 3 * H, H, gates.data() + s * 3 * H);
    for (int64_t t = end - first - 1; t >= 0; --t) {
      for (int64_t s = 0; s < S; ++s) {
        const int64_t row = t * S + s;
        const float *__restrict r = gates.data() + row * 3 * H, *__restrict z = r + H, *__restrict n = z + H;
        const float *__restrict h = before.data() + row * H, *__restrict rec_n = recurrent.data() + row * 3 * H + 2 * H;
        const float* __restrict outer = cotangent + (first * S + row) * H;
        float *__restrict carry = d_start + s * H, *__restrict d_p = d_projected.data() + row * 3 * H;
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
    multiply_add({before.data(), 1, H}, d_recurrent.data(), H, rows, 3 * H, d.hidden);
    add_rows(d_recurrent.data(), rows, 3 * H, d.hidden_bias);
    multiply_add({inputs.at, 1, N}, d_projected.data(), N, rows, 3 * H, d.input);
    add_rows(d_projected.data(), rows, 3 * H, d.input_bias);
    affine({d_projected.data(), 3 * H, 1}, input_transposed.data(), none.data(), rows, 3 * H, N, d_phi + first * S * N);
  }
}

using In = ffi::Buffer<ffi::F32>;
using Out = ffi::ResultBuffer<ffi::F32>;

// Calls one(shape, member) for every member of phi [.., T, S, n_in] and start [.., S, H].
template <typename One>
ffi::Error for_members(const In& phi, const In& start, One one) {
  const auto dimensions = phi.dimensions();
  const size_t rank = dimensions.size();
  const Shape shape{dimensions[rank - 3], dimensions[rank - 2], dimensions[rank - 1], start.dimensions().back()};
  int64_t members = 1;
  for (size_t i = 0; i + 3 < rank; ++i) members *= dimensions[i];
  for (int64_t m = 0; m < members; ++m) one(shape, m);
  return ffi::Error::Success();
}

Weights weights_of(Shape shape, int64_t m, float* input, float* input_bias, float* hidden, float* hidden_bias) {
  const int64_t gates = 3 * shape.hidden;
  return {input + m * shape.n_in * gates, input_bias + m * gates, hidden + m * shape.hidden * gates,
          hidden_bias + m * gates};
}

// 16 and 64 are the published numbers of units.
ffi::Error Forward(In input, In input_bias, In hidden, In hidden_bias, In phi, In start, Out states) {
  return for_members(phi, start, [&](Shape shape, int64_t m) {
    const int64_t H = shape.hidden, rows = shape.time * shape.sequences;
    const auto pass = H == 16 ? forward<16> : H == 64 ? forward<64> : forward<0>;
    const Weights w = weights_of(shape, m, input.typed_data(), input_bias.typed_data(), hidden.typed_data(),
                                 hidden_bias.typed_data());
    pass(shape, w, phi.typed_data() + m * rows * shape.n_in, start.typed_data() + m * shape.sequences * H,
         states->typed_data() + m * rows * H);
  });
}

ffi::Error Backward(In input, In input_bias, In hidden, In hidden_bias, In phi, In start, In states, In cotangent,
                    Out d_input, Out d_input_bias, Out d_hidden, Out d_hidden_bias, Out d_phi, Out d_start) {
  return for_members(phi, start, [&](Shape shape, int64_t m) {
    const int64_t H = shape.hidden, rows = shape.time * shape.sequences, first = m * shape.sequences * H;
    const auto pass = H == 16 ? backward<16> : H == 64 ? backward<64> : backward<0>;
    const Weights w = weights_of(shape, m, input.typed_data(), input_bias.typed_data(), hidden.typed_data(),
                                 hidden_bias.typed_data());
    const Weights d = weights_of(shape, m, d_input->typed_data(), d_input_bias->typed_data(), d_hidden->typed_data(),
                                 d_hidden_bias->typed_data());
    pass(shape, w, phi.typed_data() + m * rows * shape.n_in, start.typed_data() + first, states.typed_data() + m * rows * H,
         cotangent.typed_data() + m * rows * H, d, d_phi->typed_data() + m * rows * shape.n_in,
         d_start->typed_data() + first);
  });
}

}  // namespace

XLA_FFI_DEFINE_HANDLER_SYMBOL(pgrssnn_gru_forward, Forward,
                              ffi::Ffi::Bind()
                                  .Arg<In>().Arg<In>().Arg<In>().Arg<In>().Arg<In>().Arg<In>()
                                  .Ret<In>());
XLA_FFI_DEFINE_HANDLER_SYMBOL(pgrssnn_gru_backward, Backward,
                              ffi::Ffi::Bind()
                                  .Arg<In>().Arg<In>().Arg<In>().Arg<In>().Arg<In>().Arg<In>().Arg<In>().Arg<In>()
                                  .Ret<In>().Ret<In>().Ret<In>().Ret<In>().Ret<In>().Ret<In>());
