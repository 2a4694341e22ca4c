// ProxQP, dense backend with box constraints, warm-started with the result of the cycle before.
#include <proxsuite/proxqp/dense/dense.hpp>

#include "laws.hpp"

namespace bench {
namespace {

using surg::JointVector;
namespace proxqp = proxsuite::proxqp;

struct ProxQp : Law {
  // The library's default tolerance is 1e-5, in rad/s here; a tighter one costs more. The default
  // is what a user gets, and the second shows what the accuracy of the others costs.
  ProxQp(int n, double tolerance, const char* key, const char* text) : qp(n, 2, 0, true), Jr(2, n) {
    name = key;
    what = text;
    qp.settings.eps_abs = tolerance;
    qp.settings.initial_guess = proxqp::InitialGuessStatus::WARM_START_WITH_PREVIOUS_RESULT;
  }
  JointVector step(const JointVector& q, const JointVector& qd_last, const Goal& goal) override {
    const Programme programme = programme_at(*goal.scene, q, qd_last, goal);
    H = programme.H;
    g = programme.g;
    Jr = programme.rows.J;
    b = programme.b;
    lower = programme.lower;
    upper = programme.upper;
    if (first) {
      qp.init(H, g, Jr, b, proxsuite::nullopt, proxsuite::nullopt, proxsuite::nullopt, lower,
              upper);
      first = false;
    } else {
      qp.update(H, g, Jr, b, proxsuite::nullopt, proxsuite::nullopt, proxsuite::nullopt, lower,
                upper);
    }
    qp.solve();
    if (qp.results.info.status != proxqp::QPSolverOutput::PROXQP_SOLVED) ++failures;
    return qp.results.x;
  }
  proxqp::dense::QP<double> qp;
  bool first = true;
  Eigen::MatrixXd H, Jr;
  Eigen::VectorXd g, b, lower, upper;
};

}  // namespace

void add_proxqp(Laws& laws, const Scene& scene) {
  const int n = scene.chain.dof();
  laws.push_back(
      std::make_unique<ProxQp>(n, 1e-5, "qp_proxqp", "QP, ProxQP (dense, default tolerance 1e-5)"));
  laws.push_back(
      std::make_unique<ProxQp>(n, 1e-9, "qp_proxqp_tight", "QP, ProxQP (dense, tolerance 1e-9)"));
}

}  // namespace bench
