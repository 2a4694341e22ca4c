#include "surg_core/motion/quintic.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

// p(s) = c[0] + c[1] s + ... + c[degree] s^degree.
double evaluate(const double* c, int degree, double s) {
  double sum = c[degree];
  for (int i = degree - 1; i >= 0; --i) sum = sum * s + c[i];
  return sum;
}

void differentiate(const double* c, int degree, double* derivative) {
  for (int i = 1; i <= degree; ++i) derivative[i - 1] = i * c[i];
}

// The root of p between 'low' and 'high', where p is monotone and changes sign: Newton steps,
// replaced by bisection whenever they leave the bracket. An error of 1e-10 in the place of an
// extreme is one of 1e-20 in its value.
double root_between(const double* c, int degree, double low, double high) {
  double derivative[5];
  differentiate(c, degree, derivative);
  const bool rising = evaluate(c, degree, high) > 0;
  double s = 0.5 * (low + high);
  for (int i = 0; i < 60; ++i) {
    const double value = evaluate(c, degree, s);
    if (value == 0) return s;
    ((value > 0) == rising ? high : low) = s;
    const double newton = s - value / evaluate(derivative, degree - 1, s);
    const double next = newton > low && newton < high ? newton : 0.5 * (low + high);
    if (std::abs(next - s) < 1e-10) return next;
    s = next;
  }
  return s;
}

// Where p changes sign inside (low, high), in order; at most 'degree' places (degree <= 4). Exact
// without any case formula: between two neighbouring places where p' changes sign, p is monotone. A
// root that p only touches is left out, as it is no extreme of p's integral.
int sign_changes(const double* c, int degree, double low, double high, double* places) {
  if (degree == 0) return 0;
  double derivative[5];
  differentiate(c, degree, derivative);
  double borders[6];
  const int inner = sign_changes(derivative, degree - 1, low, high, borders + 1);
  borders[0] = low;
  borders[inner + 1] = high;
  int count = 0;
  for (int i = 0; i <= inner; ++i) {
    const double left = evaluate(c, degree, borders[i]);
    const double right = evaluate(c, degree, borders[i + 1]);
    if ((left < 0 && right > 0) || (left > 0 && right < 0)) {
      places[count++] = root_between(c, degree, borders[i], borders[i + 1]);
    }
  }
  return count;
}

// Greatest |p| on [0, 1]: at the ends, or where p' changes sign.
double largest_magnitude(const double* c, int degree) {
  double most = std::max(std::abs(evaluate(c, degree, 0)), std::abs(evaluate(c, degree, 1)));
  double derivative[5], places[4];
  differentiate(c, degree, derivative);
  const int count = sign_changes(derivative, degree - 1, 0, 1, places);
  for (int i = 0; i < count; ++i) most = std::max(most, std::abs(evaluate(c, degree, places[i])));
  return most;
}

}  // namespace

Quintic::Quintic(const Kinematic& from, const Kinematic& to, double duration) : to_(to) {
  if (!(duration > 0)) {
    c_[0] = to.x;
    return;
  }
  d_ = duration;
  const double d = d_, d2 = d * d;
  c_[0] = from.x;
  c_[1] = from.v * d;
  c_[2] = 0.5 * from.a * d2;
  // What is left for the upper three coefficients to bring about at s = 1.
  const double x = to.x - (c_[0] + c_[1] + c_[2]);
  const double v = to.v * d - (c_[1] + 2 * c_[2]);
  const double a = to.a * d2 - 2 * c_[2];
  c_[3] = 10 * x - 4 * v + 0.5 * a;
  c_[4] = -15 * x + 7 * v - a;
  c_[5] = 6 * x - 3 * v + 0.5 * a;
}

Kinematic Quintic::at(double t) const {
  if (t >= d_) return to_;
  const double s = std::max(t, 0.0) / d_;
  double v[5], a[4];
  differentiate(c_, 5, v);
  differentiate(v, 4, a);
  return {evaluate(c_, 5, s), evaluate(v, 4, s) / d_, evaluate(a, 3, s) / (d_ * d_)};
}

double Quintic::position(double t) const {
  return t >= d_ ? to_.x : evaluate(c_, 5, std::max(t, 0.0) / d_);
}

double Quintic::max_velocity() const {
  if (d_ == 0) return std::abs(to_.v);
  double v[5];
  differentiate(c_, 5, v);
  return largest_magnitude(v, 4) / d_;
}

double Quintic::max_acceleration() const {
  if (d_ == 0) return std::abs(to_.a);
  const double a[4] = {2 * c_[2], 6 * c_[3], 12 * c_[4], 20 * c_[5]};
  return largest_magnitude(a, 3) / (d_ * d_);
}

double Quintic::max_jerk() const {
  if (d_ == 0) return 0;
  const double j[3] = {6 * c_[3], 24 * c_[4], 60 * c_[5]};
  return largest_magnitude(j, 2) / (d_ * d_ * d_);
}

}  // namespace surg
