// What a program for free runs is given, and what it fills. Arrays are dense, lanes last:
//
//   theta [p, lane]   x0 [x, seq, lane]   u [time, u, seq]   free [lane, k]: positions in theta, -1 for none
//   measured, weight [time, y, seq]: weight 0 where nothing was measured
//   y [time, y, seq, lane]   x [time, x, seq, lane]: after u_t   dy [time, y, d, seq, lane], d: k and the unknowns of the start
//   squares [seq, lane]   pull [d, seq, lane]   matrix [d, d, seq, lane]

#pragma once

#include <cstdint>

struct Task {
  int64_t lanes, seqs, time, free_count;
  const double *u, *theta, *x0;
  const int64_t* free;
  const double *measured, *weight;
  double *y, *x, *dy;
  double *squares, *pull, *matrix;
};

struct Sizes {
  int64_t p, x, u, y, start;
};

struct FreeRuns {
  Sizes sizes;
  void (*run)(const Task&);
  void (*along)(const Task&);
  void (*normal)(const Task&);
};
