// Free runs of a physics that was compiled apart (acceleration/compiled_runs.py), and their derivatives, for XLA.
//
// Programs are known by a number that stays the same from process to process, because XLA keeps what it has compiled.
// Leading axes of the arrays are a batch.

#include <map>
#include <mutex>

#include "free_run/task.h"
#include "xla/ffi/api/ffi.h"

namespace ffi = xla::ffi;

namespace {

std::mutex guard;
std::map<int64_t, const FreeRuns*> programs;

using In = ffi::Buffer<ffi::F64>;
using Free = ffi::Buffer<ffi::S64>;
using Out = ffi::ResultBuffer<ffi::F64>;

// Calls one(program, task, member) for every member of the batch
template <typename One>
ffi::Error for_members(int64_t number, const In& u, const In& theta, const In& x0, One one) {
  const FreeRuns* program = nullptr;
  {
    const std::lock_guard<std::mutex> lock(guard);
    const auto found = programs.find(number);
    if (found == programs.end()) return ffi::Error::InvalidArgument("free runs: no program of this number");
    program = found->second;
  }
  const auto shape = x0.dimensions(), input = u.dimensions(), numbers = theta.dimensions();
  const size_t rank = shape.size();
  const Sizes& n = program->sizes;
  Task task{};
  task.lanes = shape[rank - 1], task.seqs = shape[rank - 2], task.time = input[rank - 3];
  if (shape[rank - 3] != n.x || numbers[rank - 3] != n.p || input[rank - 2] != n.u)
    return ffi::Error::InvalidArgument("free runs: arrays of another physics");
  int64_t members = 1;
  for (size_t i = 0; i + 3 < rank; ++i) members *= shape[i];
  for (int64_t m = 0; m < members; ++m) {
    task.u = u.typed_data() + m * task.time * n.u * task.seqs;
    task.theta = theta.typed_data() + m * n.p * task.lanes;
    task.x0 = x0.typed_data() + m * n.x * task.seqs * task.lanes;
    one(*program, task, m);
  }
  return ffi::Error::Success();
}

ffi::Error Run(int64_t program, In u, In theta, In x0, Out y, Out x) {
  return for_members(program, u, theta, x0, [&](const FreeRuns& runs, Task task, int64_t m) {
    const int64_t size = m * task.time * task.seqs * task.lanes;
    task.y = y->typed_data() + size * runs.sizes.y;
    task.x = x->typed_data() + size * runs.sizes.x;
    runs.run(task);
  });
}

ffi::Error Along(int64_t program, In u, In theta, In x0, Free free, Out y, Out dy) {
  const auto places = free.dimensions();
  const int64_t count = places[places.size() - 1];
  return for_members(program, u, theta, x0, [&](const FreeRuns& runs, Task task, int64_t m) {
    const int64_t size = m * task.time * task.seqs * task.lanes;
    task.free_count = count;
    task.free = free.typed_data() + m * task.lanes * count;
    task.y = y->typed_data() + size * runs.sizes.y;
    task.dy = dy->typed_data() + size * runs.sizes.y * (count + runs.sizes.start);
    runs.along(task);
  });
}

ffi::Error Normal(int64_t program, In u, In theta, In x0, Free free, In measured, In weight, Out squares, Out pull,
                  Out matrix) {
  const auto places = free.dimensions();
  const int64_t count = places[places.size() - 1];
  return for_members(program, u, theta, x0, [&](const FreeRuns& runs, Task task, int64_t m) {
    const int64_t samples = m * task.time * runs.sizes.y * task.seqs, size = m * task.seqs * task.lanes;
    const int64_t d = count + runs.sizes.start;
    task.free_count = count;
    task.free = free.typed_data() + m * task.lanes * count;
    task.measured = measured.typed_data() + samples;
    task.weight = weight.typed_data() + samples;
    task.squares = squares->typed_data() + size;
    task.pull = pull->typed_data() + size * d;
    task.matrix = matrix->typed_data() + size * d * d;
    runs.normal(task);
  });
}

}  // namespace

extern "C" void pgrssnn_register(int64_t number, const FreeRuns* program) {
  const std::lock_guard<std::mutex> lock(guard);
  programs[number] = program;
}

XLA_FFI_DEFINE_HANDLER_SYMBOL(
    pgrssnn_free_run, Run,
    ffi::Ffi::Bind().Attr<int64_t>("program").Arg<In>().Arg<In>().Arg<In>().Ret<In>().Ret<In>());
XLA_FFI_DEFINE_HANDLER_SYMBOL(
    pgrssnn_free_run_along, Along,
    ffi::Ffi::Bind().Attr<int64_t>("program").Arg<In>().Arg<In>().Arg<In>().Arg<Free>().Ret<In>().Ret<In>());
XLA_FFI_DEFINE_HANDLER_SYMBOL(pgrssnn_free_run_normal, Normal,
                              ffi::Ffi::Bind()
                                  .Attr<int64_t>("program")
                                  .Arg<In>().Arg<In>().Arg<In>().Arg<Free>().Arg<In>().Arg<In>()
                                  .Ret<In>().Ret<In>().Ret<In>());
