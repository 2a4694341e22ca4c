// DAQP: a dual active-set method in C, compiled from its sources with the same flags. The two rows
// of the pivot are immutable active constraints; the working set of the cycle before is kept, which
// is its warm start.
extern "C" {
#include <api.h>
#include <utils.h>
}

#include "laws.hpp"

namespace bench {
namespace {

using surg::JointVector;

constexpr int kMost = surg::kMaxJoints;

struct Daqp : Law {
  explicit Daqp(int joints) : n(joints) {
    name = "qp_daqp";
    what = "QP, DAQP (warm start)";
    problem.n = n;
    problem.m = n + 2;
    problem.ms = n;
    problem.H = H;
    problem.f = f;
    problem.A = A;
    problem.bupper = upper;
    problem.blower = lower;
    problem.sense = sense;
    for (int i = 0; i < 2; ++i) sense[n + i] = DAQP_ACTIVE | DAQP_IMMUTABLE;
    result.x = x;
    result.lam = multipliers;
  }
  ~Daqp() override {
    if (ready) {
      free_daqp_workspace(&work);
      free_daqp_ldp(&work);
    }
  }
  JointVector step(const JointVector& q, const JointVector& qd_last, const Goal& goal) override {
    const Programme programme = programme_at(*goal.scene, q, qd_last, goal);
    for (int i = 0; i < n; ++i) {  // row by row
      for (int j = 0; j < n; ++j) H[i * n + j] = programme.H(i, j);
      for (int r = 0; r < 2; ++r) A[r * n + i] = programme.rows.J(r, i);
      f[i] = programme.g[i];
      lower[i] = programme.lower[i];
      upper[i] = programme.upper[i];
    }
    for (int r = 0; r < 2; ++r) lower[n + r] = upper[n + r] = programme.b[r];
    if (!ready) {
      allocate_daqp_settings(&work);
      ready = setup_daqp(&problem, &work, nullptr) >= 0;
      if (!ready) {
        ++failures;
        return JointVector::Zero(n);
      }
    } else {
      daqp_update_ldp(DAQP_UPDATE_Rinv | DAQP_UPDATE_M | DAQP_UPDATE_v | DAQP_UPDATE_d, &work,
                      &problem);
    }
    daqp_solve(&result, &work);
    if (result.exitflag <= 0) ++failures;
    return Eigen::Map<Eigen::VectorXd>(x, n);
  }

  int n;
  bool ready = false;
  DAQPWorkspace work{};
  DAQPProblem problem{};
  DAQPResult result{};
  double H[kMost * kMost] = {}, f[kMost] = {}, A[2 * kMost] = {};
  double lower[kMost + 2] = {}, upper[kMost + 2] = {}, x[kMost] = {}, multipliers[kMost + 2] = {};
  int sense[kMost + 2] = {};
};

}  // namespace

void add_daqp(Laws& laws, const Scene& scene) {
  laws.push_back(std::make_unique<Daqp>(scene.chain.dof()));
}

}  // namespace bench
