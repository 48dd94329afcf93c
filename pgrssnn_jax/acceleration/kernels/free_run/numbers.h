// Operations of acceleration/scalars.py on a vector of lanes, in double precision. NaN stays NaN, as in JAX.

#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

#ifdef __AVX512F__
constexpr int64_t kLanes = 8;
#else
constexpr int64_t kLanes = 4;
#endif
typedef double Vector __attribute__((vector_size(kLanes * 8)));
typedef decltype(Vector{} < Vector{}) Mask;

inline Vector splat(double a) { return Vector{} + a; }
const Mask kTrue = Vector{} == Vector{}, kFalse = Vector{} != Vector{};

#define OF_ONE(name) \
  inline Vector name(Vector a) { \
    for (int64_t i = 0; i < kLanes; ++i) a[i] = std::name(a[i]); \
    return a; \
  }
#define OF_TWO(name) \
  inline Vector name(Vector a, Vector b) { \
    for (int64_t i = 0; i < kLanes; ++i) a[i] = std::name(a[i], b[i]); \
    return a; \
  }
OF_ONE(acos) OF_ONE(acosh) OF_ONE(asin) OF_ONE(asinh) OF_ONE(atan) OF_ONE(atanh) OF_ONE(cbrt) OF_ONE(ceil) OF_ONE(cosh)
OF_ONE(erf) OF_ONE(erfc) OF_ONE(exp2) OF_ONE(expm1) OF_ONE(floor) OF_ONE(log1p) OF_ONE(rint) OF_ONE(round) OF_ONE(sinh)
OF_ONE(sqrt) OF_ONE(tan) OF_ONE(tanh) OF_TWO(atan2) OF_TWO(fmod)

// The vector functions of glibc take all lanes at once, to 4 units in the last place.
#if defined(__GLIBC__) && defined(__x86_64__) && defined(__AVX2__)
#if __GLIBC_PREREQ(2, 22)
#ifdef __AVX512F__
#define OF_GLIBC(kind, name) _ZGVeN8##kind##_##name
#else
#define OF_GLIBC(kind, name) _ZGVdN4##kind##_##name
#endif
#endif
#endif

#ifdef OF_GLIBC
#define OF_ALL(name) \
  extern "C" Vector OF_GLIBC(v, name)(Vector); \
  inline Vector name(Vector a) { return OF_GLIBC(v, name)(a); }
OF_ALL(cos) OF_ALL(exp) OF_ALL(log) OF_ALL(sin)
extern "C" Vector OF_GLIBC(vv, pow)(Vector, Vector);
inline Vector pow(Vector a, Vector b) { return OF_GLIBC(vv, pow)(a, b); }
#undef OF_ALL
#undef OF_GLIBC
#else
OF_ONE(cos) OF_ONE(exp) OF_ONE(log) OF_ONE(sin) OF_TWO(pow)
#endif
#undef OF_ONE
#undef OF_TWO

inline Vector greater(Vector a, Vector b) { return ((a > b) | (a != a)) ? a : b; }
inline Vector smaller(Vector a, Vector b) { return ((a < b) | (a != a)) ? a : b; }
inline Vector size_of(Vector a) { return a < 0.0 ? -a : a + 0.0; }
inline Vector sign(Vector a) { return a > 0.0 ? splat(1.0) : (a < 0.0 ? splat(-1.0) : a); }
inline Vector square(Vector a) { return a * a; }
inline Vector logistic(Vector a) { return splat(1.0) / (splat(1.0) + exp(-a)); }
inline Vector rsqrt(Vector a) { return splat(1.0) / sqrt(a); }
inline Mask is_finite(Vector a) { return (a - a) == splat(0.0); }

template <int n>
inline Vector power(Vector a) {
  if constexpr (n < 0) return splat(1.0) / power<-n>(a);
  if constexpr (n == 0) return splat(1.0);
  if constexpr (n == 1) return a;
  if constexpr (n > 1 && n % 2) return a * power<n - 1>(a);
  if constexpr (n > 1 && n % 2 == 0) return square(power<n / 2>(a));
}

// a derivative that is zero stays zero beside an infinite factor
inline Vector times(Vector derivative, Vector factor) { return derivative == 0.0 ? splat(0.0) : derivative * factor; }
inline Vector over(Vector derivative, Vector by) { return derivative == 0.0 ? splat(0.0) : derivative / by; }
