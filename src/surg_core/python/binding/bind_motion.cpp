#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "convert.hpp"
#include "surg_core/motion/braking.hpp"
#include "surg_core/motion/profiler.hpp"
#include "surg_core/motion/quintic.hpp"
#include "surg_core/motion/stream.hpp"
#include "surg_core/motion/stream_input.hpp"

namespace surg::python {
namespace {

constexpr int kDof = Profiler::kDof;

std::array<double, kDof> to_dofs(const Array& array, const char* name) {
  const Vector4 v = to_vector4(array, name);
  return {v[0], v[1], v[2], v[3]};
}

/// (4, 2) least and greatest, or None: everywhere.
Profiler::Bounds to_bounds(const std::optional<Array>& array) {
  Profiler::Bounds bounds;
  if (!array) return bounds;
  check_shape(*array, {kDof, 2}, "bounds");
  for (int i = 0; i < kDof; ++i) {
    bounds[i] = {array->at(i, 0), array->at(i, 1)};
    if (!(bounds[i].least <= bounds[i].greatest)) {
      throw py::value_error("bounds: row " + std::to_string(i) +
                            " must be (least, greatest), least <= greatest");
    }
  }
  return bounds;
}

std::pair<double, double> to_pair(const Interval& interval) {
  return {interval.least, interval.greatest};
}

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

void bind_quintic(py::module_& testing) {
  py::class_<Kinematic>(testing, "Kinematic",
                        "Position, velocity, acceleration of one degree of freedom.")
      .def(py::init([](double x, double v, double a) {
             return Kinematic{x, v, a};
           }),
           py::arg("x") = 0.0, py::arg("v") = 0.0, py::arg("a") = 0.0)
      .def_readonly("x", &Kinematic::x)
      .def_readonly("v", &Kinematic::v)
      .def_readonly("a", &Kinematic::a)
      .def("__repr__", [](const Kinematic& k) {
        return py::str("Kinematic(x={!r}, v={!r}, a={!r})").format(k.x, k.v, k.a);
      });

  py::class_<Quintic>(testing, "Quintic",
                      "x(t) of degree five on [0, d] with given states at both ends.")
      .def(py::init<const Kinematic&, const Kinematic&, double>(), py::arg("start"), py::arg("end"),
           py::arg("duration"), "duration [s]; not positive: the constant end state.")
      .def_property_readonly("duration", &Quintic::duration)
      .def("at", &Quintic::at, py::arg("t"), "State at time t [s], clamped to [0, d].")
      .def("jerk", &Quintic::jerk, py::arg("t"), "Jerk at time t, clamped to [0, d].")
      .def("max_velocity", &Quintic::max_velocity, "Largest |v| on [0, d], exact.")
      .def("max_acceleration", &Quintic::max_acceleration, "Largest |a|, exact.")
      .def("max_jerk", &Quintic::max_jerk, "Largest |jerk|, exact.")
      .def("min_position", &Quintic::min_position, "Least x, exact; may lie outside the two ends.")
      .def("max_position", &Quintic::max_position, "Greatest x, exact.")
      .def(
          "range", [](const Quintic& q, double t0, double t1) { return to_pair(q.range(t0, t1)); },
          py::arg("t0"), py::arg("t1"), "(least, greatest) x between two times, exact.");
}

void bind_braking(py::module_& testing) {
  py::class_<DofLimits>(testing, "DofLimits", "Limits of one degree of freedom.")
      .def(py::init([](double v, double a, double j) {
             return DofLimits{v, a, j};
           }),
           py::arg("velocity"), py::arg("acceleration"), py::arg("jerk"))
      .def_readonly("velocity", &DofLimits::velocity)
      .def_readonly("acceleration", &DofLimits::acceleration)
      .def_readonly("jerk", &DofLimits::jerk);

  py::class_<Braking>(testing, "Braking",
                      "The hardest braking within acceleration and jerk limits, in closed form.")
      .def_static("stop", &Braking::stop, py::arg("start"), py::arg("limits"),
                  "To a standstill in the least time.")
      .def_static("ease", &Braking::ease, py::arg("start"), py::arg("limits"),
                  "To zero acceleration with full jerk, then on at the velocity reached.")
      .def("at", &Braking::at, py::arg("t"), "State at time t [s].")
      .def_property_readonly("duration", &Braking::duration, "Until the jerk is over [s].")
      .def_property_readonly("distance", &Braking::distance,
                             "From the start to the end of the jerk, signed.")
      .def(
          "range", [](const Braking& b, double t0, double t1) { return to_pair(b.range(t0, t1)); },
          py::arg("t0"), py::arg("t1"), "(least, greatest) x between two times, exact.");
}

void bind_profiler(py::module_& testing) {
  py::class_<Profiler>(
      testing, "Profiler",
      "Discrete targets for four degrees of freedom: one quintic each with a common\n"
      "duration, extended until every limit holds.")
      .def(py::init<const std::array<DofLimits, kDof>&, double>(), py::arg("limits"),
           py::arg("base_duration") = 0.5, "Four DofLimits; base_duration [s].")
      .def(
          "reset", [](Profiler& p, const Array& x) { p.reset(to_dofs(x, "x")); }, py::arg("x"),
          "Stands still at x (4,).")
      .def(
          "reset_to", [](Profiler& p, const std::array<Kinematic, kDof>& state) { p.reset(state); },
          py::arg("state"), "Starts from four given states.")
      .def(
          "plan",
          [](Profiler& p, const Array& target, const std::optional<Array>& bounds) {
            return p.plan(to_dofs(target, "target"), to_bounds(bounds));
          },
          py::arg("target"), py::arg("bounds") = std::nullopt,
          "Plans from the present state to rest at target (4,), inside bounds (4, 2) (least,\n"
          "greatest) where given. Returns whether every limit and bound holds.")
      .def(
          "plan_fixed",
          [](Profiler& p, const Array& target, double duration) {
            p.plan_fixed(to_dofs(target, "target"), duration);
          },
          py::arg("target"), py::arg("duration"), "The same in a fixed time [s], limits or not.")
      .def("advance", &Profiler::advance, py::arg("dt"))
      .def_property_readonly("state", &Profiler::state)
      .def_property_readonly("done", &Profiler::done)
      .def_property_readonly("duration", &Profiler::duration, "Of the present profile [s].")
      .def_property_readonly("brake_duration", &Profiler::brake_duration,
                             "Of the braking before the quintics [s].")
      .def(
          "excursion",
          [](const Profiler& p, int dof, double t0, double t1) {
            if (dof < 0 || dof >= kDof) throw py::index_error("dof: 0 to 3");
            return to_pair(p.excursion(dof, t0, t1));
          },
          py::arg("dof"), py::arg("t0"), py::arg("t1"),
          "(least, greatest) position between two times since the plan was made, exact.")
      .def(
          "quintic",
          [](const Profiler& p, int dof) {
            if (dof < 0 || dof >= kDof) throw py::index_error("dof: 0 to 3");
            return p.quintic(dof);
          },
          py::arg("dof"));
}

void step_filter(StreamFilter& filter, const Kinematic& target, double T, double period) {
  filter.step(target, T, period);
}

void bind_stream(py::module_& testing) {
  py::class_<StreamClock>(testing, "StreamClock",
                          "Puts the samples of one sender on the receiver's clock.")
      .def(py::init([](double arrival, std::int64_t stamp_ns) {
             StreamClock clock;
             clock.reset({arrival, stamp_ns});
             return clock;
           }),
           py::arg("arrival"), py::arg("stamp_ns") = 0)
      .def(
          "advance",
          [](StreamClock& clock, double arrival, std::int64_t stamp_ns) {
            return clock.advance({arrival, stamp_ns});
          },
          py::arg("arrival"), py::arg("stamp_ns") = 0,
          "Takes the next sample; returns the time [s] that passed at the sender.")
      .def_property_readonly("time", &StreamClock::time, "Of the last sample [s].")
      .def_property_readonly("period", &StreamClock::period, "Mean spacing at the sender [s].")
      .def_property_readonly("stamped", &StreamClock::stamped, "Whether the stamps are in use.");

  py::class_<StreamDelay>(testing, "StreamDelay",
                          "Bessel low-pass: a stream keeps its shape, later and more gently.")
      .def(py::init<double>(), py::arg("delay"))
      .def("reset", &StreamDelay::reset, py::arg("state"))
      .def("works", &StreamDelay::works, py::arg("T"),
           "Whether it does anything at a tick of T seconds.")
      .def("step", &StreamDelay::step, py::arg("x"), py::arg("T"),
           "T seconds go by with the input at x.")
      .def("predict", &StreamDelay::predict, py::arg("ahead"),
           "The delayed stream 'ahead' seconds later.");

  py::class_<StreamFilter>(
      testing, "StreamFilter",
      "Follows a stream of targets within velocity, acceleration and jerk limits.")
      .def(py::init<const DofLimits&>(), py::arg("limits"))
      .def("reset", &StreamFilter::reset, py::arg("state"))
      .def("step", &step_filter, py::arg("target"), py::arg("T"), py::arg("period") = 0.0,
           "One tick of T seconds towards a target predicted one tick ahead.")
      .def("brake", &StreamFilter::brake, py::arg("T"),
           "One tick of the hardest braking inside the limits.")
      .def_property_readonly("state", &StreamFilter::state, py::return_value_policy::copy);

  testing.def(
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

}  // namespace

void bind_motion(py::module_& testing) {
  bind_quintic(testing);
  bind_braking(testing);
  bind_profiler(testing);
  bind_stream(testing);
}

}  // namespace surg::python
