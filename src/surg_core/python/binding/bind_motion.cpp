#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "convert.hpp"
#include "surg_core/motion/stream.hpp"
#include "surg_core/motion/stream_input.hpp"

namespace surg::python {
namespace {

constexpr int kDof = StreamEstimate::kDof;

/// When samples were taken, when they arrived and whether the receiver sees their stamps.
struct RecordedStream {
  std::vector<double> t, arrivals;
  bool stamped;
};

/// Up to four axes of a recorded stream through input and filters, from 'first' of 'axes' on; they
/// share clock and delay. samples: rows x axes, states: n x axes x 3.
void filter_axes(const RecordedStream& stream, const double* samples, py::ssize_t axes,
                 py::ssize_t first, const DofLimits& limits, double T, py::ssize_t n,
                 StreamInput input, double* states) {
  const auto count = static_cast<int>(std::min<py::ssize_t>(axes - first, kDof));
  const auto sample = [&](std::size_t row) {
    StreamInput::Values x{};
    for (int i = 0; i < count; ++i) x[i] = samples[row * axes + first + i];
    return x;
  };
  std::array<StreamFilter, kDof> filters;
  StreamInput::State from{};
  StreamInput::Values acceleration{};
  for (int i = 0; i < count; ++i) {
    from[i].x = sample(0)[i];
    acceleration[i] = limits.acceleration;
    filters[i] = StreamFilter(limits);
    filters[i].reset(from[i]);
  }
  std::size_t next = 0;
  for (py::ssize_t k = 0; k < n; ++k) {
    const double now = stream.arrivals[0] + static_cast<double>(k) * T;
    for (; next < stream.t.size() && stream.arrivals[next] <= now + 1e-9; ++next) {
      const double age = std::max(now - stream.arrivals[next], 0.0);
      // Stamps of 0 are none.
      const double taken = stream.t[next] - stream.t[0];
      const std::int64_t stamp_ns = stream.stamped ? 1 + std::llround(1e9 * taken) : 0;
      if (next == 0) {
        input.begin(sample(0), from, acceleration, age, stamp_ns);
      } else {
        input.add(sample(next), age, stamp_ns);
      }
    }
    input.elapse(T);
    const StreamInput::State target = input.target(T);
    const StreamInput::State hand = input.estimate(T);
    for (int i = 0; i < count; ++i) {
      filters[i].step(target[i], T, 0, input.delayed() ? &hand[i] : nullptr);
      double* state = states + 3 * (k * axes + first + i);
      state[0] = filters[i].state().x;
      state[1] = filters[i].state().v;
      state[2] = filters[i].state().a;
    }
  }
}

std::vector<double> to_times(const Array& t, const char* name, py::ssize_t rows, bool strictly) {
  check_shape(t, {rows}, name);
  std::vector<double> times(t.data(), t.data() + rows);
  for (py::ssize_t i = 0; i < rows; ++i) {
    const bool later = i == 0 || times[i] > times[i - 1] || (!strictly && times[i] == times[i - 1]);
    if (!std::isfinite(times[i]) || !later) {
      throw py::value_error(std::string(name) + ": must be finite and increase; it does not at " +
                            "index " + std::to_string(i));
    }
  }
  return times;
}

Array stream_filter(const Array& t, const Array& samples, const DofLimits& limits, double T,
                    const std::optional<Array>& arrivals, bool stamped, double delay,
                    double tremor) {
  const py::ssize_t rows = samples.ndim() == 2 ? samples.shape(0) : 0;
  const py::ssize_t axes = samples.ndim() == 2 ? samples.shape(1) : 0;
  if (rows < 1 || axes < 1) {
    throw py::value_error("samples: shape " + shape_of(samples) + ", must be (n, axes)");
  }
  RecordedStream stream{to_times(t, "t", rows, true), {}, stamped};
  stream.arrivals = arrivals ? to_times(*arrivals, "arrivals", rows, false) : stream.t;
  if (!(T > 0)) throw py::value_error("T: must be > 0 [s]");
  const double span = stream.arrivals[rows - 1] - stream.arrivals[0];
  const auto n = static_cast<py::ssize_t>(std::floor(span / T + 1e-9));
  Array out({n, axes, py::ssize_t{3}});
  double* states = out.mutable_data();
  const double* values = samples.data();
  {
    py::gil_scoped_release release;
    for (py::ssize_t first = 0; first < axes; first += kDof) {
      filter_axes(stream, values, axes, first, limits, T, n, StreamInput(delay, tremor), states);
    }
  }
  return out;
}

}  // namespace

void bind_motion(py::module_& m) {
  py::class_<DofLimits>(m, "DofLimits", "Limits of one degree of freedom.")
      .def(py::init([](double v, double a, double j) {
             if (!(v > 0 && a > 0 && j > 0)) {
               throw std::invalid_argument("velocity, acceleration and jerk limits must be > 0");
             }
             return DofLimits{v, a, j};
           }),
           py::arg("velocity"), py::arg("acceleration"), py::arg("jerk"))
      .def_readonly("velocity", &DofLimits::velocity)
      .def_readonly("acceleration", &DofLimits::acceleration)
      .def_readonly("jerk", &DofLimits::jerk);

  m.def(
      "stream_filter", &stream_filter, py::arg("t"), py::arg("samples"), py::arg("limits"),
      py::arg("T") = 0.002, py::arg("arrivals") = std::nullopt, py::arg("stamped") = true,
      py::arg("delay") = 0.0, py::arg("tremor") = 0.0,
      "A recorded stream through StreamInput and StreamFilter, as in the controller.\n\n"
      "Tick k is at arrivals[0] + k T and takes what has arrived by then. t: (n,) increasing [s],\n"
      "when the samples were taken; samples: (n, axes); limits: of every axis; arrivals: (n,) "
      "[s],\n"
      "t where not given; stamped: whether the receiver sees t; delay [s], tremor [Hz]: as in the\n"
      "robot's file; four axes each share a delay. Returns (ticks, axes, 3): position, velocity, "
      "acceleration at the end of "
      "each\n"
      "tick. Releases the GIL.");
}

}  // namespace surg::python
