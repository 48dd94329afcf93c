// Free runs over functions that were written by acceleration/scalar_code.py, kLanes fits at once.
//
//   x_t = step(theta, x_{t-1}, u_t)   y_t = measure(theta, x_t or x_{t-1}, u_t)
//   dx_t = A_t dx_{t-1} + B_t dtheta, A_t and B_t as their entries that are not always zero
//
// A model is a struct of static functions and tables, Model::step and so on: see acceleration/compiled_runs.py.

#pragma once

#include <algorithm>
#include <vector>

#include "numbers.h"
#include "task.h"

struct Entry {
  int row, column;
};

// rows [n, lanes] from lane first; what is beyond the last lane reads as zero and is not written
inline Vector load(const double* row, int64_t first, int64_t lanes) {
  Vector a{};
  std::memcpy(&a, row + first, std::min(kLanes, lanes - first) * sizeof(double));
  return a;
}
inline void store(Vector a, double* row, int64_t first, int64_t lanes) {
  if (lanes - first >= kLanes)
    std::memcpy(row + first, &a, sizeof(Vector));
  else
    std::memcpy(row + first, &a, (lanes - first) * sizeof(double));
}

template <typename Model>
struct Block {  // kLanes lanes from `first`, one sequence after the other
  const Task& task;
  int64_t first;
  Vector theta[Model::kP + 1], x[Model::kX + 1], next[Model::kX + 1], u[Model::kU + 1], y[Model::kY + 1];

  Block(const Task& task, int64_t first) : task(task), first(first) {
    for (int i = 0; i < Model::kP; ++i) theta[i] = load(task.theta + i * task.lanes, first, task.lanes);
  }
  double* row(double* array, int64_t index, int64_t seq) const { return array + (index * task.seqs + seq) * task.lanes; }
  void begin(int64_t seq) {
    for (int i = 0; i < Model::kX; ++i) x[i] = load(task.x0 + (i * task.seqs + seq) * task.lanes, first, task.lanes);
  }
  void read(int64_t t, int64_t seq) {
    for (int i = 0; i < Model::kU; ++i) u[i] = splat(task.u[(t * Model::kU + i) * task.seqs + seq]);
  }
  void write(const Vector* rows, int count, double* array, int64_t t, int64_t seq) const {
    for (int i = 0; i < count; ++i) store(rows[i], row(array, t * count + i, seq), first, task.lanes);
  }
  const Vector* measured() const { return Model::kAfterStep ? next : x; }
};

template <typename Model>
void run(const Task& task) {
  for (int64_t first = 0; first < task.lanes; first += kLanes) {
    Block<Model> block(task, first);
    for (int64_t seq = 0; seq < task.seqs; ++seq) {
      block.begin(seq);
      for (int64_t t = 0; t < task.time; ++t) {
        block.read(t, seq);
        Model::step(block.theta, block.x, block.u, block.next);
        Model::measure(block.theta, block.measured(), block.u, block.y);
        block.write(block.y, Model::kY, task.y, t, seq);
        block.write(block.next, Model::kX, task.x, t, seq);
        std::copy(block.next, block.next + Model::kX, block.x);
      }
    }
  }
}

// dtheta of the free numbers of a block: one where a lane has a number at a place of `free`
struct Directions {
  struct Moved {
    int64_t place;
    Vector lanes;
  };
  std::vector<std::vector<Moved>> of;  // every number of theta

  Directions(const Task& task, int64_t first, int64_t p) : of(p) {
    for (int64_t i = first; i < std::min(first + kLanes, task.lanes); ++i)
      for (int64_t place = 0; place < task.free_count; ++place) {
        const int64_t number = task.free[i * task.free_count + place];
        if (number < 0 || number >= p) continue;
        auto& moved = of[number];
        auto same = std::find_if(moved.begin(), moved.end(), [&](const Moved& m) { return m.place == place; });
        if (same == moved.end()) same = moved.insert(moved.end(), {place, Vector{}});
        same->lanes[i - first] = 1.0;
      }
  }
};

// to = A from + B dtheta, rows [n, d]; entries of columns below p are those of B
template <int p, int count>
void along(const Entry* entries, const Vector* found, const Directions& moved, const Vector* from, int rows, int64_t d,
           Vector* to) {
  std::fill(to, to + rows * d, Vector{});
  for (int e = 0; e < count; ++e) {
    Vector* row = to + entries[e].row * d;
    if (entries[e].column < p) {
      for (const auto& m : moved.of[entries[e].column]) row[m.place] += found[e] * m.lanes;
    } else {
      const Vector* column = from + (entries[e].column - p) * d;
      for (int64_t i = 0; i < d; ++i) row[i] += found[e] * column[i];
    }
  }
}

template <typename Model>
void run_along(const Task& task) {
  const int64_t d = task.free_count + Model::kStart;
  std::vector<Vector> dx(Model::kX * d), d_next(Model::kX * d), dy(Model::kY * d);
  Vector by_step[Model::kStep + 1], by_measure[Model::kMeasure + 1];
  for (int64_t first = 0; first < task.lanes; first += kLanes) {
    Block<Model> block(task, first);
    const Directions moved(task, first, Model::kP);
    for (int64_t seq = 0; seq < task.seqs; ++seq) {
      block.begin(seq);
      std::fill(dx.begin(), dx.end(), Vector{});
      for (int s = 0; s < Model::kStart; ++s) dx[Model::start(s) * d + task.free_count + s] = splat(1.0);
      for (int64_t t = 0; t < task.time; ++t) {
        block.read(t, seq);
        Model::step_along(block.theta, block.x, block.u, block.next, by_step);
        along<Model::kP, Model::kStep>(Model::step_entries(), by_step, moved, dx.data(), Model::kX, d, d_next.data());
        Model::measure_along(block.theta, block.measured(), block.u, block.y, by_measure);
        along<Model::kP, Model::kMeasure>(Model::measure_entries(), by_measure, moved,
                                          (Model::kAfterStep ? d_next : dx).data(), Model::kY, d, dy.data());
        block.write(block.y, Model::kY, task.y, t, seq);
        block.write(dy.data(), Model::kY * d, task.dy, t, seq);
        std::copy(block.next, block.next + Model::kX, block.x);
        dx.swap(d_next);
      }
    }
  }
}
