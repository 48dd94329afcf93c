// Forward dynamics of an arm of revolute joints, many samples at a time: one lane of every vector is one sample.
//
//   M(q) q'' + h(q, q') = tau      M from composite inertias, h by Newton-Euler, M = L^T D L by elimination from the tips
//
// Equations, frames and the order of the results as in physics/arms/chain.py, whose form is the reference: everything is
// written about the world's origin. q, v, tau, a [.., n, batch]; leading axes are one problem after another.
// Source: Featherstone, Rigid Body Dynamics Algorithms, 2008, chapters 5 and 6.

#include <array>

#include "small_products.h"
#include "xla/ffi/api/ffi.h"

#pragma GCC diagnostic ignored "-Wignored-attributes"  // std::array aligns its vectors, and that is right

namespace ffi = xla::ffi;
using small::kLanes;
using small::Vector;

namespace {

constexpr int kMost = 32;  // joints: the arrays of a block stand on the stack, 4 kB a joint
constexpr int kColumns = 23;
constexpr int kKept = 15;  // numbers of a link that the derivative needs: axis 6, first moment 3, second moment 6

// One row of the tables: placement of the joint in its parent's frame, and the body that moves with it.
struct Joint {
  float rotation[9], position[3], mass, center[3], inertia[6], armature;
};
static_assert(sizeof(Joint) == kColumns * sizeof(float));

using V3 = std::array<Vector, 3>;
using V6 = std::array<Vector, 6>;  // motion: angular, linear; force: moment, force

struct Inertia {
  Vector mass;
  V3 first;
  V6 second;  // xx, yy, zz, xy, xz, yz
};

inline V3 top(const V6& a) { return {a[0], a[1], a[2]}; }
inline V3 low(const V6& a) { return {a[3], a[4], a[5]}; }
inline V6 both(const V3& a, const V3& b) { return {a[0], a[1], a[2], b[0], b[1], b[2]}; }
inline V3 cross(const V3& a, const V3& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
inline Vector dot(const V3& a, const V3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
inline Vector dot(const V6& a, const V6& b) { return dot(top(a), top(b)) + dot(low(a), low(b)); }

template <size_t N>
inline std::array<Vector, N> operator+(std::array<Vector, N> a, const std::array<Vector, N>& b) {
  for (size_t i = 0; i < N; ++i) a[i] += b[i];
  return a;
}
template <size_t N, typename Scale>
inline std::array<Vector, N> scaled(const Scale& s, std::array<Vector, N> a) {
  for (size_t i = 0; i < N; ++i) a[i] = s * a[i];
  return a;
}

inline V6 motion_cross(const V6& a, const V6& b) {
  return both(cross(top(a), top(b)), cross(top(a), low(b)) + cross(low(a), top(b)));
}
inline V6 force_cross(const V6& a, const V6& f) {
  return both(cross(top(a), top(f)) + cross(low(a), low(f)), cross(top(a), low(f)));
}
inline V6 momentum(const Inertia& body, const V6& a) {
  const V6& s = body.second;
  const V3 turned = {s[0] * a[0] + s[3] * a[1] + s[4] * a[2], s[3] * a[0] + s[1] * a[1] + s[5] * a[2],
                     s[4] * a[0] + s[5] * a[1] + s[2] * a[2]};
  return both(turned + cross(body.first, low(a)), scaled(body.mass, low(a)) + cross(top(a), body.first));
}

// sin and cos to 1e-7 for |x| below 8000. Source: Cephes library, sinf and cosf.
inline void sine_cosine(const Vector& x, Vector& sine, Vector& cosine) {
  for (int64_t i = 0; i < kLanes; ++i) {
    const float k = __builtin_floorf(x[i] * 0.636619772f + 0.5f);
    const float r = ((x[i] - k * 1.5703125f) - k * 4.837512969970703125e-4f) - k * 7.549789948768648e-8f;
    const float z = r * r;
    const float s = ((-1.9515295891e-4f * z + 8.3321608736e-3f) * z - 1.6666654611e-1f) * z * r + r;
    const float c = ((2.443315711809948e-5f * z - 1.388731625493765e-3f) * z + 4.166664568298827e-2f) * z * z -
                    0.5f * z + 1.0f;
    const float whole = k > -1e9f && k < 1e9f ? k : 0.0f;  // NaN and infinity have no whole number
    const int32_t quarter = static_cast<int32_t>(whole) & 3;
    const float a = quarter & 1 ? c : s, b = quarter & 1 ? s : c;
    sine[i] = quarter & 2 ? -a : a;
    cosine[i] = (quarter == 1 || quarter == 2) ? -b : b;
  }
}

struct Arm {
  const Joint* joints;
  const int32_t* parents;
  const float* gravity;
  int n, pairs;  // pairs: of a joint and another one between it and the base
};

// Where a joint's frame is in the world.
struct Frame {
  std::array<V3, 3> columns;  // of its rotation
  V3 origin;
};

// up: the parent's frame; null for the base
Frame placed(const Joint& joint, const Frame* up, const Vector& q) {
  Frame frame;
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      const float* fixed = joint.rotation + column;
      frame.columns[column][row] = up ? up->columns[0][row] * fixed[0] + up->columns[1][row] * fixed[3] +
                                            up->columns[2][row] * fixed[6]
                                      : Vector{} + fixed[3 * row];
    }
    frame.origin[row] = up ? up->origin[row] + up->columns[0][row] * joint.position[0] +
                                 up->columns[1][row] * joint.position[1] + up->columns[2][row] * joint.position[2]
                           : Vector{} + joint.position[row];
  }
  Vector sine, cosine;
  sine_cosine(q, sine, cosine);
  const V3 x = frame.columns[0], y = frame.columns[1];
  frame.columns[0] = scaled(cosine, x) + scaled(sine, y);
  frame.columns[1] = scaled(cosine, y) + scaled(-sine, x);
  return frame;
}

// The body that moves with a joint, about the world's origin.
Inertia body_of(const Joint& joint, const Frame& frame) {
  const auto& [x, y, z] = frame.columns;
  const V3 center =
      frame.origin + scaled(joint.center[0], x) + scaled(joint.center[1], y) + scaled(joint.center[2], z);
  const V3 first = scaled(joint.mass, center);
  const float* s = joint.inertia;
  const V3 half[3] = {scaled(s[0], x) + scaled(s[3], y) + scaled(s[4], z),
                      scaled(s[3], x) + scaled(s[1], y) + scaled(s[5], z),
                      scaled(s[4], x) + scaled(s[5], y) + scaled(s[2], z)};
  const Vector away = dot(first, center);
  constexpr int rows[6] = {0, 1, 2, 0, 0, 1}, columns[6] = {0, 1, 2, 1, 2, 2};
  V6 second;
  for (int k = 0; k < 6; ++k) {
    const int r = rows[k], c = columns[k];
    second[k] = half[0][r] * x[c] + half[1][r] * y[c] + half[2][r] * z[c] - first[r] * center[c];
    if (r == c) second[k] += away;
  }
  return {Vector{} + joint.mass, first, second};
}

using Matrix = Vector[kMost][kMost];

// M a = b: a is b before, the solution after; M_jk, j between k and the base, in `upper` becomes L_kj. factor: where
// they are wanted L_kj of every k from the tips to the base, then 1 / D.
void solve(const Arm& arm, Matrix& upper, Vector* a, Vector* factor) {
  Vector inverse[kMost];
  int row = 0;
  for (int k = arm.n - 1; k >= 0; --k) {
    inverse[k] = 1.0f / upper[k][k];
    for (int i = arm.parents[k]; i >= 0; i = arm.parents[i]) {
      const Vector share = upper[i][k] * inverse[k];
      for (int j = i; j >= 0; j = arm.parents[j]) upper[j][i] -= share * upper[j][k];
      a[i] -= share * a[k];
    }
    for (int j = arm.parents[k]; j >= 0; j = arm.parents[j]) {
      upper[j][k] *= inverse[k];
      if (factor) factor[row++] = upper[j][k];
    }
  }
  for (int k = 0; k < arm.n; ++k) {
    a[k] *= inverse[k];
    if (factor) factor[arm.pairs + k] = inverse[k];
  }
  for (int k = 0; k < arm.n; ++k)
    for (int j = arm.parents[k]; j >= 0; j = arm.parents[j]) a[k] -= upper[j][k] * a[j];
}

// One block: q, v, tau and the acceleration a [n]; factor [pairs + n] and kept [kKept, n] where they are wanted.
void block(const Arm& arm, const Vector* q, const Vector* v, const Vector* tau, Vector* a, Vector* factor, Vector* kept) {
  const int n = arm.n;
  Frame frame[kMost];
  V6 axis[kMost], velocity[kMost], acceleration[kMost], force[kMost];
  Inertia carried[kMost];
  const float* g = arm.gravity;  // a base that accelerates against gravity gives every link its weight
  const V6 base = {Vector{}, Vector{}, Vector{}, Vector{} - g[0], Vector{} - g[1], Vector{} - g[2]};
  for (int i = 0; i < n; ++i) {
    const int parent = arm.parents[i];
    frame[i] = placed(arm.joints[i], parent < 0 ? nullptr : &frame[parent], q[i]);
    axis[i] = both(frame[i].columns[2], cross(frame[i].origin, frame[i].columns[2]));
    carried[i] = body_of(arm.joints[i], frame[i]);
    const V6 own = scaled(v[i], axis[i]);
    velocity[i] = parent < 0 ? own : velocity[parent] + own;
    acceleration[i] = (parent < 0 ? base : acceleration[parent]) + motion_cross(velocity[i], own);
    force[i] = momentum(carried[i], acceleration[i]) + force_cross(velocity[i], momentum(carried[i], velocity[i]));
    if (kept) {
      for (int k = 0; k < 6; ++k) kept[k * n + i] = axis[i][k];
      for (int k = 0; k < 3; ++k) kept[(6 + k) * n + i] = carried[i].first[k];
      for (int k = 0; k < 6; ++k) kept[(9 + k) * n + i] = carried[i].second[k];
    }
  }
  Matrix upper;  // M_jk for j between k and the base
  for (int k = n - 1; k >= 0; --k) {
    const V6 turning = momentum(carried[k], axis[k]);
    upper[k][k] = dot(axis[k], turning) + arm.joints[k].armature;
    for (int j = arm.parents[k]; j >= 0; j = arm.parents[j]) upper[j][k] = dot(axis[j], turning);
    a[k] = tau[k] - dot(axis[k], force[k]);
    const int parent = arm.parents[k];
    if (parent >= 0) {
      force[parent] = force[parent] + force[k];
      carried[parent] = {carried[parent].mass + carried[k].mass, carried[parent].first + carried[k].first,
                         carried[parent].second + carried[k].second};
    }
  }
  solve(arm, upper, a, factor);
}

// rows [n, batch] of lanes first .. first + count; what is beyond the batch reads as zero and is not written
void load(const float* at, int rows, int64_t batch, int64_t first, int64_t count, Vector* lanes) {
  for (int i = 0; i < rows; ++i) {
    lanes[i] = Vector{};
    std::memcpy(&lanes[i], at + i * batch + first, count * sizeof(float));
  }
}
void store(const Vector* lanes, int rows, int64_t batch, int64_t first, int64_t count, float* at) {
  for (int i = 0; i < rows; ++i) std::memcpy(at + i * batch + first, &lanes[i], count * sizeof(float));
}

using In = ffi::Buffer<ffi::F32>;
using Out = ffi::ResultBuffer<ffi::F32>;

ffi::Error Accelerations(In q, In v, In tau, ffi::Span<const float> tables, ffi::Span<const int32_t> parents,
                         ffi::Span<const float> gravity, Out a, float* factor, float* kept) {
  Arm arm{reinterpret_cast<const Joint*>(tables.begin()), parents.begin(), gravity.begin(),
          static_cast<int>(parents.size()), 0};
  if (arm.n > kMost || tables.size() != parents.size() * kColumns || gravity.size() != 3)
    return ffi::Error::InvalidArgument("arm: expected at most 32 joints with 23 numbers each, and gravity");
  for (int k = 0; k < arm.n; ++k)
    for (int j = arm.parents[k]; j >= 0; j = arm.parents[j]) ++arm.pairs;
  const auto dimensions = q.dimensions();
  const int n = arm.n, factors = arm.pairs + n;
  const int64_t batch = dimensions.back(), problems = batch ? q.element_count() / (n * batch) : 0;
  Vector lanes[4 * kMost], found[kMost * kMost], more[kKept * kMost];
  for (int64_t m = 0; m < problems; ++m)
    for (int64_t first = 0; first < batch; first += kLanes) {
      const int64_t count = std::min(kLanes, batch - first), at = m * n * batch;
      load(q.typed_data() + at, n, batch, first, count, lanes);
      load(v.typed_data() + at, n, batch, first, count, lanes + n);
      load(tau.typed_data() + at, n, batch, first, count, lanes + 2 * n);
      block(arm, lanes, lanes + n, lanes + 2 * n, lanes + 3 * n, factor ? found : nullptr, kept ? more : nullptr);
      store(lanes + 3 * n, n, batch, first, count, a->typed_data() + at);
      if (factor) store(found, factors, batch, first, count, factor + m * factors * batch);
      if (kept) store(more, kKept * n, batch, first, count, kept + m * kKept * n * batch);
    }
  return ffi::Error::Success();
}

ffi::Error Alone(In q, In v, In tau, ffi::Span<const float> tables, ffi::Span<const int32_t> parents,
                 ffi::Span<const float> gravity, Out a) {
  return Accelerations(q, v, tau, tables, parents, gravity, a, nullptr, nullptr);
}

ffi::Error WithFactors(In q, In v, In tau, ffi::Span<const float> tables, ffi::Span<const int32_t> parents,
                       ffi::Span<const float> gravity, Out a, Out factor, Out kept) {
  return Accelerations(q, v, tau, tables, parents, gravity, a, factor->typed_data(), kept->typed_data());
}

auto arguments() {
  return ffi::Ffi::Bind()
      .Arg<In>().Arg<In>().Arg<In>()
      .Attr<ffi::Span<const float>>("tables")
      .Attr<ffi::Span<const int32_t>>("parents")
      .Attr<ffi::Span<const float>>("gravity");
}

}  // namespace

XLA_FFI_DEFINE_HANDLER_SYMBOL(pgrssnn_arm, Alone, arguments().Ret<In>());
XLA_FFI_DEFINE_HANDLER_SYMBOL(pgrssnn_arm_factors, WithFactors, arguments().Ret<In>().Ret<In>().Ret<In>());
