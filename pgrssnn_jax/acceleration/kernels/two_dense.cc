// Two dense layers with an activation between them, and their gradient, members one after another.
//
//   y = W2 act(W1 z + b1) + b2          act: relu or the logistic function
//
// As in models/networks.py, whose form is the reference. Dense row-major float32 arrays: W1 [.., n_in, H],
// b1 [.., H], W2 [.., H, n_out], b2 [.., n_out], z [.., rows, n_in]; leading axes are members. Rows are taken in chunks
// that stay in the cache; nothing but z is kept for the gradient.

#include <vector>

#include "small_products.h"
#include "xla/ffi/api/ffi.h"

namespace ffi = xla::ffi;
using namespace small;

namespace {

struct Shape {
  int64_t rows, n_in, hidden, n_out;
};

inline void activate(bool relu, int64_t count, float* a) {
  if (relu)
    for (int64_t i = 0; i < count; ++i) a[i] = a[i] < 0.0f ? 0.0f : a[i];  // NaN stays NaN
  else
    for (int64_t i = 0; i < count; ++i) a[i] = sigmoid(a[i]);
}

// d *= act'(.), from the values of act
inline void through_activation(bool relu, int64_t count, const float* __restrict a, float* __restrict d) {
  if (relu)
    for (int64_t i = 0; i < count; ++i) d[i] = a[i] > 0.0f ? d[i] : 0.0f;
  else
    for (int64_t i = 0; i < count; ++i) d[i] *= a[i] * (1.0f - a[i]);
}

void forward(Shape n, bool relu, const float* w1, const float* b1, const float* w2, const float* b2, const float* z,
             float* y) {
  std::vector<float> hidden(kChunkRows * n.hidden);
  for (int64_t first = 0; first < n.rows; first += kChunkRows) {
    const int64_t rows = std::min(kChunkRows, n.rows - first);
    affine({z + first * n.n_in, n.n_in, 1}, w1, b1, rows, n.n_in, n.hidden, hidden.data());
    activate(relu, rows * n.hidden, hidden.data());
    affine({hidden.data(), n.hidden, 1}, w2, b2, rows, n.hidden, n.n_out, y + first * n.n_out);
  }
}

void backward(Shape n, bool relu, const float* w1, const float* b1, const float* w2, const float* z, const float* d_y,
              float* d_w1, float* d_b1, float* d_w2, float* d_b2, float* d_z) {
  std::vector<float> hidden(kChunkRows * n.hidden), d_hidden(kChunkRows * n.hidden);
  std::vector<float> w1_transposed(n.n_in * n.hidden), w2_transposed(n.hidden * n.n_out);
  transpose(w1, n.n_in, n.hidden, w1_transposed.data());
  transpose(w2, n.hidden, n.n_out, w2_transposed.data());
  std::fill_n(d_w1, n.n_in * n.hidden, 0.0f);
  std::fill_n(d_b1, n.hidden, 0.0f);
  std::fill_n(d_w2, n.hidden * n.n_out, 0.0f);
  std::fill_n(d_b2, n.n_out, 0.0f);
  std::fill_n(d_z, n.rows * n.n_in, 0.0f);
  for (int64_t first = 0; first < n.rows; first += kChunkRows) {
    const int64_t rows = std::min(kChunkRows, n.rows - first);
    const float *z_c = z + first * n.n_in, *d_y_c = d_y + first * n.n_out;
    affine({z_c, n.n_in, 1}, w1, b1, rows, n.n_in, n.hidden, hidden.data());
    activate(relu, rows * n.hidden, hidden.data());
    multiply_add({hidden.data(), 1, n.hidden}, d_y_c, n.hidden, rows, n.n_out, d_w2);
    add_rows(d_y_c, rows, n.n_out, d_b2);
    std::fill_n(d_hidden.data(), rows * n.hidden, 0.0f);
    multiply_add({d_y_c, n.n_out, 1}, w2_transposed.data(), rows, n.n_out, n.hidden, d_hidden.data());
    through_activation(relu, rows * n.hidden, hidden.data(), d_hidden.data());
    multiply_add({z_c, 1, n.n_in}, d_hidden.data(), n.n_in, rows, n.hidden, d_w1);
    add_rows(d_hidden.data(), rows, n.hidden, d_b1);
    multiply_add({d_hidden.data(), n.hidden, 1}, w1_transposed.data(), rows, n.hidden, n.n_in, d_z + first * n.n_in);
  }
}

using In = ffi::Buffer<ffi::F32>;
using Out = ffi::ResultBuffer<ffi::F32>;

// Calls one(shape, member) for every member of w1 [.., n_in, H], w2 [.., H, n_out] and z [.., rows, n_in].
template <typename One>
ffi::Error for_members(const In& w1, const In& w2, const In& z, One one) {
  const auto first = w1.dimensions(), second = w2.dimensions(), signal = z.dimensions();
  const size_t rank = signal.size();
  const Shape shape{signal[rank - 2], signal[rank - 1], first[rank - 1], second[rank - 1]};
  int64_t members = 1;
  for (size_t i = 0; i + 2 < rank; ++i) members *= signal[i];
  for (int64_t m = 0; m < members; ++m) one(shape, m);
  return ffi::Error::Success();
}

ffi::Error Forward(bool relu, In w1, In b1, In w2, In b2, In z, Out y) {
  return for_members(w1, w2, z, [&](Shape n, int64_t m) {
    forward(n, relu, w1.typed_data() + m * n.n_in * n.hidden, b1.typed_data() + m * n.hidden,
            w2.typed_data() + m * n.hidden * n.n_out, b2.typed_data() + m * n.n_out,
            z.typed_data() + m * n.rows * n.n_in, y->typed_data() + m * n.rows * n.n_out);
  });
}

ffi::Error Backward(bool relu, In w1, In b1, In w2, In z, In d_y, Out d_w1, Out d_b1, Out d_w2, Out d_b2, Out d_z) {
  return for_members(w1, w2, z, [&](Shape n, int64_t m) {
    const int64_t first = m * n.n_in * n.hidden, second = m * n.hidden * n.n_out, signal = m * n.rows * n.n_in;
    backward(n, relu, w1.typed_data() + first, b1.typed_data() + m * n.hidden, w2.typed_data() + second,
             z.typed_data() + signal, d_y.typed_data() + m * n.rows * n.n_out, d_w1->typed_data() + first,
             d_b1->typed_data() + m * n.hidden, d_w2->typed_data() + second, d_b2->typed_data() + m * n.n_out,
             d_z->typed_data() + signal);
  });
}

}  // namespace

XLA_FFI_DEFINE_HANDLER_SYMBOL(
    pgrssnn_two_dense_forward, Forward,
    ffi::Ffi::Bind().Attr<bool>("relu").Arg<In>().Arg<In>().Arg<In>().Arg<In>().Arg<In>().Ret<In>());
XLA_FFI_DEFINE_HANDLER_SYMBOL(pgrssnn_two_dense_backward, Backward,
                              ffi::Ffi::Bind()
                                  .Attr<bool>("relu")
                                  .Arg<In>()
                                  .Arg<In>()
                                  .Arg<In>()
                                  .Arg<In>()
                                  .Arg<In>()
                                  .Ret<In>()
                                  .Ret<In>()
                                  .Ret<In>()
                                  .Ret<In>()
                                  .Ret<In>());
