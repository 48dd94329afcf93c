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

// Of every row: the columns that are ever other than zero in the lanes of a block. Effects that a lane does not have, and
// states that nothing free acts on, leave most of them out.
using Reached = std::vector<std::vector<int64_t>>;

inline void include(std::vector<int64_t>& columns, int64_t one) {
  const auto at = std::lower_bound(columns.begin(), columns.end(), one);
  if (at == columns.end() || *at != one) columns.insert(at, one);
}

template <int p, int count>
void include_entries(const Entry* entries, const Directions& moved, const Reached& from, Reached& to) {
  for (int e = 0; e < count; ++e) {
    auto& columns = to[entries[e].row];
    if (entries[e].column < p)
      for (const auto& m : moved.of[entries[e].column]) include(columns, m.place);
    else
      for (const int64_t column : from[entries[e].column - p]) include(columns, column);
  }
}

template <typename Model>
Reached reached_states(const Directions& moved, int64_t free_count) {
  Reached now(Model::kX), before;
  for (int s = 0; s < Model::kStart; ++s) now[Model::start(s)].push_back(free_count + s);
  while (now != before) {
    before = now;
    include_entries<Model::kP, Model::kStep>(Model::step_entries(), moved, before, now);
  }
  return now;
}

template <typename Model>
Reached reached_outputs(const Directions& moved, const Reached& states) {
  Reached outputs(Model::kY);
  include_entries<Model::kP, Model::kMeasure>(Model::measure_entries(), moved, states, outputs);
  return outputs;
}

// to = A from + B dtheta, rows [n, d]; entries of columns below p are those of B
template <int p, int count>
void along(const Entry* entries, const Vector* found, const Directions& moved, const Vector* from, const Reached& reached,
           const Reached& results, int64_t d, Vector* to) {
  for (size_t row = 0; row < results.size(); ++row)
    for (const int64_t i : results[row]) to[row * d + i] = Vector{};
  for (int e = 0; e < count; ++e) {
    Vector* row = to + entries[e].row * d;
    if (entries[e].column < p) {
      for (const auto& m : moved.of[entries[e].column]) row[m.place] += found[e] * m.lanes;
    } else {
      const Vector* column = from + (entries[e].column - p) * d;
      for (const int64_t i : reached[entries[e].column - p]) row[i] += found[e] * column[i];
    }
  }
}

// Gives every sample with its derivatives dy [y, d] to a sink: Sink::begin(reached), add(block, t, seq, dy), end(block, seq)
template <typename Model, typename Sink>
void run_along(const Task& task, Sink sink) {
  const int64_t d = task.free_count + Model::kStart;
  std::vector<Vector> dx(Model::kX * d), d_next(Model::kX * d), dy(Model::kY * d);
  Vector by_step[Model::kStep + 1], by_measure[Model::kMeasure + 1];
  for (int64_t first = 0; first < task.lanes; first += kLanes) {
    Block<Model> block(task, first);
    const Directions moved(task, first, Model::kP);
    const Reached states = reached_states<Model>(moved, task.free_count);
    const Reached outputs = reached_outputs<Model>(moved, states);
    std::fill(dy.begin(), dy.end(), Vector{});
    for (int64_t seq = 0; seq < task.seqs; ++seq) {
      block.begin(seq);
      sink.begin(outputs);
      std::fill(dx.begin(), dx.end(), Vector{});
      std::fill(d_next.begin(), d_next.end(), Vector{});
      for (int s = 0; s < Model::kStart; ++s) dx[Model::start(s) * d + task.free_count + s] = splat(1.0);
      for (int64_t t = 0; t < task.time; ++t) {
        block.read(t, seq);
        Model::step_along(block.theta, block.x, block.u, block.next, by_step);
        along<Model::kP, Model::kStep>(Model::step_entries(), by_step, moved, dx.data(), states, states, d,
                                       d_next.data());
        Model::measure_along(block.theta, block.measured(), block.u, block.y, by_measure);
        along<Model::kP, Model::kMeasure>(Model::measure_entries(), by_measure, moved,
                                          (Model::kAfterStep ? d_next : dx).data(), states, outputs, d, dy.data());
        sink.add(block, t, seq, dy.data());
        std::copy(block.next, block.next + Model::kX, block.x);
        dx.swap(d_next);
      }
      sink.end(block, seq);
    }
  }
}

// y and dy of all samples
template <typename Model>
struct Written {
  const Task& task;
  void begin(const Reached&) {}
  void add(const Block<Model>& block, int64_t t, int64_t seq, const Vector* dy) {
    block.write(block.y, Model::kY, task.y, t, seq);
    block.write(dy, Model::kY * (task.free_count + Model::kStart), task.dy, t, seq);
  }
  void end(const Block<Model>&, int64_t) {}
};

// The normal equations of the weighted errors e = w (measured - y): sums of e e, w dy e and w dy w dy. A derivative that
// is not finite counts as zero.
template <typename Model>
struct Summed {
  const Task& task;
  int64_t d = task.free_count + Model::kStart;
  Vector squares{};
  std::vector<Vector> pull = std::vector<Vector>(d), matrix = std::vector<Vector>(d * d), columns = pull;
  const Reached* reached = nullptr;

  void begin(const Reached& outputs) {
    reached = &outputs;
    squares = Vector{};
    std::fill(pull.begin(), pull.end(), Vector{});
    std::fill(matrix.begin(), matrix.end(), Vector{});
  }
  void add(const Block<Model>& block, int64_t t, int64_t seq, const Vector* dy) {
    for (int64_t k = 0; k < Model::kY; ++k) {
      const int64_t at = (t * Model::kY + k) * task.seqs + seq;
      if (!(task.weight[at] > 0.0)) continue;
      const Vector weight = splat(task.weight[at]), error = weight * (splat(task.measured[at]) - block.y[k]);
      squares += error * error;
      const auto& places = (*reached)[k];
      for (const int64_t i : places) {
        const Vector column = weight * dy[k * d + i];
        columns[i] = is_finite(column) ? column : splat(0.0);
        pull[i] += columns[i] * error;
      }
      for (size_t i = 0; i < places.size(); ++i) {
        const Vector one = columns[places[i]];
        Vector* row = matrix.data() + places[i] * d;
        for (size_t j = 0; j <= i; ++j) row[places[j]] += one * columns[places[j]];
      }
    }
  }
  void end(const Block<Model>& block, int64_t seq) {
    store(squares, block.row(task.squares, 0, seq), block.first, task.lanes);
    block.write(pull.data(), d, task.pull, 0, seq);
    for (int64_t i = 0; i < d; ++i)
      for (int64_t j = 0; j < i; ++j) matrix[j * d + i] = matrix[i * d + j];
    block.write(matrix.data(), d * d, task.matrix, 0, seq);
  }
};

template <typename Model>
void derivatives(const Task& task) {
  run_along<Model>(task, Written<Model>{task});
}
template <typename Model>
void normal_equations(const Task& task) {
  run_along<Model>(task, Summed<Model>{task});
}
