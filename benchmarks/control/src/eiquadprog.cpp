// eiquadprog: the dual active-set method of Goldfarb and Idnani, the form with fixed sizes. It has
// no warm start.
#include <eiquadprog/eiquadprog-rt.hpp>
#include <eiquadprog/eiquadprog-rt.hxx>

#include "laws.hpp"

namespace bench {
namespace {

using surg::JointVector;

template <int n>
struct Eiquadprog : Law {
  Eiquadprog() {
    name = "qp_eiquadprog";
    what = "QP, eiquadprog (fixed size)";
    CI.setZero();
    for (int i = 0; i < n; ++i) {
      CI(i, i) = 1;
      CI(n + i, i) = -1;
    }
  }
  JointVector step(const JointVector& q, const JointVector& qd_last, const Goal& goal) override {
    const Programme programme = programme_at(*goal.scene, q, qd_last, goal);
    const Eigen::Matrix<double, n, n> H = programme.H;
    const Eigen::Matrix<double, n, 1> g = programme.g;
    const Eigen::Matrix<double, 2, n> CE = programme.rows.J;
    const Eigen::Vector2d ce = -programme.b;
    ci.template head<n>() = -programme.lower;
    ci.template tail<n>() = programme.upper;
    Eigen::Matrix<double, n, 1> x;
    if (solver.solve_quadprog(H, g, CE, ce, CI, ci, x) !=
        eiquadprog::solvers::RT_EIQUADPROG_OPTIMAL) {
      ++failures;
      return JointVector::Zero(n);
    }
    return x;
  }
  eiquadprog::solvers::RtEiquadprog<n, 2, 2 * n> solver;
  Eigen::Matrix<double, 2 * n, n> CI;
  Eigen::Matrix<double, 2 * n, 1> ci;
};

}  // namespace

void add_eiquadprog(Laws& laws, const Scene& scene) {
  if (scene.chain.dof() == 6) laws.push_back(std::make_unique<Eiquadprog<6>>());
  if (scene.chain.dof() == 7) laws.push_back(std::make_unique<Eiquadprog<7>>());
}

}  // namespace bench
